"""The thrust step with which controllers are tuned and shown."""

import numpy as np

from vpp_fmu.record import Record
from vpp_fmu.rig import Rig

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
