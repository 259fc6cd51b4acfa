"""What a converter of few counts shows on average: rounding is no noise, it repeats where the commands do.

With noise of `blur` (in counts) ahead of it, the mean reading of a true value x, in counts, is (Widrow and Kollar, Quantization
Noise, 2008, chapter 3)

    E[round(x + n)] = x + sum over k of (-1)^k / (pi k) sin(2 pi k x) exp(-2 pi^2 k^2 blur^2)

A converter that cuts instead of rounding reads half a count less everywhere, which the fitted level takes up.
"""

from dataclasses import dataclass

import numpy as np

LEAST = 0.25
"""Least blur, counts: of less the mean is a staircase, which no fit descends; a prediction is not that exact either."""

NEGLIGIBLE = 1e-4
"""Counts, below which a term of the sum is left out."""

WHOLE = 0.01
"""Counts by which differences of readings may miss whole ones."""


@dataclass(frozen=True)
class Converter:
    """Readings on a grid of `count` [N] with `zero` [N] on it, 0 where there is none; `blur`: counts, the noise ahead of it."""

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
        """(k, counts) of the terms that matter."""
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
        """Derivative (rows,) of the mean reading in the true thrust."""
        shares = self._shares
        return 1.0 + sum(2.0 * np.pi * k * size * np.cos(k * self._turns(thrust)) for k, size in shares) if shares else 1.0

    def _turns(self, thrust):
        return 2.0 * np.pi / self.count * (thrust - self.zero)


def grid(values: np.ndarray) -> tuple[float, float]:
    """(distance, one value) of the grid that readings stand on; (0, 0) where they stand on none."""
    seen = np.unique(values[np.isfinite(values)])
    apart = np.diff(seen)
    apart = (
        apart[apart > 1e-9 * np.ptp(seen)] if len(seen) else apart
    )  # a unit that was converted leaves rounding in the digits
    if len(apart) < 2:
        return 0.0, 0.0
    count = float(np.min(apart))
    counts = apart / count
    return (count, float(seen[0])) if np.all(np.abs(counts - np.round(counts)) < WHOLE * counts) else (0.0, 0.0)
