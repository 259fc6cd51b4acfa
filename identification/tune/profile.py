"""The range of thrust that a rig's controllers can reach, and the test signal of a tuning within it."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.controller import speed_alone
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig

Span = tuple[float, float]

LEVELS = (0.1, 0.8)
"""Levels of the step profile, as shares of the thrust scale: the paper's 1.5 and 12 N."""

RESERVE = 0.03
"""Share of the rig's thrust range, at either end, that the profile does not use: at the limit a controller can only
saturate."""


def step_profile(rig: Rig | None = None) -> Record:
    """Thrust steps up and down between LEVELS, as in the paper's tests, within the range of the rig (default: the paper's);
    `time` [s], `thrust_set` [N]."""
    rig = rig or Rig()
    reserve = RESERVE * (rig.thrust[1] - rig.thrust[0])
    low, high = np.clip(np.array(LEVELS) * rig.scales.thrust_scale, rig.thrust[0] + reserve, rig.thrust[1] - reserve)
    time = 6.0 * rig.scales.time_scale * np.arange(4.0)
    return Record({"time": time, "thrust_set": np.array([low, high, low, low])}, "step profile")


def reach(parameters: ParameterSet, settings: Mapping[str, float]) -> Span:
    """Steady thrust [N] of the plant at a controller's lowest and highest commands.

    All channels respond to one error, so the controller reaches all thrust between the two.
    """
    model, ends = parameters.model, []
    for end in ("min", "max"):
        beta = settings["beta_fixed"] if speed_alone(settings) else settings[f"beta_{end}"]
        inputs = {**model.measured_inputs, "omega_ref": settings[f"omega_{end}"], "beta_ref": beta}
        ends.append(float(Simulation(model, parameters.values).start(inputs)["thrust"]))
    return ends[0], ends[1]


def common_reach(parameters: ParameterSet, controllers: Mapping[str, Mapping[str, float]]) -> Span:
    """Range of thrust [N] that each controller reaches and the rig allows. BadInput if it is empty."""
    low, high = _common(parameters.rig.thrust, *(reach(parameters, settings) for settings in controllers.values()))
    if low >= high:
        found = f"{low:.4g} N on the lowest commands and {high:.4g} N on the highest"
        raise BadInput("the plant", "thrust at rest", found, "thrust that grows with the commands, within the rig's range")
    return low, high


def rig_profile(parameters: ParameterSet, controllers: Mapping[str, Mapping[str, float]]) -> Record:
    """The step profile, `time` [s], `thrust_set` [N], for the first controller, clipped to the range of the others."""
    rig, common = parameters.rig, common_reach(parameters, controllers)
    first = reach(parameters, next(iter(controllers.values())))
    profile = step_profile(replace(rig, thrust=_common(rig.thrust, first)))
    return Record({"time": profile.time, "thrust_set": np.clip(profile["thrust_set"], *common)}, profile.source)


def _common(*spans: Span) -> Span:
    return max(low for low, _ in spans), min(high for _, high in spans)
