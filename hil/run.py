"""A closed loop on the rig: the same loop, controllers and profiles as with FMUs."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.devices.supply import NAMES
from hil.emulator.faults import WITHIN, Injector, Saboteur
from hil.loop.columns import RUN
from hil.loop.cycle import PERIOD
from hil.loop.log import Column, cell
from hil.loop.rig import ENDINGS, RigPlant, RunEnded
from hil.loop.session import LOG, Session, Setup, session
from hil.page.operator_page import OperatorPage
from hil.safety.faults import Fault, FaultKind
from hil.safety.limits import Limiter, Limits
from hil.twin.twin import Twin
from vpp_fmu.commands import idle
from vpp_fmu.errors import BadInput, VppError
from vpp_fmu.files import write_whole
from vpp_fmu.loop import run as run_loop
from vpp_fmu.plants import Controller, FmuController, Plant
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig as Ranges

ON_ALARM = {"note": None, "ramp": FaultKind.TWIN, "idle": FaultKind.TWIN_NOW}
"""Possible reactions of a run to the twin's alarm."""
REHEARSED = 25
"""Steps of a controller FMU that are tried before anything turns."""


@dataclass(frozen=True, eq=False)
class Run:
    """`record`: the closed loop, from time 0; `ended`: why it ended early, or ""."""

    record: Record
    session: Session
    ended: str

    @property
    def log(self) -> Record:
        """Every tick from tare to idle pulse."""
        return self.session.log

    @property
    def failure(self) -> VppError | None:
        """TwinAlarm, RunEnded or LogLost if the run did not go as requested."""
        if (twin := self.session.rig.twin) and twin.alarms:
            ended = f"; the run ended: {self.ended}" if self.ended else ""
            return TwinAlarm(f"twin: {twin.alarms[0].cause}{ended}")
        if self.ended:
            return RunEnded(self.ended)
        if (logged := self.session.logged).failure:
            return LogLost(f"log: {logged.lost} of {logged.rows + logged.lost} rows lost: {logged.failure}")
        return None


class TwinAlarm(VppError):
    """The twin raised an alarm: the rig differs from its model."""

    code = 3


class LogLost(VppError):
    """The run was completed, but rows of its log are lost."""


class Followed:
    """A controller that passes its set-point to the rig's log. `injector` injects its fault at the step `count`."""

    def __init__(self, controller: Controller, rig: RigPlant, injector: Injector | None = None, count: int = 0):
        self._controller, self._rig, self._injector, self._left = controller, rig, injector, count

    def start(self, thrust_set, thrust):
        self._controller.start(thrust_set, thrust)

    def step(self, thrust_set, thrust):
        self._rig.follow(thrust_set)
        if self._injector and self._left == 0:
            self._rig.note(f"injected: {self._injector.name}")
            self._injector()
        self._left -= 1
        try:
            return self._controller.step(thrust_set, thrust)
        except VppError as error:
            self._rig.fail(Fault("controller", FaultKind.FAILED, str(error)))

    def close(self):
        self._controller.close()


class LimitedPlant:
    """A plant behind the rig's limits, so that a difference from the rig is due to the plant."""

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


def check_profile(profile: Record, limits: Limits) -> None:
    """BadInput if the limits would end the run before the profile ends."""
    largest = float(np.max(np.abs(profile["thrust_set"])))
    if largest >= limits.thrust_trip:
        allowed = f"less than {limits.thrust_trip:g} N of either sign, where the rotor is stopped"
        raise BadInput(profile.source, "thrust_set", f"{largest:g} N", allowed)
    if profile.time[-1] > limits.run_time:
        raise BadInput(profile.source, "time", f"{profile.time[-1]:g} s", f"at most the run time, {limits.run_time:g} s")


def start_of(given: Sequence[float] | None, limits: Limits, allowed: Ranges) -> tuple[float, float]:
    """Initial commands [rpm, deg] of a run: those `given`, else the rig's idle. BadInput if they are outside the limits."""
    if given is None:
        return idle(allowed)
    ranges = (limits.omega_min, limits.omega_max, "rpm"), (limits.beta_min, limits.beta_max, "deg")
    for value, (low, high, unit) in zip(given, ranges, strict=True):
        if not low <= value <= high:
            raise BadInput("command line", "--start", f"{value:g} {unit}", f"{low:g} to {high:g} {unit}, as the limits have it")
    return given[0], given[1]


def run_on_rig(
    setup: Setup,
    controller: Controller,
    profile: Record,
    folder: Path,
    start: tuple[float, float] | None = None,
    twin: Twin | None = None,
    after: Sequence[str] = (),
    page: OperatorPage | None = None,
    inject: tuple[str, float] | None = None,
) -> Run:
    """Close the loop over the profile, from the commands `start` [rpm, deg] on (default: the rig's idle). Writes the full-rate
    log to `folder`, however the run ends; `after`, `page` as in `session`. `inject`: a fault of
    `hil.emulator.faults`, and the time [s] after which it comes."""
    ended, start = "", start or idle(setup.allowed)
    if isinstance(controller, FmuController):
        rehearse(controller, float(profile["thrust_set"][0]))
    seconds = float(profile.time[-1] - profile.time[0])
    with session(setup, folder / LOG, seconds, twin, after, page) as one:
        fault, at = inject or ("", 0.0)
        controller = Saboteur(controller, WITHIN.get(fault))
        injector = Injector(fault, one.rig.bench, controller) if inject else None
        followed = Followed(controller, one.rig, injector, round(at / PERIOD))
        try:
            run_loop(one.rig, followed, profile, start, one.rig.show_done)
            one.rig.stop()
        except ENDINGS as reason:
            ended = str(reason)
        finally:
            if injector:
                injector.close()
    return Run(loop_part(one.log), one, ended)


def rehearse(controller: FmuController, thrust_set: float) -> None:
    """Before anything turns: load an FMU, try some steps of it, and leave a fresh instance ready. BadInput if its commands are
    not finite, or the median step takes longer than a tick."""
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


def profile_start(log: Record) -> float:
    """Time [s] in a log of the first row with an active controller, where `loop_part` begins; 0 without one."""
    rows = np.flatnonzero(np.isfinite(log["omega_wanted"]))
    return float(log.time[rows[0]]) if len(rows) else 0.0


def loop_part(log: Record) -> Record:
    """The rows of a log with an active controller, from time 0: the columns RUN and the supply's readings."""
    rows = np.flatnonzero(np.isfinite(log["omega_wanted"]))
    if not len(rows):
        return Record({name: np.empty(0) for name in ("time", *RUN)}, log.source)
    read = [name for name in NAMES if name in log and np.isfinite(log[name][rows]).any()]
    columns = {name: log[name][rows] for name in (*RUN, *read)}
    return Record({"time": np.round(log.time[rows] - profile_start(log), 9), **columns}, log.source)


def write_run(path: Path, record: Record) -> None:
    """Write a run with values exact to the bit, as a replay needs them. BadInput if the disk refuses."""
    cells = [cell(Column(name, exact=name != "time")) for name in record.columns]
    lines = [",".join(record.columns)]
    for row in zip(*(column.tolist() for column in record.columns.values()), strict=True):
        lines.append(",".join([write(value) for write, value in zip(cells, row, strict=True)]))
    write_whole(path, ("\n".join(lines) + "\n").encode(), path)
