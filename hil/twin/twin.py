"""Simulate the model with the rig's commands, and raise an alarm if the thrust residual leaves its band.

Three tests share the allowed false alarms. Cumulative sums of the whitened residual means over half a second, and of the
variances about them (`hil.twin.band`, `hil.twin.cusum`), detect large offsets and vibrations within a second or two. Each sum
tolerates a bound of the model error: at constant commands the quantile for a quarter of the false alarms, and HALF of a change
of thrust in addition. A cumulative sum is monotonic in its input, so an error within the bound alarms no sooner than an error
at the bound. Small changes of one cause are detected over minutes of changing commands (`hil.twin.directions`).
"""

from math import hypot
from typing import NamedTuple

from hil.commands import PAPERS, operating_pitch
from hil.twin.band import Band, Spread, Whitener
from hil.twin.cusum import Cusum, run_length, threshold_for
from hil.twin.directions import CAUSES, EVERY, Directions, Grid
from vpp_fmu.plants import Plant, Sample
from vpp_fmu.rig import Rig

BLOCK = 0.5
"""Block duration, s. Block means are nearly normal for any noise of readings, and neighbours are nearly independent."""

SHIFT = 3.0
"""Shift beyond the model error for which the sums are designed, in standard deviations of a whitened block."""

HALF = 0.5
"""Tolerated error during a change of thrust, as a share of the change: a braking motor or an actuator at its slew limit is
not a linear lag, and a campaign gives no bound. In the next block a change counts half."""

TESTS = 4
"""Sums of means, sums of variances, the model error's bound in both, and causes: each has an equal share of false alarms."""


class Twinned(NamedTuple):
    """The model's thrust [N], the residual (rig minus model) [N], and whether the alarm is on."""

    thrust: float
    residual: float
    alarmed: bool


class Block(NamedTuple):
    """Half a second: the commands [rpm, deg] at its end; mean [N] and variance [N^2] of the residual; the model's mean thrust
    [N]; the smallest and largest outputs of the model since the previous block."""

    commands: tuple[float, float]
    mean: float
    variance: float
    thrust: float
    lowest: Sample
    highest: Sample


class Twin:
    """A plant (an FMU or the kernel's functions) simulated in parallel; `rig`: the ranges of its commands.

    `false_alarms`: most per hour in normal operation. Resulting sensitivity: `smallest` [N], the constant residual detected
    after `delay` s on average at constant commands; larger ones are detected sooner. An alarm is latched; `since` [s]: the
    likeliest time of the change; `cause`: the most significant cause.
    """

    def __init__(self, plant: Plant, band: Band, false_alarms: float = 0.01, rig: Rig = PAPERS):
        self._plant, self._rows, self._band = plant, max(1, round(BLOCK / plant.dt)), band
        self._block = self._rows * plant.dt
        self._whitener = Whitener(band, self._rows, plant.dt)
        rate = false_alarms / TESTS / 3600.0  # 1/s of each test
        self._most = band.deviations(rate * self._block)
        reference = 0.5 * SHIFT
        threshold = threshold_for(1.0 / (rate * self._block), reference, 0.0)
        self._above, self._below = Cusum(threshold, reference), Cusum(threshold, reference)
        self._spread = Spread(band, self._rows, plant.dt)
        self._about = Cusum(threshold_for(1.0 / (rate * self._block), reference, 0.0, two_sided=False), reference)
        self._error = hypot(band.steady, self._whitener.spread)
        self._directions = Directions(
            lambda omega, beta: plant.start(omega, beta).thrust,
            Grid.of(rig.speed, rig.scales.omega_scale),
            Grid.of(operating_pitch(rig), rig.scales.beta_scale),
            self._error,
            band.deviations(rate * EVERY / len(CAUSES)),
            self._block,
        )
        self.false_alarms = false_alarms
        self.smallest = (self._most * band.steady + SHIFT * self._whitener.scale) / self._whitener.gain
        self.delay = run_length(threshold, reference, SHIFT) * self._block
        self.start(0.0, 0.0, 0.0)

    @property
    def largest_error(self) -> float:
        """Bound of the model error at constant commands, N."""
        return self._most * self._band.steady

    def start(self, t: float, omega_ref: float, beta_ref: float) -> None:
        """Reset to the steady state at the commands [rpm, deg] at time t [s], at which the rig has settled."""
        self._shown = self._plant.start(omega_ref, beta_ref)
        self._time, self._held = t, (omega_ref, beta_ref)
        self._begin()
        self._moved = 0.0
        self.alarmed, self.since, self.cause = False, None, ""
        for part in (self._whitener, self._above, self._below, self._about, self._directions):
            part.reset()

    def _begin(self) -> None:
        """Begin a block."""
        self._sum = self._squares = self._total = 0.0
        self._count, self._lowest, self._highest = 0, self._shown, self._shown

    def update(self, t: float, omega_ref: float, beta_ref: float, thrust: float) -> Twinned:
        """Add the thrust [N] measured at t [s], just before these commands [rpm, deg] act; the previous ones acted until t."""
        for _ in range(round((t - self._time) / self._plant.dt)):
            self._shown = self._plant.step(*self._held)
        shown, residual = self._shown, thrust - self._shown.thrust
        self._sum += residual
        self._squares += residual * residual
        self._total += shown.thrust
        self._lowest = Sample(*map(min, self._lowest, shown))
        self._highest = Sample(*map(max, self._highest, shown))
        self._count += 1
        if self._count == self._rows:
            mean = self._sum / self._rows
            variance = max(self._squares - self._rows * mean * mean, 0.0) / max(self._rows - 1, 1)
            self.decide(t, Block(self._held, mean, variance, self._total / self._rows, self._lowest, self._highest))
            self._begin()
        self._time, self._held = t, (omega_ref, beta_ref)
        return Twinned(shown.thrust, residual, self.alarmed)

    def decide(self, t: float, block: Block) -> None:
        """Test a block that ended at t [s]. `update` calls it; use it directly for given blocks."""
        self._moved = self._move(block.lowest, block.highest) + HALF * self._moved
        most, whitened = self._most * self._band.steady + HALF * self._moved, self._whitener.update(block.mean)
        tolerated = most / self._whitener.scale
        spread = self._spread.update(block.variance, most)
        tests = (self._above, whitened - tolerated), (self._below, -whitened - tolerated), (self._about, spread)
        ages = [cusum.age * self._block for cusum, value in tests if cusum.update(value)]
        share = self._error**2 / (self._error**2 + (self._band.moving * self._moved) ** 2)
        if self._directions.update(block.commands, block.mean, block.thrust, share):
            ages.append(self._directions.age)
        if ages and not self.alarmed:
            self.alarmed, self.since, self.cause = True, t - max(ages), self._directions.cause

    def _move(self, lowest: Sample, highest: Sample) -> float:
        """Change of the model's thrust [N] due to speed plus that due to pitch, in absolute values: they may cancel."""
        omega, beta = 0.5 * (lowest.omega + highest.omega), 0.5 * (lowest.beta + highest.beta)
        by_speed = 2.0 * max(abs(lowest.thrust), abs(highest.thrust)) / max(omega, 1.0)
        by_pitch = abs(self._directions.slope(omega, beta))
        return by_speed * (highest.omega - lowest.omega) + by_pitch * (highest.beta - lowest.beta)
