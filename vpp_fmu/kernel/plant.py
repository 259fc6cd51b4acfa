"""The plant: from commanded speed and pitch to measured thrust, as a chain of effects in their physical order."""

from collections.abc import Iterable
from functools import cache

from vpp_fmu.kernel.effects import (
    actuator,
    command_resolution,
    dead_time,
    inflow_lag,
    map_terms,
    normalisation,
    overshoot,
    pitch_asymmetry,
    pitch_backlash,
    pitch_command_deadband,
    pitch_delay,
    pitch_error_deadzone,
    pitch_offset,
    pitch_rate_feedthrough,
    pitch_rate_limit,
    pitch_speed_coupling,
    pitch_speed_limits,
    pitch_stall_latch,
    pitch_stop_band,
    pitch_stop_restart,
    pitch_travel_limit,
    recirculation,
    rotor_vibration,
    row_clock,
    sensor_drift,
    sensor_gain,
    sensor_lag,
    speed_asymmetry,
    speed_delay,
    speed_dependent_lag,
    speed_saturation,
    stand_resonance,
    start_from_rest,
    supply_sag,
    supply_voltage,
    thrust_gain_drift,
    thrust_map,
)
from vpp_fmu.kernel.scales import PAPER, Scales
from vpp_fmu.kernel.signals import BETA, BETA_REF, OMEGA, OMEGA_REF, THRUST
from vpp_fmu.kernel.types import Effect, Model, compose

_PITCH_DRIVE, _PITCH_FIRST, _PITCH_SECOND, _PITCH_REACH = actuator.PITCH
_SPEED_DRIVE, _SPEED_FIRST, _SPEED_SECOND, _SPEED_REACH = actuator.SPEED

_DECLARED: tuple[Effect, ...] = (
    normalisation.EFFECT,
    speed_delay.EFFECT,
    pitch_delay.EFFECT,
    command_resolution.SPEED,
    command_resolution.PITCH,
    pitch_command_deadband.EFFECT,
    pitch_offset.EFFECT,
    pitch_travel_limit.EFFECT,
    _PITCH_DRIVE,
    _PITCH_FIRST,
    _PITCH_SECOND,
    overshoot.PITCH,
    pitch_error_deadzone.EFFECT,
    pitch_asymmetry.EFFECT,
    pitch_speed_limits.EFFECT,
    pitch_stop_band.EFFECT,
    pitch_stop_restart.EFFECT,
    pitch_rate_limit.EFFECT,
    pitch_stall_latch.EFFECT,
    _PITCH_REACH,
    pitch_backlash.EFFECT,
    supply_voltage.EFFECT,
    supply_sag.EFFECT,
    speed_saturation.EFFECT,
    _SPEED_DRIVE,
    start_from_rest.EFFECT,
    _SPEED_FIRST,
    _SPEED_SECOND,
    overshoot.SPEED,
    speed_asymmetry.EFFECT,
    speed_dependent_lag.EFFECT,
    _SPEED_REACH,
    pitch_speed_coupling.EFFECT,
    thrust_map.THRUST_MAP,
    map_terms.EFFECT,
    inflow_lag.EFFECT,
    pitch_rate_feedthrough.EFFECT,
    recirculation.EFFECT,
    thrust_gain_drift.EFFECT,
    sensor_gain.EFFECT,
    sensor_lag.EFFECT,
    stand_resonance.EFFECT,
    dead_time.THRUST,
    rotor_vibration.EFFECT,
    sensor_drift.EFFECT,
    dead_time.SPEED,
    row_clock.EFFECT,
)
"""All effects, in their order between command and reading. A new effect is one file and one line here."""


def sized(library: Iterable[Effect], scales: Scales) -> tuple[Effect, ...]:
    """The effects with absolute numbers for a rig of these scales."""
    return tuple(e.sized(scales) for e in library)


LIBRARY = sized(_DECLARED, PAPER)
"""All effects for the paper's rig; `sized` scales them to another."""

ADDS_POWER = frozenset({"torque_map", "motor", "power_map", "figure_of_merit"})
"""Effects of `vpp_fmu.kernel.power`, which is imported for a plant that has one of them."""

FINE_TUNED = {
    "tau_omega_1": 0.172,
    "tau_omega_2": 0.053,
    "tau_beta_1": 0.207,
    "tau_beta_2": 0.374,
    "c20": 0.355,
    "c11": 0.064,
    "c21": 0.8,
    "c12": -0.16,
    "c30": -0.081,
}
"""The paper's model after fine-tuning (section 4.2); also the defaults."""


def normalised_map(c20: float, c11: float, c21: float, c12: float, c30: float) -> dict[str, float]:
    """Convert a map in rpm, deg, N to the paper's normalised quantities: insert beta = 15 b - 5 deg, collect powers.

    The shift adds a term in w alone (-0.0011 for the paper's map, 0.017 N at full speed). Eq. 8 has no such term, so it
    is dropped.
    """
    w, b, shift, t = 6000.0, 15.0, 5.0, 15.0
    return {
        "c20": (c20 - shift * c21) * w**2 / t,
        "c11": (c11 - 2.0 * shift * c12) * w * b / t,
        "c21": c21 * w**2 * b / t,
        "c12": c12 * w * b**2 / t,
        "c30": c30 * w**3 / t,
    }


AVERAGED = {
    "tau_omega_1": 0.15,
    "tau_omega_2": 0.04,
    "tau_beta_1": 0.11,
    "tau_beta_2": 0.28,
    **normalised_map(0.21e-6, -5.7e-6, 0.023e-6, -1.25e-6, -2.15e-12),
}
"""The paper's model before fine-tuning: averaged time constants of the steps and the static map (sections 4.1, 4.2)."""

OURS = {"author": "vpp-fmu", "license": "MIT", "icon": "propeller"}
"""What the FMUs of this project's models say about them."""

BASE = Model(
    "VppPlant",
    "Variable-pitch propeller: motor speed and blade pitch commands to thrust (Wiener model)",
    inputs=(OMEGA_REF, BETA_REF),
    outputs=(THRUST, OMEGA, BETA),
    effects=tuple(e for e in LIBRARY if e.off is None),
    sets={"fine_tuned": FINE_TUNED, "averaged": AVERAGED},
    **OURS,
)


def plant(effects: Iterable[str] = (), library: Iterable[Effect] = LIBRARY, scales: Scales | None = None) -> Model:
    """The Wiener plant with the named effects on. KeyError names an effect that the library doesn't have.

    `scales`: of its rig; None: those of the library's effects, the paper's. Effects of `vpp_fmu.kernel.power`, which
    add outputs, are available with every library.
    """
    names, library = frozenset(effects), tuple(library)
    for unknown in names - ADDS_POWER - {e.name for e in library if e.off is not None}:
        raise KeyError(unknown)
    if library is LIBRARY:
        return _own(names, scales or PAPER)
    model = _composed(names, library)
    return model if scales is None else model.sized(scales)


@cache
def _own(names: frozenset[str], scales: Scales) -> Model:
    """The same model object for the same names and scales, so that derived data are reused."""
    return _composed(names, LIBRARY).sized(scales)


def _composed(names: frozenset[str], library: tuple[Effect, ...]) -> Model:
    if names & ADDS_POWER:
        from vpp_fmu.kernel.power import EFFECTS  # noqa: PLC0415 most plants have none of them

        library = (*library, *EFFECTS)
    return compose(BASE, library, names)
