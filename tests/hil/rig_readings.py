"""Readings of the rig's loop from the physical model under the speed loop, to test the plausibility checks."""

import math
import random

from hil.physics.rig_model import library, powertrain
from hil.physics.speed_pi import SpeedPi
from hil.safety.limits import Limiter, Limits
from hil.safety.plausibility import Plausibility, Reading
from vpp_fmu.native.stepper import Stepper

DT = 0.004
SPIN_UP = 3.0
NEWTON_PER_COUNT = 0.004
NOISE = 25.0  # counts


class Tachometer:
    """One mark a revolution, times to 4 us, the speed of the last whole revolution."""

    def __init__(self):
        self.pulses, self.last, self.period, self.angle = 0, 0.0, math.inf, 0.0

    def see(self, t, dt, angle):
        """The shaft turns to `angle` [turns] from t to t + dt [s]."""
        if math.floor(angle) > math.floor(self.angle):
            passed = t + dt * (math.floor(angle) - self.angle) / (angle - self.angle)
            passed = round(passed / 4e-6) * 4e-6
            self.period = passed - self.last if self.pulses else math.inf
            self.last, self.pulses = passed, self.pulses + 1
        self.angle = angle

    def speed(self, now):
        return 0.0 if now - self.last > 0.2 else 60.0 / self.period


def probes(hidden):
    """Parameter values at which the hidden effects are visible, by full name."""
    return {e.full(name): value for e in library(False) if e.name in hidden for name, value in e.probe.items()}


def run(profile, seconds, spoil=lambda t, reading: reading, stuck_at=math.inf, hidden=(), seed=0):
    """(first fault or None, its time [s]) of a run that starts at rest and follows `profile(t) -> (rpm, deg)`.

    `spoil` may change a reading; the speed loop gets the changed one, and is frozen while plausibility distrusts the speed.
    From `stuck_at` on the blades do not move. Time 0 is the end of the spin-up.
    """
    model = powertrain(hidden)
    outputs, rig = [y.name for y in model.outputs], Stepper(model, probes(hidden))
    thrust, angle = outputs.index("thrust"), outputs.index("angle")
    rig.start([0.0, 0.0, 24.0])
    loop, limiter, checks, mark = SpeedPi(), Limiter(Limits()), Plausibility(Limits(), DT), Tachometer()
    noise, throttle, beta, blades = random.Random(seed), 0.0, 0.0, 0.0
    for k in range(round((SPIN_UP + seconds) / DT)):
        start, now = k * DT - SPIN_UP, (k + 1) * DT - SPIN_UP
        blades = beta if now < stuck_at else blades
        rows = [rig.step([throttle, blades, 24.0], 0.001) for _ in range(4)]
        for j, row in enumerate(rows):
            mark.see(start + 0.001 * j, 0.001, row[angle])
        counts = round(rows[-1][thrust] / NEWTON_PER_COUNT + noise.gauss(0.0, NOISE))
        age = min(now - mark.last, 10.0)
        newton = counts * NEWTON_PER_COUNT
        reading = Reading(now, counts, False, newton, 0.002, mark.speed(now), mark.pulses, age, 0.004, throttle, beta)
        reading = spoil(now, reading)
        if fault := checks.check(reading):
            return fault, now
        move = limiter.ramp if now < 0.0 else limiter.apply
        omega_ref, beta, *_ = move(*profile(now), DT)
        throttle = loop.update(omega_ref, reading.omega, DT, frozen=not checks.speed_trusted)
    return None, now


def steps(seed, hold=2.0):
    """Random speed and pitch, drawn anew every `hold` seconds."""
    dice = random.Random(seed)
    levels = [(dice.uniform(2000.0, 6000.0), dice.uniform(-8.0, 10.0)) for _ in range(200)]
    return lambda t: levels[int(max(t, 0.0) / hold)]
