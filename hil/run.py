"""A closed loop on the rig: the same loop, controllers and profiles as with FMUs."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.columns import RUN
from hil.cycle import PERIOD
from hil.devices.supply import NAMES
from hil.log import Column, cell
from hil.page.operator_page import OperatorPage
from hil.rig import ENDINGS, Rig
from hil.safety.faults import Fault, FaultKind
from hil.safety.limits import Limiter, Limits
from hil.session import Session, Setup, found_log, read_log, session
from hil.twin.adaptive import Adaptive
from hil.twin.twin import Twin
from vpp_fmu.commands import idle
from vpp_fmu.errors import BadInput, VppError
from vpp_fmu.files import write_whole
from vpp_fmu.loop import run as run_loop
from vpp_fmu.plants import Controller, FmuController, Plant
from vpp_fmu.record import Record

LOG = "log.csv"
ON_ALARM = {"note": None, "ramp": FaultKind.TWIN, "idle": FaultKind.TWIN_NOW}
"""Possible reactions of a run to the twin's alarm."""
REHEARSED = 25
"""Steps of a controller FMU that are tried before anything turns."""


@dataclass(frozen=True, eq=False)
class Run:
    """`record`: the loop's part, from time 0; `log`: every tick from tare to idle pulse; `ended`: why it ended early."""

    record: Record
    log: Record
    session: Session
    ended: str


class Followed:
    """A controller that passes its set-point to the rig's log."""

    def __init__(self, controller: Controller, rig: Rig):
        self._controller, self._rig = controller, rig

    def start(self, thrust_set, thrust):
        self._controller.start(thrust_set, thrust)

    def step(self, thrust_set, thrust):
        self._rig.follow(thrust_set)
        try:
            return self._controller.step(thrust_set, thrust)
        except VppError as error:
            self._rig.fail(Fault("controller", FaultKind.FAILED, str(error)))

    def close(self):
        self._controller.close()


class LimitedPlant:
    """A plant behind the rig's limits, so that a difference to the rig is one of the plant."""

    def __init__(self, plant: Plant, limits: Limits):
        self.dt, self._plant, self._limits = plant.dt, plant, limits

    def start(self, omega_ref, beta_ref):
        self._limiter = Limiter(self._limits, omega_ref, beta_ref)
        return self._plant.start(omega_ref, beta_ref)

    def step(self, omega_ref, beta_ref):
        limited = self._limiter.apply(omega_ref, beta_ref, self.dt)
        return self._plant.step(limited.omega_ref, limited.beta_ref)

    def close(self):
        self._plant.close()


def run_on_rig(
    setup: Setup,
    controller: Controller,
    profile: Record,
    folder: Path,
    start: tuple[float, float] | None = None,
    twin: Twin | None = None,
    progress: Callable[[float], None] = lambda share: None,
    after: Sequence[str] = (),
    on_alarm: FaultKind | None = None,
    page: OperatorPage | None = None,
    adaptive: Adaptive | None = None,
) -> Run:
    """Close the loop over the profile, from the commands `start` [rpm, deg] on (default: the rig's idle). Writes the full-rate
    log to `folder` and keeps what was measured, however it ended; `after`, `on_alarm`, `page`, `adaptive` as in `session`."""
    ended, start = "", start or idle(setup.allowed)
    if isinstance(controller, FmuController):
        rehearse(controller, float(profile["thrust_set"][0]))
    with session(setup, folder, LOG, twin, after=after, on_alarm=on_alarm, page=page, adaptive=adaptive) as one:
        try:

            def shown(share: float) -> None:
                one.rig.show_done(share)
                progress(share)

            run_loop(one.rig, Followed(controller, one.rig), profile, start, shown)
            one.rig.stop()
        except ENDINGS as reason:
            ended = str(reason)
    log = read_log(found_log(folder / LOG))
    return Run(loop_part(log), log, one, ended)


def rehearse(controller: FmuController, thrust_set: float) -> None:
    """Load an FMU, try some steps of it, and leave a fresh instance ready: before anything turns. BadInput where it gives no
    numbers, or takes longer for a step than there is."""
    took = []
    controller.start(thrust_set, 0.0)
    for _ in range(REHEARSED):
        began = time.perf_counter()
        commands = controller.step(thrust_set, 0.0)
        took.append(time.perf_counter() - began)
        if not all(map(math.isfinite, commands)):
            raise BadInput(controller.path, "commands", f"{commands[0]} rpm, {commands[1]} deg", "finite numbers")
    usual = sorted(took)[REHEARSED // 2]
    if usual > PERIOD:
        raise BadInput(controller.path, "a step", f"{1e3 * usual:.1f} ms", f"less than the {1e3 * PERIOD:g} ms of a tick")
    controller.prepare()


def loop_part(log: Record) -> Record:
    """The rows of a log in which a controller was at work, from time 0; columns as `hil.columns.RUN` has them, and
    what was read of the supply."""
    rows = np.flatnonzero(np.isfinite(log["omega_wanted"]))
    if not len(rows):
        return Record({name: np.empty(0) for name in ("time", *RUN)}, log.source)
    read = [name for name in NAMES if name in log and np.isfinite(log[name][rows]).any()]
    columns = {name: log[name][rows] for name in (*RUN, *read)}
    return Record({"time": np.round(log.time[rows] - log.time[rows[0]], 9), **columns}, log.source)


def write_run(path: Path, record: Record) -> None:
    """Write a run, its values exact to the bit: a replay needs them so. BadInput where the disk refuses."""
    cells = [cell(Column(name, exact=name != "time")) for name in record.columns]
    lines = [",".join(record.columns)]
    for row in zip(*(column.tolist() for column in record.columns.values()), strict=True):
        lines.append(",".join([write(value) for write, value in zip(cells, row, strict=True)]))
    write_whole(path, ("\n".join(lines) + "\n").encode(), path)
