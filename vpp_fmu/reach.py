"""The steady thrust that a plant reaches within the limits of its commands."""

import itertools
import warnings
from collections.abc import Mapping

import numpy as np

from vpp_fmu.digits import number
from vpp_fmu.errors import RecordWarning
from vpp_fmu.plants import COMMANDS, Plant
from vpp_fmu.record import Record
from vpp_fmu.response import BAND

HOLD = 2.0
"""s for which each pair of commands is held: an FMU may start at rest."""

PITCHES = 5
"""Pitches at each end of the speed: a blade that stalls has its greatest thrust before the last."""


def thrust_range(plant: Plant, limits: Mapping[str, tuple[float, float]]) -> tuple[float, float]:
    """(least, greatest) thrust [N] at both ends of the speed and PITCHES pitches within the `limits`, by name of the command.
    The plant is started anew for each."""
    found = []
    speeds, pitches = (limits[name] for name in COMMANDS)
    for commands in itertools.product(sorted({*speeds}), sorted({*np.linspace(*pitches, PITCHES).tolist()})):
        plant.start(*commands)
        for _ in range(round(HOLD / plant.dt)):
            sample = plant.step(*commands)
        found.append(float(sample.thrust))
    return min(found), max(found)


def warn_beyond_reach(profile: Record, plant: Plant, limits: Mapping[str, tuple[float, float]]) -> None:
    """RecordWarning for the first set-point that the plant cannot reach within the `limits`; nothing if a limit is unknown."""
    if not set(COMMANDS) <= set(limits):
        return
    low, high = thrust_range(plant, limits)
    room, wanted = BAND * (high - low), profile["thrust_set"]
    beyond = (wanted < low - room) | (wanted > high + room)
    if beyond.any():
        row = int(beyond.argmax())
        where = f"{profile.source}: thrust_set: {number(float(wanted[row]))} N at {number(float(profile.time[row]), 4)} s"
        reached = f"the plant's model gives {number(low)} to {number(high)} N within the limits of its commands"
        warnings.warn(f"{where} is out of reach: {reached}", RecordWarning, stacklevel=2)
