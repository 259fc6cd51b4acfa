"""Long records as lines that a browser draws at once, without losing a peak."""

import numpy as np

MOST = 4000
"""Points a line may have. Seven SVG lines of 22 500 points took 60 to 120 ms a zoom and 40 ms a hover on a slow machine,
of 4000 points 30 and 18 ms, at a fifth of the page. WebGL lines are no way out: a page may hold some 16 WebGL contexts and
plotly takes three a figure, so the figures of a longer report go blank."""


def thinned(time: np.ndarray, values: np.ndarray, most: int = MOST) -> tuple[np.ndarray, np.ndarray]:
    """At most `most` of the samples (time [s] and values, both (n,)): the first, the last, the extremes of each bin.

    The bins have equally many samples. Samples that are nan (missing) stand back for others in the bin.
    """
    n = len(values)
    if n <= most:
        return time, values
    edges = np.linspace(0, n, most // 2, dtype=int)
    low = np.where(np.isnan(values), np.inf, values)
    high = np.where(np.isnan(values), -np.inf, values)
    kept = {0, n - 1}
    for start, end in zip(edges[:-1], edges[1:], strict=True):
        kept.add(int(start + low[start:end].argmin()))
        kept.add(int(start + high[start:end].argmax()))
    places = np.array(sorted(kept))
    return time[places], values[places]


def thinning(samples: int, most: int = MOST) -> str:
    """The sentence a caption owes its reader about lines of so many samples; empty where all are drawn."""
    if samples <= most:
        return ""
    return f"Drawn are the lowest and the highest of every {round(samples / (most // 2 - 1))} samples."
