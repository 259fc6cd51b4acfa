"""Effects of the channel `power` that the steady power model (fit.py) does not include.

    resistance_heating  P_1 = gain u h,    time_constant dh/dt = u (1 + gain h / P_c) - h,    h = 0 at a record's start
    servo_load          P_1 = load |dbeta/dt|, or load |T dbeta/dt|
    power_drift         P_1 = rate t P
    supply_sag          V = V_0 - resistance I

u is the squared torque of the motor over its largest, so u P_c is its copper loss R I^2 when cold. The winding's temperature is
a first-order lag of that heat, and the resistance grows in proportion. P_c [W] is the loss at u = 1; it is known if torque was
measured. Else u is computed from electrical power over speed, and the gain includes the feedback of the resistance on the heat:
a rough size. A lead screw holds its load without power, so a servo takes power only while it moves: against friction, or
against friction that is proportional to thrust. A drift with time, as of a battery, resembles a winding that heats slowly.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from identification.diagnose.command_shapes import lagged
from vpp_fmu.kernel.types import Parameter

POWER, VOLTAGE = "power", "voltage"

FEEDBACK = 8
"""Iterations of the heat's feedback: with a resistance that grows by 30 %, the error is 0.3^8 of it."""


@dataclass(frozen=True, eq=False)
class Signals:
    """Inputs of the effects, (rows,) each: `time` [s], `power` P of the steady model [W], `load` u, `rate` of the pitch
    [deg/s], `thrust` [N], `current` [A]; `step` [s] from row to row. `feedback` [1/W]: 1 / P_c, 0 if unknown."""

    time: np.ndarray
    power: np.ndarray
    load: np.ndarray
    rate: np.ndarray
    thrust: np.ndarray
    current: np.ndarray
    step: float
    feedback: float


@dataclass(frozen=True)
class PowerEffect:
    """`response(signals, values)`: the change (rows,) of a `reading` [W or V], to first order proportional to the first
    parameter. `form`: which of several forms. `says`: the effect as a clause."""

    name: str
    reading: str
    response: Callable[[Signals, Mapping[str, float]], np.ndarray]
    parameters: tuple[Parameter, ...]
    says: str
    form: str = "only"

    @property
    def label(self) -> str:
        """Name, with the form if there are several."""
        return self.name if self.form == "only" else f"{self.name} ({self.form})"


def _heated(s: Signals, p: Mapping[str, float]) -> np.ndarray:
    """The heat is held from row to row. Beyond a resistance of ten times its cold value the model is invalid, and the search
    must not overflow."""
    rise = warmth = np.zeros(len(s.load))
    for _ in range(1 + FEEDBACK if s.feedback else 1):
        heat = s.load * (1.0 + rise)
        warmth = lagged(np.append(0.0, heat[:-1]), p["time_constant"], s.step)
        rise = np.minimum(p["gain"] * s.feedback * warmth, 9.0)
    return p["gain"] * s.load * warmth


def _servo(form: str, unit: str, words: str, driver: Callable[[Signals], np.ndarray]) -> PowerEffect:
    """Power of the servo, proportional to a `driver` (rows,)."""
    load = Parameter("load", unit, 0.0, 0.0, 1e6, f"power of the servo over its {form}")
    says = f"the pitch servo takes {{load}} of its {words}"
    return PowerEffect("servo_load", POWER, lambda s, p: p["load"] * np.abs(driver(s)), (load,), says, form)


HEATING = PowerEffect(
    "resistance_heating",
    POWER,
    _heated,
    (
        Parameter("gain", "W", 0.0, 0.0, 1e6, "power added at the largest torque when warm, without feedback"),
        Parameter("time_constant", "s", 30.0, 1.0, 1000.0, "thermal time constant of the winding"),
    ),
    "the winding's resistance grows with its heat: up to {gain} at the largest torque, time constant {time_constant}",
)

SAG = PowerEffect(
    "supply_sag",
    VOLTAGE,
    lambda s, p: -p["resistance"] * s.current,
    (Parameter("resistance", "Ohm", 0.0, 0.0, 100.0, "internal resistance of the supply"),),
    "the supply's internal resistance is {resistance}",
)

DRIFT = PowerEffect(
    "power_drift",
    POWER,
    lambda s, p: p["rate"] * s.time * s.power,
    (Parameter("rate", "1/s", 0.0, -0.1, 0.1, "relative change of power over time"),),
    "the power drifts by {rate} of itself",
)

EFFECTS = (
    HEATING,
    _servo("rate", "W.s/deg", "rate", lambda s: s.rate),
    _servo("rate and thrust", "W.s/deg/N", "rate times thrust", lambda s: s.thrust * s.rate),
    DRIFT,
    SAG,
)
