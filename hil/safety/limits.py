"""What the rig may be asked for, whatever the controller says; checked where the commands leave for the outputs."""

import math
import os
from dataclasses import dataclass, field, fields
from enum import IntFlag
from typing import NamedTuple

from hil.entries import Entries, Number, read_json
from hil.safety.faults import Fault, FaultKind

FORMAT = "vpp-limits/1"


def _limit(default: float, unit: str, lowest: float, highest: float, meaning: str):
    return field(default=default, metadata={"number": Number(unit, lowest, highest), "meaning": meaning})


@dataclass(frozen=True)
class Limits:
    """The limits with the paper's rig as default; each field's metadata hold its `number` (unit and range) and its `meaning`.

    The steepest that the paper's rotor answers a step of 4000 rpm is 13 800 rpm/s (two lags, 0.172 and 0.053 s), its fastest
    pitch 46 deg/s (15 deg, 0.207 and 0.05 s): the slew limits above that take nothing from a step.
    """

    omega_min: float = _limit(1500.0, "rpm", 0.0, 12000.0, "lowest commanded speed of a run")
    omega_max: float = _limit(6000.0, "rpm", 100.0, 12000.0, "highest commanded speed")
    omega_trip: float = _limit(6900.0, "rpm", 100.0, 13200.0, "measured speed that stops the rotor at once")
    beta_min: float = _limit(-10.0, "deg", -45.0, 45.0, "lowest commanded pitch")
    beta_max: float = _limit(10.0, "deg", -45.0, 45.0, "highest commanded pitch")
    thrust_trip: float = _limit(25.0, "N", 1.0, 98.0, "measured thrust, of either sign, that stops the rotor at once")
    omega_slew: float = _limit(20000.0, "rpm/s", 100.0, 1e6, "steepest commanded speed")
    beta_slew: float = _limit(60.0, "deg/s", 1.0, 5000.0, "steepest commanded pitch")
    omega_ramp: float = _limit(4000.0, "rpm/s", 100.0, 20000.0, "slope of spin-up and ramp-down")
    beta_ramp: float = _limit(20.0, "deg/s", 1.0, 200.0, "slope of pitch in spin-up and ramp-down")
    run_time: float = _limit(3600.0, "s", 1.0, 86400.0, "longest time in RUN")
    late: float = _limit(0.05, "s", 0.001, 0.1, "lateness of one tick that ends the run")
    missed_share: float = _limit(0.1, "1", 0.0, 0.5, "share of the ticks of a second that may be missed")

    def __post_init__(self):
        for one in fields(self):
            number, value = one.metadata["number"], getattr(self, one.name)
            if not number.lowest <= value <= number.highest:
                raise ValueError(one.name, value, number.allowed)
        for lower, upper in (("omega_min", "omega_max"), ("omega_max", "omega_trip"), ("beta_min", "beta_max")):
            if not getattr(self, lower) < getattr(self, upper):
                raise ValueError(upper, getattr(self, upper), f"more than {lower}, {getattr(self, lower):g}")


def read_limits(path: str | os.PathLike) -> Limits:
    """Read `{"format": "vpp-limits/1", "limits": {NAME: {"value": x, "unit": u}}}`; what it doesn't name keeps its default.

    BadInput names the field: unknown, without its unit or with another one, outside its range, or at odds with another.
    """
    content = Entries(path, read_json(path), ("format", "limits"))
    content.choice("format", (FORMAT,))
    known, given = {one.name: one.metadata["number"] for one in fields(Limits)}, content.free("limits")
    entries = Entries(path, given, (), known, "limits")
    try:
        return Limits(**{name: entries.number(name, known[name]) for name in given})
    except ValueError as error:
        name, found, allowed = error.args
        raise entries.wrong(name, f"{found:g}", allowed) from error


class Cut(IntFlag):
    """What a limit took from a command."""

    NONE = 0
    OMEGA_RANGE = 1
    OMEGA_SLEW = 2
    BETA_RANGE = 4
    BETA_SLEW = 8


class Limited(NamedTuple):
    """Commands [rpm, deg] that may go out, what was cut from those asked for, and a fault if these were no numbers."""

    omega_ref: float
    beta_ref: float
    cut: Cut
    fault: Fault | None


class Limiter:
    """Holds commands to the limits, one tick after another. It starts at `omega_ref` [rpm], `beta_ref` [deg]."""

    def __init__(self, limits: Limits, omega_ref: float = 0.0, beta_ref: float = 0.0):
        self.limits, self._omega, self._beta = limits, omega_ref, min(max(beta_ref, limits.beta_min), limits.beta_max)

    def apply(self, omega_ref: float, beta_ref: float, dt: float) -> Limited:
        """What of the controller's commands may go out for the next dt [s].

        Commands that are no finite numbers never do: the last ones stand, and the fault says so.
        """
        own = self.limits
        return self._step(omega_ref, own.omega_min, own.omega_slew * dt, beta_ref, own.beta_slew * dt)

    def ramp(self, omega_ref: float, beta_ref: float, dt: float) -> Limited:
        """The same along the slow slopes of spin-up and ramp-down, where speeds down to 0 are allowed."""
        own = self.limits
        return self._step(omega_ref, 0.0, own.omega_ramp * dt, beta_ref, own.beta_ramp * dt)

    def _step(self, omega_ref: float, omega_min: float, omega_step: float, beta_ref: float, beta_step: float) -> Limited:
        if not (math.isfinite(omega_ref) and math.isfinite(beta_ref)):
            fault = Fault("controller", FaultKind.NOT_A_NUMBER, f"omega_ref {omega_ref} rpm, beta_ref {beta_ref} deg")
            return Limited(self._omega, self._beta, Cut.NONE, fault)
        omega = min(max(omega_ref, omega_min), self.limits.omega_max)
        beta = min(max(beta_ref, self.limits.beta_min), self.limits.beta_max)
        self._omega = min(max(omega, self._omega - omega_step), self._omega + omega_step)
        self._beta = min(max(beta, self._beta - beta_step), self._beta + beta_step)
        cut = (omega != omega_ref) * Cut.OMEGA_RANGE | (self._omega != omega) * Cut.OMEGA_SLEW
        cut |= (beta != beta_ref) * Cut.BETA_RANGE | (self._beta != beta) * Cut.BETA_SLEW
        return Limited(self._omega, self._beta, Cut(cut), None)
