"""The control loop; there is no other."""

from collections.abc import Callable

import numpy as np

from vpp_fmu.plants import COMMANDS, Controller, Plant
from vpp_fmu.record import Record

STANDSTILL = (0.0, 0.0)


def run(
    plant: Plant,
    controller: Controller,
    references: Record,
    start: tuple[float, float] = STANDSTILL,
    progress: Callable[[float], None] = lambda share: None,
) -> Record:
    """Close the loop over the profile `references` (`time` [s], `thrust_set` [N], each held to the next row).

    At each communication point the controller sees the thrust that stands there, and its commands act until the next one.
    `start`: the commands [rpm, deg] that the plant rests on at time 0. `progress` is told the share done now and then.
    Returns a record (rows = steps + 1) of `time, thrust_set, omega_ref, beta_ref, thrust, omega, beta`, and what else the
    plant's samples hold, one row a communication point: what is measured stands before the row's commands act.
    """
    dt = plant.dt
    count = round((references.time[-1] - references.time[0]) / dt) + 1
    time = np.arange(count) * dt
    held = np.searchsorted(references.time - references.time[0], time + 1e-9, side="right") - 1
    wanted = references["thrust_set"][held].tolist()
    rows = []
    sample = plant.start(*start)
    controller.start(wanted[0], sample.thrust)
    for k, thrust_set in enumerate(wanted):
        commands = controller.step(thrust_set, sample.thrust)
        rows.append((*commands, *sample))
        if k + 1 < count:
            sample = plant.step(*commands)
        if k % 1000 == 0:
            progress(k / count)
    columns = dict(zip((*COMMANDS, *sample._fields), np.array(rows).T, strict=True))
    return Record({"time": time, "thrust_set": np.array(wanted), **columns}, source="closed loop")
