"""The control loop that all verbs use."""

import contextlib
from collections.abc import Callable

import numpy as np

from vpp_fmu.errors import CompilerMissing
from vpp_fmu.native.master import CHUNK, Failed, run_together
from vpp_fmu.plants import COMMANDS, Controller, FmuController, FmuPlant, Plant, Sample
from vpp_fmu.record import Record, held

STANDSTILL = (0.0, 0.0)


def run(
    plant: Plant,
    controller: Controller,
    references: Record,
    start: tuple[float, float] = STANDSTILL,
    progress: Callable[[float], None] = lambda share: None,
) -> Record:
    """Close the loop over the profile `references` (`time` [s], `thrust_set` [N], each held to the next row).

    At each communication point the controller reads the present thrust, and its commands act until the next one. `start`: the
    commands [rpm, deg] on which the plant is at rest at time 0. `progress` is called with the share done at intervals.
    Returns a record (rows = steps + 1) of `time, thrust_set, omega_ref, beta_ref, thrust, omega, beta`, and any other fields
    of the plant's samples, one row per communication point. Measured values are from before the row's commands act.
    """
    time, wanted = held(references, plant.dt)
    sample = plant.start(*start)
    controller.start(float(wanted[0]), sample.thrust)
    columns = dict(zip((*COMMANDS, *sample._fields), _rows(plant, controller, sample, wanted, progress).T, strict=True))
    return Record({"time": time, "thrust_set": wanted, **columns}, source="closed loop")


def _rows(
    plant: Plant, controller: Controller, sample: Sample, wanted: np.ndarray, progress: Callable[[float], None]
) -> np.ndarray:
    """Commands and samples at each communication point. Two native FMUs are stepped by one compiled function."""
    if isinstance(plant, FmuPlant) and isinstance(controller, FmuController) and plant.dt == controller.dt:
        entries = controller.instance.entry(), plant.instance.entry()
        if all(entries):
            with contextlib.suppress(CompilerMissing):
                return _rows_of_fmus(plant, controller, entries, wanted, progress)
    rows, count = [], len(wanted)
    for k, thrust_set in enumerate(wanted.tolist()):
        commands = controller.step(thrust_set, sample.thrust)
        rows.append((*commands, *sample))
        if k + 1 < count:
            sample = plant.step(*commands)
        if k % CHUNK == 0:
            progress(k / count)
    return np.array(rows)


def _rows_of_fmus(plant: FmuPlant, controller: FmuController, entries, wanted, progress) -> np.ndarray:
    found = run_together(*entries, wanted, plant.dt, progress)
    if isinstance(found, Failed):
        (controller, plant)[found.side].instance.failed(found.status, found.point * plant.dt)
    return found
