"""The test signal of a rig: a step up and one down between two levels of thrust that its controllers can reach."""

from collections.abc import Iterable, Mapping

import numpy as np

from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.kernel.types import Model
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig

LEVELS = (0.1, 0.8)
"""Shares of the scale of thrust that the paper steps between (section 4.3)."""

ROOM = 0.05
"""Share of the reach that a level stays off its end where the paper's level lies beyond it: a loop that is pressed against its
limits shows these and not its gains."""

HOLD = 6.0
"""Time scales for which a level is held: the paper's 3 s."""


def idle(settings: Mapping[str, float]) -> tuple[float, float]:
    """The commands [rpm, deg] that a loop starts from: the lowest speed, and the fixed pitch or the one nearest to 0 deg."""
    if settings["speed_only"] > 0.5:
        return settings["omega_min"], settings["beta_fixed"]
    return settings["omega_min"], min(max(0.0, settings["beta_min"]), settings["beta_max"])


def reach(model: Model, values: Mapping[str, float], settings: Mapping[str, float]) -> tuple[float, float]:
    """Thrust [N] of the plant at rest on a controller's lowest commands and on its highest.

    Both channels follow one error, so a controller passes from the one to the other, and all thrust between is reached.
    """
    fixed = settings["speed_only"] > 0.5
    ends = []
    for end in ("min", "max"):
        beta = settings["beta_fixed"] if fixed else settings[f"beta_{end}"]
        commands = {"omega_ref": settings[f"omega_{end}"], "beta_ref": beta}
        ends.append(float(Simulation(model, values).start({**model.measured_inputs, **commands})["thrust"]))
    return ends[0], ends[1]


def common_reach(
    model: Model, values: Mapping[str, float], controllers: Iterable[Mapping[str, float]], rig: Rig
) -> tuple[float, float]:
    """Thrust [N] that each of the controllers reaches and the rig allows; empty where the first is no less than the second."""
    spans = [rig.thrust, *(reach(model, values, settings) for settings in controllers)]
    return max(low for low, _ in spans), min(high for _, high in spans)


def step_profile(within: tuple[float, float], rig: Rig) -> Record:
    """Low, high and low again, `time` [s], `thrust_set` [N]: the paper's levels, each moved inside where it is not `within`."""
    low, high = within
    room = ROOM * (high - low)
    levels = (share * rig.scales.thrust_scale for share in LEVELS)
    first, second = (level if low <= level <= high else float(np.clip(level, low + room, high - room)) for level in levels)
    hold = HOLD * rig.scales.time_scale
    time = hold * np.arange(4.0)
    return Record({"time": time, "thrust_set": np.array([first, second, first, first])}, "step profile")
