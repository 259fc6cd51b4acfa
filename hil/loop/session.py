"""A session with a rig: real time, log, supervisor, signals and terminal; and its results."""

import contextlib
import fcntl
import math
import os
import platform
import sys
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from hil.commands import PAPERS
from hil.devices.calibration import Calibration
from hil.emulator.process import real_time_bench
from hil.emulator.rig import EmulatedRig as Emulated
from hil.emulator.rig import virtual_bench
from hil.loop.bench import Bench, Wiring, real_bench
from hil.loop.columns import COLUMNS, LEARNED, STATES
from hil.loop.cycle import PERIOD
from hil.loop.live import status_line
from hil.loop.log import Column, Logged, MemoryLog, ProcessLog
from hil.loop.realtime import real_time
from hil.loop.rig import RigPlant
from hil.loop.room import Reserve, check_room, rows_of
from hil.loop.timing import Timing, timing
from hil.page.operator_page import OperatorPage
from hil.safety.limits import Limits
from hil.safety.plausibility import Plausibility, thresholds_of
from hil.safety.polarity import Polarity
from hil.safety.stop import StopSignals
from hil.safety.supervisor import Supervisor
from hil.safety.tare import gate_of
from hil.twin.twin import Twin
from vpp_fmu.errors import BadInput
from vpp_fmu.files import write_whole
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig as Ranges
from vpp_fmu.table import read_table

LOG, REPORT = "log.csv", "supervisor.log"
_PACKAGES = ("vpp-fmu", "numpy", "fmpy", "pyserial", "smbus2")


@dataclass(frozen=True)
class Setup:
    """The rig: `emulated` in `virtual` or real time, or the real one by its `wiring`; its calibration and limits.

    `plant`: its model's parameters by the kernel's names (default: the paper's). `allowed`: the measured or declared ranges,
    slews and scales from which the limits are derived. `truth`: the emulated rig's true calibration, if a run is to find it.
    """

    calibration: Calibration
    limits: Limits
    emulated: Emulated | None = None
    virtual: bool = False
    wiring: Wiring | None = None
    plant: Mapping[str, float] | None = None
    map_is_known: bool = True
    allowed: Ranges = PAPERS
    truth: Calibration | None = None

    def plausibility(self) -> Plausibility:
        """The checks of a run's readings. Without a known map thrust can't show the blades' pitch, so it is not checked."""
        thresholds = thresholds_of(self.allowed)
        if not self.map_is_known:
            thresholds = replace(thresholds, effect=-math.inf)
        return Plausibility(self.limits, PERIOD, self.plant, thresholds, self.allowed.scales.time_scale)

    def polarity(self) -> Polarity:
        """The check of signs before a loop is closed."""
        return Polarity(self.limits, self.allowed, self.plant, self.map_is_known)

    def bench(self) -> Bench:
        """The rig's devices, ready to use. DeviceFault NOT_READY."""
        if self.emulated is None:
            return real_bench(self.calibration, self.wiring or Wiring())
        return (virtual_bench if self.virtual else real_time_bench)(self.emulated, self.calibration, self.truth)

    def summary(self) -> dict:
        """For `hil.json`."""
        kind = "real" if self.emulated is None else "emulated"
        hidden = list(self.emulated.hidden) if self.emulated else []
        found = {"rig": kind, "time": "virtual" if self.virtual else "real", "hidden": hidden, "period": PERIOD}
        found |= {"allowed": self.allowed.summary()}
        if self.calibration.supply:
            found["supply"] = list(self.calibration.supply)
        if self.emulated:
            found |= {"physics": dict(self.emulated.parameters), "seed": self.emulated.seed}
        calibration = {"sha256": self.calibration.sha256, "source": dict(self.calibration.source)}
        return found | {"calibration": calibration, "limits": asdict(self.limits)}


class Session:
    """A rig in use, and after the end its results."""

    def __init__(self, rig: RigPlant, setup: Setup, granted: str, path: Path):
        self.rig, self._setup, self._granted, self._path = rig, setup, granted, path
        self.logged: Logged | None = None

    @cached_property
    def log(self) -> Record:
        """The full-rate log, as read from its file."""
        return read_log(found_log(self._path))

    @property
    def timing(self) -> Timing | None:
        """The timing of the ticks; None in virtual time, or if the log failed."""
        return None if self._setup.virtual or self.logged.failure else timing(self.log)

    def summary(self) -> dict:
        """The content of `hil.json` that every use of a rig shares."""
        rig, timed = self.rig, self.timing
        return {
            "format": "vpp-hil/1",
            **self._setup.summary(),
            "real_time": self._granted,
            "versions": versions(),
            **history(rig.events, self._path.with_name(REPORT)),
            "counters": rig.counters,
            "log": {"ticks": rig.ticks.ticks, **asdict(self.logged)},
            "timing": timed.summary() if timed else None,
        }


