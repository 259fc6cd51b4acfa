"""Mean reading of a coarse converter. Rounding is not noise: it repeats if the commands repeat.

With noise of standard deviation `blur` before the converter, the mean reading of a true value x is, both in counts (Widrow and
Kollar, Quantization Noise, 2008, chapter 3)

    E[round(x + n)] = x + sum over k of (-1)^k / (pi k) sin(2 pi k x) exp(-2 pi^2 k^2 blur^2)

A converter that truncates reads half a count less everywhere; the fitted offset absorbs this.
"""

from dataclasses import dataclass

import numpy as np

LEAST = 0.25
"""Minimum blur, counts. With less the mean is a staircase without a gradient; a prediction is not that exact either."""

NEGLIGIBLE = 1e-4
"""Counts: smaller terms of the sum are omitted."""

WHOLE = 0.01
"""Counts: maximum distance of differences of readings from whole counts."""


@dataclass(frozen=True)
class Converter:
    """Readings on a grid of step `count` [N] through `zero` [N] (0 without a grid); `blur` [counts]: noise before it."""

    count: float
    zero: float
    blur: float

    @classmethod
    def of(cls, thrust: np.ndarray, noise: float) -> "Converter":
        """From readings (rows,) N and the standard deviation of their noise, rounding included."""
        count, zero = grid(thrust)
        before = max(noise**2 - count**2 / 12.0, 0.0)
        return cls(count, zero, max(float(np.sqrt(before)) / count, LEAST) if count else np.inf)

    @property
    def _shares(self) -> list[tuple[int, float]]:
        """(k, amplitude [counts]) of the terms above NEGLIGIBLE."""
        found, k = [], 1
        while self.count and (size := np.exp(-2.0 * (np.pi * k * self.blur) ** 2) / (np.pi * k)) > NEGLIGIBLE:
            found.append((k, float(-size if k % 2 else size)))
            k += 1
        return found

    def reads(self, thrust: np.ndarray) -> np.ndarray:
        """The mean reading (rows,) N of a true thrust (rows,) N."""
        if not (shares := self._shares):
            return thrust
        return thrust + self.count * sum(size * np.sin(k * self._turns(thrust)) for k, size in shares)

    def slope(self, thrust: np.ndarray) -> np.ndarray | float:
        """Derivative (rows,) of the mean reading with respect to the true thrust."""
        shares = self._shares
        return 1.0 + sum(2.0 * np.pi * k * size * np.cos(k * self._turns(thrust)) for k, size in shares) if shares else 1.0

    def reading_tangents(self, tangents: np.ndarray, thrust: np.ndarray) -> np.ndarray:
        """Sensitivities (rows, ...) of the mean reading from those of the true thrust (rows,) N."""
        return (tangents.T * self.slope(thrust)).T if self._shares else tangents

    def _turns(self, thrust):
        return 2.0 * np.pi / self.count * (thrust - self.zero)


def grid(values: np.ndarray) -> tuple[float, float]:
    """(step, one value) of the grid of readings; (0, 0) without a grid."""
    seen = np.unique(values[np.isfinite(values)])
    gaps = np.diff(seen)
    # A converted unit adds rounding errors in the last digits.
    gaps = gaps[gaps > 1e-9 * np.ptp(seen)] if len(seen) else gaps
    if len(gaps) < 2:
        return 0.0, 0.0
    count = float(np.min(gaps))
    counts = gaps / count
    return (count, float(seen[0])) if np.all(np.abs(counts - np.round(counts)) < WHOLE * counts) else (0.0, 0.0)
