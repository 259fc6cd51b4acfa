"""Read the rig's sensors at each tick. An error that a device cannot recover is a fault; its last reading is held."""

import contextlib
import math

from hil.devices.clock import Clock
from hil.devices.supply import NAMES
from hil.devices.tachometer import Revolution
from hil.loop.bench import Bench
from hil.safety.faults import DeviceFault, Fault

PATIENCE = 25
"""Requests to the tachometer after a break before a missing answer is a fault: 0.1 s."""


class Sensors:
    """The last readings: `counts` of the ADC and whether `saturated`; `thrust` [N] above the tare's `zero` [counts] and its age
    [s]; speed `omega` [rpm] of the last whole revolution, 0 at standstill, and the age [s] of the mark's last pass; the
    tachometer's last answer and its age `speed_age` [s]; readings of the `supply` by name, NaN if not read."""

    def __init__(self, bench: Bench, zero: float):
        self._bench, self.zero = bench, zero
        self.counts, self.saturated, self.thrust, self.thrust_age = 0, False, 0.0, math.inf
        self.omega, self.mark_age, self.speed_age = 0.0, math.inf, math.inf
        self.revolution: Revolution | None = None
        self.supply = bench.supply.values if bench.supply else dict.fromkeys(NAMES, math.nan)

    def wake(self, clock: Clock, pause: float) -> None:
        """Request the tachometer after a break, with `pause` s for each answer; afterwards a missing answer is a fault.

        The last answer is as old as the break, so several requests are needed if the computer stalls at that moment.
        """
        answer = None
        for k in range(PATIENCE):
            with contextlib.suppress(DeviceFault):
                self._bench.tachometer.request()
                clock.wait_until(clock.now() + pause)
                answer = self._bench.tachometer.poll() or answer
            if answer is not None and k >= 2:
                return

    def read(self, passed: float) -> list[Fault]:
        """Read all sensors, `passed` s after the last time."""
        bench, faults = self._bench, []
        self.thrust_age += passed
        try:
            conversion = bench.adc.read()
            self.counts, self.saturated, self.thrust_age = conversion.counts, conversion.saturated, conversion.age
            self.thrust = bench.calibration.thrust(conversion.counts, self.zero)
        except DeviceFault as failed:
            faults.append(failed.fault)
        if bench.supply:
            try:
                bench.supply.read()
            except DeviceFault as failed:
                faults.append(failed.fault)
        answer = None
        self.mark_age += passed
        try:
            answer = bench.tachometer.poll()
            bench.tachometer.request()
        except DeviceFault as failed:
            faults.append(failed.fault)
        if answer is not None:
            self.revolution, self.mark_age = answer, answer.age
            self.omega = 0.0 if answer.stalled else answer.omega
        self.speed_age = bench.clock.now() - self.revolution.received if self.revolution else math.inf
        return faults