def history(events: Sequence[Mapping], report: Path) -> dict:
    """Entries of hil.json from the events of a run and the file of the supervisor's actions."""
    states = [{key: event.get(key) for key in ("time", "state", "why")} for event in events if "state" in event]
    return {
        "tares": [event["tare"] for event in events if "tare" in event],
        "transitions": [{"time": 0.0, "state": STATES[0], "why": "start"}, *states],
        "supervisor": report.read_text().splitlines() if report.exists() else [],
    }


@contextlib.contextmanager
def session(
    setup: Setup,
    path: Path,
    seconds: float,
    twin: Twin | None = None,
    after: Sequence[str] = (),
    page: OperatorPage | None = None,
) -> Iterator[Session]:
    """A rig to use within the context. After it the idle pulse is on the outputs, and the log and the session are complete.

    `path`: of the full-rate log. `seconds`: the length of the run, for which the disk must have room (BadInput). `after`: the
    command that makes a report of the log if this process can't. `page`: the operator's page, in real time only.
    """
    columns = (*COLUMNS, *(Column(LEARNED + name) for name in (twin.outputs if twin else ())))
    check_room(path, columns, seconds)
    with contextlib.ExitStack() as ends:
        reserve = Reserve(path.parent, seconds)
        ends.callback(reserve.free)
        bench = setup.bench()
        ends.callback(bench.close)
        log = MemoryLog(path, columns) if setup.virtual else ProcessLog(path, columns, after, rows_of(seconds))
        if page:
            page.follow(log)
        if line := status_line():
            ends.callback(line.close)
        report = path.with_name(REPORT)
        report.unlink(missing_ok=True)
        pressed = (lambda: page.pressed) if page else (lambda: False)
        quick = contextlib.nullcontext("virtual time") if setup.virtual else real_time()
        with StopSignals(pressed) as signals, quick as granted:

            def supervise() -> Supervisor:
                return Supervisor(bench.outputs, report, keep=(bench.lock,), lifted=granted.lifted)

            rig = RigPlant(
                bench,
                setup.limits,
                log,
                None if setup.virtual else supervise,
                signals,
                twin,
                line,
                setup.plausibility,
                gate_of(setup.allowed),
                setup.polarity(),
                page,
            )
            one = Session(rig, setup, str(granted), path)
            try:
                yield one
            finally:
                rig.close()
                reserve.free()  # for the rows that still wait, and the files after the run
                one.logged = log.close()


def found_log(path: Path) -> Path:
    """The log at `path`, a log or a run's folder. A log whose writer died still has its temporary name: it is cut after its
    last complete row and renamed. BadInput if there is none."""
    log = path / LOG if path.is_dir() else path
    part = log if log.name.endswith(".part") else log.with_name(f".{log.name}.part")
    log = part.with_name(part.name.removeprefix(".").removesuffix(".part"))
    if log.exists():
        return log
    if not part.exists():
        raise BadInput(path, "file", "no such file", "a log.csv of vpp hil, or the folder of its run")
    with open(part, "rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise BadInput(path, "file", "a log that is being written", "the log of a run that has ended") from error
        data = file.read()
    if log.suffix == ".gz":
        data = zlib.decompressobj(wbits=31).decompress(data)
    whole = data[: data.rfind(b"\n") + 1]
    if log.suffix == ".gz":
        pack = zlib.compressobj(1, wbits=31)
        whole = pack.compress(whole) + pack.flush()
    write_whole(part, whole, log)  # a full disk must not destroy the existing data
    os.replace(part, log)
    return log


def read_log(path: Path) -> Record:
    """Read a full-rate log; empty cells are NaN."""
    table = read_table(path)
    columns = {name: table.numbers(name, ("",)) for name in table.columns if name != "state"}
    return Record({**columns, "state": np.asarray(table.columns["state"], str)}, str(path))


def versions() -> dict[str, str]:
    """Versions of Python, the system and the packages."""
    found = {"python": sys.version.split()[0], "system": f"{platform.system()} {platform.release()} {platform.machine()}"}
    for name in _PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            found[name] = version(name)
    return found
