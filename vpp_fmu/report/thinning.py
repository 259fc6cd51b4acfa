"""Long records as lines that a browser draws at once, without losing a peak."""

import math
from collections.abc import Iterable

import numpy as np

MOST = 4000
"""Points a line may have. Seven SVG lines of 22 500 points took 60 to 120 ms a zoom and 40 ms a hover on a slow machine,
of 4000 points 30 and 18 ms, at a fifth of the bytes. WebGL lines are no way out: they need eval, which the page forbids, and
plotly takes three WebGL contexts a figure where a browser grants some 16 a page."""


def places(lines: Iterable[np.ndarray], most: int = MOST) -> np.ndarray:
    """Which samples, at most `most`, stand for lines over one time axis, each (n,): (k,) indices, all if they are so few.

    The record is cut into equal bins, as short as the number allows; each gives its lowest and highest sample of every
    line. All lines keep the same samples, so that a reader who points at a time is told values of that time.
    """
    lines = [np.asarray(line, float) for line in lines]
    n = len(lines[0])
    if n <= most:
        return np.arange(n)
    bounds = [np.where(np.isnan(line), np.inf, sign * line) for line in lines for sign in (1, -1)]
    size = 2 * n // most
    while len(kept := _lowest(bounds, size)) > most and size < n:
        size += 1 + size // 8
    return kept


def thinning(samples: int) -> str:
    """The sentence a caption owes its reader about lines of so many samples; empty where all are drawn."""
    if samples <= MOST:
        return ""
    return f"Drawn are at most {MOST} of the {samples} samples, the extremes of every line among them."


def to_the_eye(values: np.ndarray) -> np.ndarray:
    """Values to some hundred-thousandth of their span, far less than a pixel: the digits behind it only make a page large."""
    seen = values[np.isfinite(values)]
    span = float(np.ptp(seen)) if len(seen) else 0.0
    return np.round(values, 5 - math.floor(math.log10(span))) if span > 0.0 else values


def _lowest(lines: list[np.ndarray], size: int) -> np.ndarray:
    """Indices of the first sample, the last, and each line's lowest in every bin of `size` samples."""
    n = len(lines[0])
    starts = np.arange(0, n, size)
    padding = (0, len(starts) * size - n)
    kept = [starts + np.pad(line, padding, constant_values=np.inf).reshape(-1, size).argmin(axis=1) for line in lines]
    return np.unique(np.concatenate([[0, n - 1], *kept]))
