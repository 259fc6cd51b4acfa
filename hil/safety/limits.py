"""Limits of the rig's commands, independent of the controller; checked directly before the outputs."""

import math
import os
from dataclasses import dataclass, field, fields, replace
from enum import IntFlag
from typing import NamedTuple

from hil.commands import PAPERS
from hil.devices.entries import Entries, NumberEntry
from hil.safety.faults import Fault, FaultKind
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.scales import PAPER
from vpp_fmu.rig import DECLARED, Rig
from vpp_fmu.structured import read_json

FORMAT = "vpp-limits/1"

OVER_SPEED, OVER_THRUST = 1.15, 5.0 / 3.0
"""Levels that stop the rotor at once, as multiples of the rig's highest speed and largest absolute thrust: 6900 rpm and 25 N
for the paper's rig, more than overshoot and noise reach."""

SLEW = 5.0 / 3.0, 1.5
"""Default slew rates, in highest speeds and pitch ranges per time scale: 20 000 rpm/s and 60 deg/s for the paper's rig. They do
not slow a step. Its rotor answers a step of 4000 rpm with at most 13 800 rpm/s (two lags, 0.172 and 0.053 s), its pitch a step
of 15 deg with at most 46 deg/s (0.207 and 0.05 s)."""

RAMP = 1.5, 1.0
"""Durations, s, of a slow spin-up to the highest speed and of a slow move over the pitch range; longer for a rig that is slower
than the paper's."""


def _derived(rig: Rig) -> dict[str, float]:
    """Default limits of a rig, by name: its ranges, and margins over them."""
    unit, (low, high), (least, most) = rig.scales.time_scale, rig.speed, rig.pitch
    longer = max(unit / PAPER.time_scale, 1.0)
    turned = max(most - least, PAPER.beta_scale)  # blades with almost no range still have to come from their rest position
    slews = [
        declared if math.isfinite(declared) else share * size / unit
        for declared, share, size in zip((rig.speed_slew, rig.pitch_slew), SLEW, (high, turned), strict=True)
    ]
    return {
        "omega_min": low,
        "omega_max": high,
        "omega_trip": round(OVER_SPEED * high, 6),
        "beta_min": least,
        "beta_max": most,
        "thrust_trip": round(OVER_THRUST * max(map(abs, rig.thrust)), 6),
        "omega_slew": slews[0],
        "beta_slew": slews[1],
        "omega_ramp": min(high / (RAMP[0] * longer), slews[0]),
        "beta_ramp": min(turned / (RAMP[1] * longer), slews[1]),
    }


_OF_PAPERS = _derived(PAPERS)


def _limit(default: float | str, unit: str, lowest: float, highest: float, meaning: str):
    """A field; its default is a number, or the name of a limit of the paper's rig."""
    value = _OF_PAPERS[default] if isinstance(default, str) else default
    return field(default=value, metadata={"number": NumberEntry(unit, lowest, highest), "meaning": meaning})


@dataclass(frozen=True)
class Limits:
    """The limits with the paper's rig as default; each field's metadata hold its `number` (unit and range) and its `meaning`.

    Values beyond any rig's are refused: commands above 100 000 rpm, a thrust above 10 000 N.
    """

    omega_min: float = _limit("omega_min", "rpm", 0.0, 1e5, "lowest commanded speed of a run")
    omega_max: float = _limit("omega_max", "rpm", 10.0, 1e5, "highest commanded speed")
    omega_trip: float = _limit("omega_trip", "rpm", 10.0, 1.2e5, "measured speed that stops the rotor at once")
    beta_min: float = _limit("beta_min", "deg", -90.0, 90.0, "lowest commanded pitch")
    beta_max: float = _limit("beta_max", "deg", -90.0, 90.0, "highest commanded pitch")
    thrust_trip: float = _limit("thrust_trip", "N", 0.01, 1e4, "measured thrust, of either sign, that stops the rotor at once")
    omega_slew: float = _limit("omega_slew", "rpm/s", 1.0, 1e9, "steepest commanded speed")
    beta_slew: float = _limit("beta_slew", "deg/s", 0.01, 1e9, "steepest commanded pitch")
    omega_ramp: float = _limit("omega_ramp", "rpm/s", 1.0, 1e7, "slope of spin-up and ramp-down")
    beta_ramp: float = _limit("beta_ramp", "deg/s", 0.01, 1e5, "slope of pitch in spin-up and ramp-down")
    run_time: float = _limit(3600.0, "s", 1.0, 86400.0, "longest time in RUN")
    late: float = _limit(0.05, "s", 0.001, 0.1, "lateness of one tick that ends the run")
    missed_share: float = _limit(0.1, "1", 0.0, 0.5, "share of the ticks of a second that may be missed")

    voltage_min: float = _limit(
        0.0, "V", 0.0, 1000.0, "lowest voltage of the supply while the rotor is driven, where it is read"
    )
    voltage_max: float = _limit(1000.0, "V", 0.0, 1000.0, "highest voltage")
    current_max: float = _limit(1000.0, "A", 0.0, 1000.0, "largest current, of either sign")
    power_max: float = _limit(1e5, "W", 0.0, 1e5, "highest power, where voltage and current are read")
    temperature_max: float = _limit(1000.0, "degC", 0.0, 1000.0, "highest temperature")

    def __post_init__(self):
        for one in fields(self):
            number, value = one.metadata["number"], getattr(self, one.name)
            if not number.lowest <= value <= number.highest:
                raise ValueError(one.name, value, number.allowed)
        for lower, upper in (("omega_min", "omega_max"), ("beta_min", "beta_max"), ("voltage_min", "voltage_max")):
            if not getattr(self, lower) <= getattr(self, upper):
                raise ValueError(upper, getattr(self, upper), f"at least {lower}, {getattr(self, lower):g}")
        if not self.omega_max < self.omega_trip:
            raise ValueError("omega_trip", self.omega_trip, f"more than omega_max, {self.omega_max:g}")


