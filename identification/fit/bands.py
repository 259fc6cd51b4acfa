"""Spectra in bands of a third of an octave, in which a level is taken as flat."""

import numpy as np

BAND = 2.0 ** (1.0 / 3.0)
"""Ratio of a band's edges, in which a spectrum is taken as flat: a third of an octave."""

ORDINATES = 12
"""Least number of a periodogram's ordinates in a band: its level is then known to 29 %, an amplitude to 14 %."""


def starts(count: int) -> np.ndarray:
    """(bands,) the first ordinate of each band of a periodogram of `count` ordinates."""
    edges = [0]
    while (ahead := max(edges[-1] + ORDINATES, int(edges[-1] * BAND))) <= count - ORDINATES:
        edges.append(ahead)
    return np.array(edges)


def banded(values: np.ndarray) -> np.ndarray:
    """Each of (k,) replaced by the mean in its band of frequencies."""
    first = starts(len(values))
    width = np.diff([*first, len(values)])
    return np.repeat(np.add.reduceat(values, first) / width, width)
