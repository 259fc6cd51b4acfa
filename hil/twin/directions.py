"""What is slowly or slightly off: thrust, pitch or the reading changed by a constant, seen over minutes of changing commands.

Half a second can't tell it from the model's own error. That error differs from place to place of the thrust map, though, and
what has one cause does not. So the residual is averaged by place, with a memory of MEMORY s, and its mean m in each is held
against what a cause would make of it there, g: relative thrust, pitch by a degree, the reading by a newton. With the variance
V = error^2 (1 + SPAN / time spent there) of m, error^2 that of the mean over half a second while the commands stand,

    z = sum(g m / V) / sqrt(sum(g^2 / V))

is a normal number where there is no such cause, or one of Student's where the error is known from a short campaign. One place
alone tells no more than its own error does; a set-point that never moves is left to the sums of hil.twin.twin.
"""

from collections.abc import Callable
from math import ceil, exp, sqrt
from typing import NamedTuple

MEMORY = 120.0
"""s after which a residual counts 1 / e. A drift is found sooner by a short memory, what is small by a long one."""

SPAN = 2.0
"""s of a visit over which the model's error stays about the same: no more of them are known from it than from this."""

EVERY = 10.0
"""s between two looks; each has its share of false alarms."""

PLACE = 0.2
"""Of the scales of speed and pitch: commands in different places find errors of a thrust map that have little to do with each
other, as `identification.assessment.model_error` counts them."""

CAUSES = ("thrust x {:.2f}", "pitch {:+.2f} deg", "reading {:+.2f} N")


class Grid(NamedTuple):
    """`count` equal parts between two values."""

    low: float
    high: float
    count: int

    @classmethod
    def of(cls, span: tuple[float, float], scale: float) -> "Grid":
        """As many as PLACE of a scale asks for."""
        return cls(*span, max(1, ceil((span[1] - span[0]) / (PLACE * scale) - 1e-9)))

    @property
    def middles(self) -> list[float]:
        return [self.low + (k + 0.5) / self.count * (self.high - self.low) for k in range(self.count)]

    def part(self, value: float) -> int:
        """Which one a value lies in, or next to."""
        if self.high == self.low:
            return 0
        return min(max(int(self.count * (value - self.low) / (self.high - self.low)), 0), self.count - 1)


class Directions:
    """`settled(omega_ref, beta_ref)`: the model's settled thrust [N] at commands [rpm, deg], asked for at the places; `speed`,
    `pitch`: in how many, and between what [rpm, deg], these are. `error` [N]: standard deviation of a block's mean residual at
    a place. `most`: what z exceeds in an alarm. A block takes `block` s."""

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
        """Nothing is known."""
        self._weights, self._residuals, self._thrusts = ([0.0] * len(self._slopes) for _ in range(3))
        self._count, self._calm = 0, 0

    def update(self, commands: tuple[float, float], residual: float, thrust: float, share: float) -> bool:
        """A block's mean residual and thrust of the model [N] under `commands` [rpm, deg]; its error's variance is the steady
        one's over `share`. Whether a cause shows now."""
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
        """N/deg about speed [rpm] and pitch [deg], by the place that they lie in."""
        return self._slopes[self._place(omega, beta)]

    @property
    def cause(self) -> str:
        """What the residual is most like, in words."""
        sizes = [self._size(k) for k in range(len(CAUSES))]
        k = max(range(len(CAUSES)), key=lambda k: abs(sizes[k][1]))
        return CAUSES[k].format(sizes[k][0] + (1.0 if k == 0 else 0.0))

    @property
    def age(self) -> float:
        """s since z last was an ordinary number: the likeliest beginning of what was then found."""
        return (self._count - self._calm) * self._block

    def _place(self, omega: float, beta: float) -> int:
        return self._pitch.count * self._speed.part(omega) + self._pitch.part(beta)

    def _size(self, cause: int) -> tuple[float, float]:
        """(size of a cause by least squares, its z)."""
        told = squares = 0.0
        for place, weight in enumerate(self._weights):
            if weight > 1e-3:
                signature = (self._thrusts[place] / weight, self._slopes[place], 1.0)[cause]
                precision = weight / (weight + self._span) / self._variance
                told += precision * signature * self._residuals[place] / weight
                squares += precision * signature**2
        return (told / squares, told / sqrt(squares)) if squares else (0.0, 0.0)