def limits_of(rig: Rig, where: str = "rig") -> Limits:
    """The limits derived from a rig. BadInput names `where` and the value that is out of range."""
    try:
        return Limits(**_derived(rig))
    except ValueError as error:
        name, found, allowed = error.args
        raise BadInput(where, name, f"{found:g}", allowed) from error


def read_limits(path: str | os.PathLike, rig: Rig = PAPERS, rest: Limits | None = None) -> Limits:
    """Read `{"format": "vpp-limits/1", "limits": {NAME: {"value": x, "unit": u}}}`; other limits are those of `rest`
    (default: derived from the rig).

    BadInput names the field: unknown, without its unit or with another one, outside its range, in conflict with another limit,
    or beyond the range that a rig.json declares.
    """
    content = Entries(path, read_json(path), ("format", "limits"))
    content.choice("format", (FORMAT,))
    known, given = {one.name: one.metadata["number"] for one in fields(Limits)}, content.free("limits")
    entries = Entries(path, given, (), known, "limits")
    named = {name: entries.number(name, known[name]) for name in given}
    for name, value in named.items():
        allowed = _declared(rig, name, value)
        if allowed:
            raise entries.wrong(name, f"{value:g}", f"{allowed}, as {DECLARED} has it")
    try:
        return replace(rest or limits_of(rig), **named)
    except ValueError as error:
        name, found, allowed = error.args
        raise entries.wrong(name, f"{found:g}", allowed) from error


def _declared(rig: Rig, name: str, value: float) -> str:
    """The bound of a limit that a rig.json declares, in words, if the value is beyond it; else ""."""
    ranges = {"omega_min": ("speed", 0), "omega_max": ("speed", 1), "beta_min": ("pitch", 0), "beta_max": ("pitch", 1)}
    slews = {"omega_slew": "speed_slew", "omega_ramp": "speed_slew", "beta_slew": "pitch_slew", "beta_ramp": "pitch_slew"}
    if name in ranges:
        entry, end = ranges[name]
        bound = getattr(rig, entry)[end]
        beyond = value > bound if end else value < bound
    elif name in slews:
        entry = slews[name]
        bound = getattr(rig, entry)
        end, beyond = 1, value > bound
    else:
        return ""
    return f"at {'most' if end else 'least'} {bound:g}" if beyond and rig.origin.get(entry) == DECLARED else ""


class Cut(IntFlag):
    """Limits that have changed a command."""

    NONE = 0
    OMEGA_RANGE = 1
    OMEGA_SLEW = 2
    BETA_RANGE = 4
    BETA_SLEW = 8


class Limited(NamedTuple):
    """Limited commands [rpm, deg], the limits that changed them, and a fault if the requested ones were not finite."""

    omega_ref: float
    beta_ref: float
    cut: Cut
    fault: Fault | None


class Limiter:
    """Applies the limits tick by tick. It starts at `omega_ref` [rpm], `beta_ref` [deg] and enters the ranges at the slew
    rates: the rotor is at rest at first, and blades may rest outside their range."""

    def __init__(self, limits: Limits, omega_ref: float = 0.0, beta_ref: float = 0.0):
        self.limits, self._omega, self._beta = limits, omega_ref, beta_ref

    def apply(self, omega_ref: float, beta_ref: float, dt: float) -> Limited:
        """The limited commands for the next dt [s].

        If a command is not finite the last ones are kept, with a fault.
        """
        own = self.limits
        return self._step(omega_ref, own.omega_min, own.omega_slew * dt, beta_ref, own.beta_slew * dt)

    def ramp(self, omega_ref: float, beta_ref: float, dt: float) -> Limited:
        """The same at the slow rates of spin-up and ramp-down; speeds down to 0 are allowed."""
        own = self.limits
        return self._step(omega_ref, 0.0, own.omega_ramp * dt, beta_ref, own.beta_ramp * dt)

    def _step(self, omega_ref: float, omega_min: float, omega_step: float, beta_ref: float, beta_step: float) -> Limited:
        if not (math.isfinite(omega_ref) and math.isfinite(beta_ref)):
            found = f"found omega_ref {omega_ref} rpm, beta_ref {beta_ref} deg, expected finite numbers"
            fault = Fault("controller", FaultKind.NOT_A_NUMBER, found)
            return Limited(self._omega, self._beta, Cut.NONE, fault)
        omega = min(max(omega_ref, omega_min), self.limits.omega_max)
        beta = min(max(beta_ref, self.limits.beta_min), self.limits.beta_max)
        self._omega = min(max(omega, self._omega - omega_step), self._omega + omega_step)
        self._beta = min(max(beta, self._beta - beta_step), self._beta + beta_step)
        cut = (omega != omega_ref) * Cut.OMEGA_RANGE | (self._omega != omega) * Cut.OMEGA_SLEW
        cut |= (beta != beta_ref) * Cut.BETA_RANGE | (self._beta != beta) * Cut.BETA_SLEW
        return Limited(self._omega, self._beta, Cut(cut), None)
