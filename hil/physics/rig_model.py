"""The rig as one physical model: the paper's electromechanical and aerodynamic equations 1 to 6 as effects on the kernel.

The input of `POWERTRAIN` is the throttle, which the rig's software commands; `FULL_RIG` adds the paper's speed loop and has the
plant FMU's interface. `powertrain` and `rig_model` switch hidden effects on by name.
"""

from collections.abc import Iterable
from functools import cache

from hil.physics import speed_pi
from hil.physics.hidden import air, drive, load_cell, pitch
from hil.physics.inflow import INFLOW
from hil.physics.lac_pd import LAC
from hil.physics.motor import ESC, MOTOR, supply
from hil.physics.pitch_actuator import ACTUATOR, MOVE
from hil.physics.propeller import BLADES, THRUST
from hil.physics.rotor import shaft
from vpp_fmu.kernel import plant
from vpp_fmu.kernel.types import Effect, Model, Signal, compose

THROTTLE = Signal("throttle", "1", "throttle between the ESC's idle and its maximum", 0.0, 1.0)

INNER = (
    Signal("angle", "1", "turns of the shaft since the start", 0.0, 1e9),
    Signal("current", "A", "motor current", -1000.0, 1000.0, 10.0),
    Signal("torque", "N.m", "aerodynamic torque on the shaft", -10.0, 10.0),
    Signal("rod_ahead", "deg", "position of the pitch actuator as blade pitch", -45.0, 45.0, 10.0),
)
"""Internal signals of the physics. Thrust, omega and beta are true values; the emulated sensors read them with their errors."""


def library(commanded: bool) -> tuple[Effect, ...]:
    """All effects in the order in which they act. `commanded`: the speed loop holds `omega_ref`, else `throttle` is given."""
    return (
        pitch.COMMAND_DELAY,
        pitch.PULSE_AVERAGE,
        ACTUATOR,
        pitch.COMMAND_DEADBAND,
        LAC,
        pitch.ROD_SPEED_LIMIT,
        pitch.STOP_BAND,
        pitch.ROD_STUCK,
        MOVE,
        pitch.LINKAGE_PLAY,
        pitch.LINKAGE_RESONANCE,
        supply(measured=not commanded),
        drive.SUPPLY_DROOP,
        BLADES,
        shaft(commanded),
        air.BLADE_TORSION,
        drive.MOTOR_HEATING,
        *((speed_pi.EFFECT,) if commanded else ()),
        drive.SPEED_HUNTING,
        ESC,
        drive.ESC_FREEWHEEL,
        INFLOW,
        air.RECIRCULATION,
        MOTOR,
        THRUST,
        load_cell.STAND_SWING,
        load_cell.IMBALANCE,
        load_cell.LOW_PASS,
        load_cell.GAIN,
        load_cell.DRIFT,
    )


_POWERTRAIN = Model(
    "VppPowertrain",
    "Variable-pitch propeller, physical: throttle and pitch command to thrust",
    inputs=(THROTTLE, plant.BETA_REF),
    outputs=(plant.THRUST, plant.OMEGA, plant.BETA, *INNER),
    effects=(),
)
_FULL_RIG = Model(
    "VppRig",
    "Variable-pitch propeller, physical: motor speed and blade pitch commands to thrust",
    inputs=(plant.OMEGA_REF, plant.BETA_REF),
    outputs=(plant.THRUST, plant.OMEGA, plant.BETA),
    effects=(),
)


@cache
def _composed(commanded: bool, hidden: frozenset[str]) -> Model:
    effects, base = library(commanded), _FULL_RIG if commanded else _POWERTRAIN
    for unknown in hidden - {e.name for e in effects if e.off is not None}:
        raise KeyError(unknown)
    return compose(base, effects, hidden)


def powertrain(hidden: Iterable[str] = ()) -> Model:
    """Throttle, pitch command and supply to thrust, speed, pitch and INNER signals. KeyError names an unknown effect."""
    return _composed(False, frozenset(hidden))


def rig_model(hidden: Iterable[str] = ()) -> Model:
    """Speed and pitch commands to thrust, speed and pitch, with the paper's speed loop. KeyError names an unknown effect."""
    return _composed(True, frozenset(hidden))


POWERTRAIN = powertrain()
FULL_RIG = rig_model()
