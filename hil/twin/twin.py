"""The model beside the rig: its thrust under the same commands, and an alarm when the difference leaves its band.

The residual's means over half a second are whitened and summed up, and so are the variances about them (`hil.twin.band`,
`hil.twin.cusum`): an offset and a vibration are both seen. As long as what the model's own error leaves in them stays
within the band's `model_error`, however it moves there, alarms are at most as frequent as stated: each step of a
cumulative sum grows with its input, so no such error makes it alarm sooner than the constant one it is set for.
"""

from typing import NamedTuple

from hil.twin.band import Band, Spread, Whitener
from hil.twin.cusum import Cusum, run_length, threshold_for
from vpp_fmu.plants import Plant

BLOCK = 0.5
"""s; a block's mean is nearly normal whatever the noise of a reading is, and neighbours are nearly independent."""

SHIFT = 3.0
"""What is to be found beyond the model's error, in standard deviations of a whitened block: a few times the noise, found in a
second or two."""


class Twinned(NamedTuple):
    """The model's thrust [N], what the rig has above it [N], and whether the alarm is on."""

    thrust: float
    residual: float
    alarmed: bool


class Twin:
    """A plant (an FMU or the kernel's functions) that runs along.

    `false_alarms`: at most so many an hour while nothing new happens. What that makes of the test: `smallest` [N], the
    constant residual that it finds after `delay` s on average, larger ones sooner. An alarm stays; `since` [s] is the
    likeliest time that it began.
    """

    def __init__(self, plant: Plant, band: Band, false_alarms: float = 0.01):
        self._plant, self._rows = plant, max(1, round(BLOCK / plant.dt))
        self._block = self._rows * plant.dt
        self._whitener = Whitener(band, self._rows, plant.dt)
        inside = band.model_error / self._whitener.scale
        reference, outside = inside + 0.5 * SHIFT, inside + SHIFT
        run = 2.0 * 3600.0 / false_alarms / self._block  # means and variances have half of the alarms each
        threshold = threshold_for(run, reference, inside)
        self._above, self._below = Cusum(threshold, reference), Cusum(threshold, reference)
        self._spread = Spread(band, self._rows, plant.dt)
        self._about = Cusum(threshold_for(run, 0.5 * SHIFT, 0.0, two_sided=False), 0.5 * SHIFT)
        self.false_alarms = false_alarms
        self.smallest = outside * self._whitener.scale / self._whitener.gain
        self.delay = run_length(threshold, reference, outside) * self._block
        self.start(0.0, 0.0, 0.0)

    def start(self, t: float, omega_ref: float, beta_ref: float) -> None:
        """At rest on the commands [rpm, deg] at time t [s]: the rig has settled there. What was before is forgotten."""
        self._thrust = self._plant.start(omega_ref, beta_ref).thrust
        self._time, self._held = t, (omega_ref, beta_ref)
        self._sum, self._squares, self._count = 0.0, 0.0, 0
        self.alarmed, self.since = False, None
        for part in (self._whitener, self._above, self._below, self._about):
            part.reset()

    def update(self, t: float, omega_ref: float, beta_ref: float, thrust: float) -> Twinned:
        """The thrust [N] measured at t [s], just before these commands [rpm, deg] act; the ones before them acted until t."""
        for _ in range(round((t - self._time) / self._plant.dt)):
            self._thrust = self._plant.step(*self._held).thrust
        self._time, self._held = t, (omega_ref, beta_ref)
        residual = thrust - self._thrust
        self._sum += residual
        self._squares += residual * residual
        self._count += 1
        if self._count == self._rows:
            self._decide(t, self._sum / self._rows)
            self._sum, self._squares, self._count = 0.0, 0.0, 0
        return Twinned(self._thrust, residual, self.alarmed)

    def _decide(self, t: float, mean: float) -> None:
        variance = max(self._squares - self._rows * mean * mean, 0.0) / (self._rows - 1)
        z = self._whitener.update(mean)
        tests = (self._above, z), (self._below, -z), (self._about, self._spread.update(variance))
        ages = [cusum.age for cusum, value in tests if cusum.update(value)]
        if ages and not self.alarmed:
            self.alarmed, self.since = True, t - max(ages) * self._block
