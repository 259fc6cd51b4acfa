"""Thin long records for drawing, without losing a peak."""

import math
from collections.abc import Iterable

import numpy as np

MOST = 4000
"""Maximum points per line. On a slow machine seven SVG lines of 22 500 points take 60 to 120 ms per zoom and 40 ms per hover,
of 4000 points 30 and 18 ms, at a fifth of the bytes. WebGL lines need eval, which the page forbids, and plotly takes three
WebGL contexts per figure where a browser allows some 16 per page."""


def places(lines: Iterable[np.ndarray], most: int = MOST) -> np.ndarray:
    """Indices (k,) of at most `most` samples to draw of lines over one time axis, each (n,).

    The record is cut into equal bins, as short as the number allows; each gives its lowest and highest sample of every line.
    All lines keep the same samples, so that values under the pointer are of one time.
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
    """A sentence for the caption of thinned lines; empty if all samples are drawn."""
    if samples <= MOST:
        return ""
    return f"Drawn are at most {MOST} of the {samples} samples, the extremes of every line among them."


def to_the_eye(values: np.ndarray) -> np.ndarray:
    """Values rounded to some 1e-5 of their span, far less than a pixel, to keep the page small."""
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
