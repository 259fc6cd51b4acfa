"""Compare every reading with the limits of physics, once a tick. Errors reported by a bus or a device are DeviceFaults."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from hil.devices.supply import NAMES
from hil.safety.faults import Fault, FaultKind
from hil.safety.limits import Limits
from hil.safety.pitch_effect import PitchEffect
from hil.safety.rotor_bounds import RotorBounds, RotorPhysics
from vpp_fmu.kernel.scales import PAPER
from vpp_fmu.rig import Rig

HELD_REVOLUTIONS = 3
"""A mark that is missed once causes one late pass and one halved speed; the next revolution is right again."""

SAME = 1e-4
"""s; conversions closer in time are one and the same."""

BEYOND = 2
"""Readings in a row beyond a limit that are a fault: a single one can be a spark."""


class Reading(NamedTuple):
    """One tick: the readings, and the outputs at that time.

    `t` [s]; `counts` of the ADC, whether `saturated`; `thrust` [N] with `thrust_age` [s]; `omega` [rpm] over the last
    revolution; `pulses`, passes of the mark so far; `mark_age` [s] since the last of them; `speed_age` [s] since the
    tachometer's last valid answer; `throttle` [0..1], `beta_ref` [deg].
    """

    t: float
    counts: int
    saturated: bool
    thrust: float
    thrust_age: float
    omega: float
    pulses: int
    mark_age: float
    speed_age: float
    throttle: float
    beta_ref: float


@dataclass(frozen=True)
class Thresholds:
    """Thresholds at which a reading is a fault.

    `hold` [s]: tolerated duration of an impossible speed, with the speed loop frozen. It is at least three revolutions at the
    lower speed bound, or at `slow` [rpm] if the bound is lower. `stale` [s]: largest age of a reading. `frozen`: equal ADC
    readings in a row; with an amplifier's noise of 2 counts two neighbours are equal in 1 of 7 cases and twelve once in 100
    days at 250 Hz, and the rig's noise is ten times that. `saturated`, `over_thrust`: readings in a row, since one can be a
    spark. `starts` [s]: time at a throttle of `open` without a revolution, longer than an ESC takes to start a motor. Above a
    throttle of `wide` (2600 rpm without a load) no time is allowed: the motor turns or never will, and the speed loop would
    open it further. `effect` [1], `moved` [N^2 s]: the blades are stuck if less than this share of their expected effect is
    measured, after this much excitation (2 N for a quarter of a second).
    """

    hold: float = 0.05
    slow: float = 600.0
    stale: float = 0.05
    frozen: int = 12
    saturated: int = 3
    over_thrust: int = 3
    open: float = 0.05
    starts: float = 2.0
    wide: float = 0.2
    effect: float = 0.4
    moved: float = 1.0
    rotor: RotorPhysics = field(default_factory=RotorPhysics)


def thresholds_of(rig: Rig) -> Thresholds:
    """The thresholds of a rig: the paper's, scaled by the rig's scales, which a narrowed range does not change. The motor is
    assumed to have the paper's reserve of speed, since no file states it. The time constants' bounds widen with the rig's time
    scale and never narrow."""
    size, own, whole = rig.scales.omega_scale / PAPER.omega_scale, RotorPhysics(), Thresholds()
    force, longer = rig.scales.thrust_scale / PAPER.thrust_scale, rig.scales.time_scale / PAPER.time_scale
    rotor = replace(
        own,
        free=size * own.free,
        jitter=size * own.jitter,
        tau_fast=min(longer, 1.0) * own.tau_fast,
        tau_slow=max(longer, 1.0) * own.tau_slow,
    )
    return replace(whole, slow=size * whole.slow, moved=force**2 * longer * whole.moved, rotor=rotor)


class Plausibility:
    """The checks with their memory. `speed_trusted`: whether the speed loop may use the last reading; frozen if not.

    `parameters`: of the plant by the kernel's names, for the effect of pitch on thrust (default: the paper's); `time_scale`
    [s]: of the rig.
    """

    def __init__(
        self,
        limits: Limits,
        dt: float,
        parameters: Mapping[str, float] | None = None,
        thresholds: Thresholds | None = None,
        time_scale: float = PAPER.time_scale,
    ):
        self._limits, self._thresholds = limits, thresholds or Thresholds()
        self._rotor, self._pitch = RotorBounds(self._thresholds.rotor), PitchEffect(dt, parameters, time_scale)
        self._last: Reading | None = None
        self._equal = self._saturated = self._heavy = 0
        self._doubted: Reading | None = None
        self._open_since: float | None = None

    @property
    def speed_trusted(self) -> bool:
        return self._doubted is None

    def check(self, now: Reading) -> Fault | None:
        """The first fault of a tick, or None."""
        before, self._last = self._last, now
        if before is None:
            before = now._replace(t=-math.inf, counts=None)
            self._rotor.believe(now.omega, 0.0, 0.0)
        found = self._numbers(now, before) or self._ages(now) or self._adc(now, before) or self._speed(now, before)
        if found is None and self.speed_trusted and self._rotor.turning:
            found = self._blades(now)
        return found

    def _numbers(self, now: Reading, before: Reading) -> Fault | None:
        if not math.isfinite(sum(now)):
            wrong = ", ".join(f"{name} {value}" for name, value in now._asdict().items() if not math.isfinite(value))
            found = wrong or "an infinite sum of the readings"
            return Fault("loop", FaultKind.NOT_A_NUMBER, f"found {found}, expected finite numbers")
        if now.t <= before.t:
            return Fault("loop", FaultKind.TIME_BACKWARDS, f"found {now.t:.6f} s, expected more than {before.t:.6f} s")
        return None

    def _ages(self, now: Reading) -> Fault | None:
        for device, age in (("adc", now.thrust_age), ("tachometer", now.speed_age)):
            if age > self._thresholds.stale:
                return Fault(device, FaultKind.STALE, f"found a reading {1e3 * age:.0f} ms old, expected a newer one")
        return None

    def _adc(self, now: Reading, before: Reading) -> Fault | None:
        own, trip = self._thresholds, self._limits.thrust_trip
        # A reading that was held while the bus failed is not counted; its age reveals it.
        if now.t - now.thrust_age > before.t - before.thrust_age + SAME:
            self._equal = self._equal + 1 if now.counts == before.counts else 1
        self._saturated = self._saturated + 1 if now.saturated else 0
        self._heavy = self._heavy + 1 if abs(now.thrust) > trip else 0
        if self._saturated >= own.saturated:
            return Fault("adc", FaultKind.SATURATED, f"found {now.counts} counts {self._saturated} times, expected less")
        if self._equal >= own.frozen:
            return Fault("adc", FaultKind.FROZEN, f"found {now.counts} counts {self._equal} times in a row, expected noise")
        if self._heavy >= own.over_thrust:
            return Fault("rig", FaultKind.OVER_THRUST, f"found {now.thrust:.1f} N, expected at most {trip:g} N")
        return None

    def _speed(self, now: Reading, before: Reading) -> Fault | None:
        rotor, dt = self._rotor, min(now.t - before.t, 1.0)
        rotor.advance(now.throttle, dt)
        possible, missed = True, False
        if now.pulses != before.pulses or now.omega != before.omega:
            possible = rotor.allows(now.omega)
            if possible:
                rotor.believe(now.omega, now.throttle, now.mark_age + 60.0 / now.omega if now.omega > 0.0 else 0.0)
        elif now.omega > 0.0:
            missed = rotor.misses(now.mark_age - now.speed_age)  # as it was when the tachometer last answered
        still_doubted = self._doubted is not None and now.pulses == before.pulses
        if possible and not missed and not still_doubted:
            self._doubted = None
        elif self._doubted is None:
            self._doubted = now
        return self._doubtful(now) or self._over_speed(now) or self._at_standstill(now)

    def _doubtful(self, now: Reading) -> Fault | None:
        low, high, first, own = self._rotor.low, self._rotor.high, self._doubted, self._thresholds
        if first is None or now.t - first.t < max(own.hold, HELD_REVOLUTIONS * 60.0 / max(low, own.slow)):
            return None
        if now.pulses == first.pulses or now.omega == 0.0:
            detail = f"found no revolution for {1e3 * now.mark_age:.0f} ms, expected {low:.0f} rpm or more"
            return Fault("tachometer", FaultKind.NO_ROTATION, detail)
        detail = f"found {now.omega:.0f} rpm, expected {low:.0f} to {high:.0f} rpm"
        return Fault("tachometer", FaultKind.SPEED_JUMP, detail)

    def _over_speed(self, now: Reading) -> Fault | None:
        if self._doubted is None and now.omega > self._limits.omega_trip:
            detail = f"found {now.omega:.0f} rpm, expected at most {self._limits.omega_trip:g} rpm"
            return Fault("rig", FaultKind.OVER_SPEED, detail)
        return None

    def _at_standstill(self, now: Reading) -> Fault | None:
        if self._rotor.turning or now.throttle < self._thresholds.open:
            self._open_since = None
            return None
        self._open_since = now.t if self._open_since is None else self._open_since
        if now.t - self._open_since < self._thresholds.starts and now.throttle < self._thresholds.wide:
            return None
        detail = f"found none at throttle {now.throttle:.2f} for {now.t - self._open_since:.1f} s, expected revolutions"
        return Fault("tachometer", FaultKind.NO_ROTATION, detail)

    def _blades(self, now: Reading) -> Fault | None:
        own, pitch = self._thresholds, self._pitch
        pitch.update(now.thrust, now.omega, now.beta_ref)
        if pitch.moved < own.moved or pitch.bound > own.effect:
            return None
        detail = f"found {100.0 * pitch.effect:.0f} % of the change of thrust that the pitch command gives, expected 100 %"
        return Fault("pitch actuator", FaultKind.STUCK_ACTUATOR, detail)


UNITS = NAMES | {"power": "W"}
"""Units of the limited quantities."""


class SupplyLimits:
    """Checks each new reading of the motor's supply while the rotor is driven."""

    def __init__(self, limits: Limits):
        self._ranges = {
            "voltage": (limits.voltage_min, limits.voltage_max),
            "current": (-limits.current_max, limits.current_max),
            "temperature": (-math.inf, limits.temperature_max),
            "power": (-math.inf, limits.power_max),
        }
        self._beyond: Counter[str] = Counter()

    def check(self, values: Mapping[str, float], new: Iterable[str]) -> Fault | None:
        """Check the `new` ones of the `values` by name; the fault of the first beyond its limit BEYOND times in a row."""
        read = {**values, "power": values.get("voltage", math.nan) * values.get("current", math.nan)}
        looked = [name for name in new if name in self._ranges]
        if math.isfinite(read["power"]) and {"voltage", "current"} & set(new):
            looked.append("power")
        for name in looked:
            low, high = self._ranges[name]
            inside = low <= read[name] <= high
            self._beyond[name] = 0 if inside else self._beyond[name] + 1
            if self._beyond[name] >= BEYOND:
                unit, bound = UNITS[name], f"at least {low:g}" if read[name] < low else f"at most {high:g}"
                return Fault("supply", FaultKind.SUPPLY, f"{name}: found {read[name]:.1f} {unit}, expected {bound} {unit}")
        return None
