"""Detect slow or small constant changes of thrust, pitch or reading, over minutes of changing commands.

Over half a second such a change cannot be distinguished from the model error. But the model error differs between cells of the
thrust map, and the effect of one cause does not. So the residual is averaged per cell with a memory of MEMORY s, and its mean m
is regressed on the signature g of a cause in that cell: relative thrust, pitch by a degree, reading by a newton. The variance
of m is V = error^2 (1 + SPAN / time spent in the cell), with error^2 that of a mean over half a second at constant commands.

    z = sum(g m / V) / sqrt(sum(g^2 / V))

is standard normal without such a cause, or Student's t if the error is estimated from a short campaign. A single cell gives no
more information than its own error; a constant set point is monitored by the sums of hil.twin.twin.
"""

from collections.abc import Callable
from math import ceil, exp, sqrt
from typing import NamedTuple

MEMORY = 120.0
"""Forgetting time constant, s. A short memory detects a drift sooner, a long one detects smaller changes."""

SPAN = 2.0
"""s within which the model error in a cell is constant: a longer visit adds no independent sample."""

EVERY = 10.0
"""s between two tests; each has its share of false alarms."""

PLACE = 0.2
"""Size of a cell, as a share of the scales of speed and pitch. Errors of the thrust map in different cells are nearly
independent, as in `identification.assessment.model_error`."""

CAUSES = ("thrust x {:.2f}", "pitch {:+.2f} deg", "reading {:+.2f} N")


class Grid(NamedTuple):
    """`count` equal parts between two values."""

    low: float
    high: float
    count: int

    @classmethod
    def of(cls, span: tuple[float, float], scale: float) -> "Grid":
        """A grid of parts of at most PLACE of a scale."""
        return cls(*span, max(1, ceil((span[1] - span[0]) / (PLACE * scale) - 1e-9)))

    @property
    def middles(self) -> list[float]:
        return [self.low + (k + 0.5) / self.count * (self.high - self.low) for k in range(self.count)]

    def part(self, value: float) -> int:
        """Index of the part that contains, or is nearest to, a value."""
        if self.high == self.low:
            return 0
        return min(max(int(self.count * (value - self.low) / (self.high - self.low)), 0), self.count - 1)


class Directions:
    """`settled(omega_ref, beta_ref)`: the model's steady thrust [N] at commands [rpm, deg]; `speed`, `pitch`: grids of the
    cells [rpm, deg]. `error` [N]: standard deviation of a block's mean residual in a cell. `most`: threshold of |z|. `block`:
    duration of a block, s."""

    def __init__(
        self,
        settled: Callable[[float, float], float],
        speed: Grid,
        pitch: Grid,
        error: float,
        most: float,
        block: float,
    ):
        self._speed, self._pitch, self._variance, self._most = speed, pitch, error**2, most
        self._keep, self._span, self._looks = exp(-block / MEMORY), SPAN / block, max(1, round(EVERY / block))
        places = [(omega, beta) for omega in speed.middles for beta in pitch.middles]
        self._slopes = [settled(omega, beta + 0.5) - settled(omega, beta - 0.5) for omega, beta in places]
        self._block = block
        self.reset()

    def reset(self) -> None:
        """Forget all residuals."""
        self._weights, self._residuals, self._thrusts = ([0.0] * len(self._slopes) for _ in range(3))
        self._count, self._calm = 0, 0

    def update(self, commands: tuple[float, float], residual: float, thrust: float, share: float) -> bool:
        """Add a block's mean residual and model thrust [N] at `commands` [rpm, deg], with the steady error's variance divided
        by `share`. Whether a cause is detected."""
        for column in (self._weights, self._residuals, self._thrusts):
            column[:] = [self._keep * value for value in column]
        place = self._place(*commands)
        self._weights[place] += share
        self._residuals[place] += share * residual
        self._thrusts[place] += share * thrust
        self._count += 1
        if self._count % self._looks:
            return False
        largest = max(abs(self._size(k)[1]) for k in range(len(CAUSES)))
        if largest < 1.0:
            self._calm = self._count
        return largest > self._most

    def slope(self, omega: float, beta: float) -> float:
        """Thrust per pitch [N/deg] in the cell of speed [rpm] and pitch [deg]."""
        return self._slopes[self._place(omega, beta)]

    @property
    def cause(self) -> str:
        """The most significant cause, in words."""
        sizes = [self._size(k) for k in range(len(CAUSES))]
        k = max(range(len(CAUSES)), key=lambda k: abs(sizes[k][1]))
        return CAUSES[k].format(sizes[k][0] + (1.0 if k == 0 else 0.0))

    @property
    def age(self) -> float:
        """s since all |z| were last below 1: the likeliest time of the change."""
        return (self._count - self._calm) * self._block

    def _place(self, omega: float, beta: float) -> int:
        return self._pitch.count * self._speed.part(omega) + self._pitch.part(beta)

    def _size(self, cause: int) -> tuple[float, float]:
        """(size of a cause by least squares, its z)."""
        product = squares = 0.0
        for place, weight in enumerate(self._weights):
            if weight > 1e-3:
                signature = (self._thrusts[place] / weight, self._slopes[place], 1.0)[cause]
                precision = weight / (weight + self._span) / self._variance
                product += precision * signature * self._residuals[place] / weight
                squares += precision * signature**2
        return (product / squares, product / sqrt(squares)) if squares else (0.0, 0.0)
