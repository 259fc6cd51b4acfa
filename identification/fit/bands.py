"""Spectra in bands of a third of an octave; the level is assumed constant within a band."""

import numpy as np

BAND = 2.0 ** (1.0 / 3.0)
"""Ratio of a band's edges: a third of an octave."""

ORDINATES = 12
"""Minimum number of periodogram ordinates in a band: the standard error is then 29 % of the level, 14 % of the amplitude."""


def starts(count: int) -> np.ndarray:
    """(bands,): the first ordinate of each band of a periodogram of `count` ordinates."""
    edges = [0]
    while (ahead := max(edges[-1] + ORDINATES, int(edges[-1] * BAND))) <= count - ORDINATES:
        edges.append(ahead)
    return np.array(edges)


def banded(values: np.ndarray) -> np.ndarray:
    """Replace each of the values (k,) by the mean in its frequency band."""
    first = starts(len(values))
    width = np.diff([*first, len(values)])
    return np.repeat(np.add.reduceat(values, first) / width, width)
