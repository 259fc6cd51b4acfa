"""A run on the rig and its files: hil.json, run.csv, report.html; written by the run, or from its log if the run could not."""

import contextlib
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from hil.loop.columns import LEARNED
from hil.loop.log import events_of
from hil.loop.rig import RunEnded
from hil.loop.session import LOG, Setup, read_log
from hil.loop.timing import Timing, timing
from hil.page.operator_page import OperatorPage
from hil.results.runs import ENDED, ENDED_EARLY, NAMES, RUNNING, run_folder, summary_of_files
from hil.run import LimitedPlant, Run, loop_part, run_on_rig, write_run
from hil.safety.limits import Limits
from hil.twin.twin import Twin, alarm_of
from vpp_fmu.comparison import compare
from vpp_fmu.date import now
from vpp_fmu.digits import number
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder
from vpp_fmu.loop import run as run_loop
from vpp_fmu.plants import Controller, FmuPlant
from vpp_fmu.record import Record
from vpp_fmu.response import UNITS, Step, smoothed, steps
from vpp_fmu.structured import as_json, check_kinds, read_object

Say = Callable[[str], None]
"""Prints a line for the user."""

BEGUN = {
    "status?": str,
    "rig?": str,
    "time?": str,
    "begun?": str,
    "hidden?": [str],
    "profile?": {"file?": str},
    "limits?": {"*": float},
    "controller?": {"limits?": {"*": float}},
    "calibration?": {"sha256?": str},
    "twin?": {
        "false_alarms_per_hour": float,
        "units": {"*": str},
        "adapted": {"*": {"description": str}},
        "alarms?": [{"time": float, "cause": str}],
    },
}
"""Entries of hil.json that a report reads."""

DONE = BEGUN | {
    "ended": str,
    "real_time?": str,
    "tares": [{"zero_counts": float, "noise_N": float}],
    "transitions": [{"time": float, "state": str, "why": str}],
    "counters": {"*": {"*": int}},
    "log": {"ticks": int, "rows": int, "lost": int, "failure": str, "warning?": str},
    "timing?": dict,
    "energy?": {"value": float, "unit": str, "mean_power": float, "peak_power": float},
}
"""The same for a run whose loop completed hil.json."""

BAND, SPAN = 0.05, 0.1
"""A step has settled once its thrust, averaged over SPAN s, stays within BAND of its size; with noise 2 % is too narrow."""


@dataclass(frozen=True, eq=False)
class RunSetup:
    """A run: the rig, its controller, profile and initial commands `start` [rpm, deg], and models to compare it with.

    `beside`: a plant FMU's name and its loop. `inject` as in `run_on_rig`.
    """

    setup: Setup
    controller: Controller
    profile: Record
    start: tuple[float, float]
    twin: Twin | None = None
    beside: tuple[str, Record] | None = None
    inject: tuple[str, float] | None = None

    def summary(self) -> dict:
        """Entries of hil.json about the twin and the injected fault, before the run."""
        injected = {"injected": dict(zip(("fault", "after"), self.inject, strict=True))} if self.inject else {}
        return injected | ({"twin": self.twin.summary()} if self.twin else {})


@dataclass(frozen=True, eq=False)
class Outcome:
    """The results of a run: the content of hil.json, the `log` (None if it has no row), the loops over the profile by name, the
    rig's first, and the timing of its ticks in real time."""

    content: dict
    log: Record | None
    loops: dict[str, Record]
    timing: Timing | None

    @property
    def reach(self) -> dict[str, tuple[float, float]]:
        """The ranges of the commands, as from `reach`, by the limits in hil.json."""
        return reach(self.content.get("limits", {}), self.content.get("controller", {}).get("limits", {}))


Report = Callable[[Outcome], str]
"""Makes the page of a run, as HTML."""


def carry_out(
    task: RunSetup, begun: dict, parent: OutputFolder, page: OperatorPage | None, say: Say, report: Report
) -> tuple[Run, OutputFolder, Outcome]:
    """Carry out the run; returns it, the folder of its files below `parent`, and the outcome. `begun`: content of hil.json
    before the run. An unforeseen error is raised after the files are written from the log, as far as possible."""
    if page:
        page.part("run")
    folder = OutputFolder(run_folder(parent.path, begun["begun"]))
    folder.write("hil.json", as_json(begun))
    say(f"this run's files: {folder.path}")
    command = [sys.executable, "-m", "vpp_fmu", "hil", "report", str(folder.path.absolute())]
    try:
        own = task.setup, task.controller, task.profile, folder.path, task.start, task.twin
        done = run_on_rig(*own, command, page, task.inject)
    except BaseException as error:
        _cut_short(folder, begun, error, say, report)
        raise
    if page:
        page.end(done.ended or "as planned")
    task.controller.close()
    content = done.session.summary() | begun | {"ended": done.ended}
    if task.twin:
        content["twin"] |= {"alarms": [one._asdict() for one in task.twin.alarms]}
    try:
        found = finish(folder, content, done.log, report, task.beside)
    except BadInput as refused:
        if not done.ended:
            raise
        raise RunEnded(f"{done.ended}; {refused}") from refused
    return done, folder, found


def _cut_short(folder: OutputFolder, begun: dict, error: BaseException, say: Say, report: Report) -> None:
    """Write the files of a run that an unforeseen error ended, from its log if there is one."""
    record, content = summary_of_files(folder.path / LOG, begun)
    content["ended"] = " ".join(str(error).split()) or type(error).__name__
    with contextlib.suppress(BadInput):  # the first error is the one to report
        if record is None:
            folder.write("hil.json", as_json(content | {"status": ENDED_EARLY, "completed": now()}))
        else:
            for line in lines_of(finish(folder, content, record, report)):
                say(line)


def of_log(log: Path) -> tuple[Record | None, dict, bool]:
    """(a run's log, content of its hil.json, whether the loop ended before it completed hil.json). BadInput."""
    path, begun = log.with_name("hil.json"), {"format": "vpp-hil/1"}
    if path.exists():
        begun = read_object(path, "vpp-hil/1", "what vpp hil run has written")
        if "parts" in begun:
            raise BadInput(path, "parts", "a campaign", "a run", "vpp hil campaign --resume to go on with a campaign")
        check_kinds(path, begun, BEGUN if begun.get("status", RUNNING) == RUNNING else DONE)
    if begun.get("status", RUNNING) != RUNNING:
        return read_log(log), begun, False
    record, content = summary_of_files(log, begun)
    check_kinds(events_of(log), content, DONE)
    return record, content, True


def fmu_loop(plant: str, controller: Controller, profile: Record, start: tuple[float, float], limits: Limits) -> Record:
    """The same loop with a plant FMU behind the same limits."""
    limited = LimitedPlant(FmuPlant(plant), limits)
    record = run_loop(limited, controller, profile, start)
    limited.close()
    controller.close()
    return record


def finish_fmu(folder: OutputFolder, plant: str, record: Record, limits: Mapping[str, tuple[float, float]]) -> dict:
    """Write the files of a run with a plant FMU instead of the rig, except its page; returns the content of hil.json. `limits`:
    as of `judged_steps`."""
    write_run(folder.path / "run.csv", record)
    content = {"format": "vpp-hil/1", "rig": "fmu", "plant": Path(plant).name, **_settling({"plant FMU": record}, limits)}
    folder.write("hil.json", as_json(content))
    return content


def finish(
    folder: OutputFolder,
    content: dict,
    log: Record | None,
    report: Report,
    beside: tuple[str, Record] | None = None,
) -> Outcome:
    """Write the files of a run. `content`: of hil.json, with `ended`: why the run ended early, or "".

    If a file cannot be written, the others still are; then BadInput is raised for the first of them.
    """
    content = {**content, "status": ENDED_EARLY if content["ended"] else ENDED, "completed": now()}
    record = loop_part(log) if log is not None else None
    loops = {"rig": record} if record is not None and len(record.time) > 1 else {}
    if loops and (taken := energy(record)):
        content["energy"] = taken
    if "twin" in content:
        content["twin"] = _with_residual(content["twin"], log)
    real_time = log is not None and content.get("timing")
    if loops and beside is not None:
        loops["plant FMU"] = beside[1]
        rms = float(np.sqrt(np.mean(difference(*reversed(loops.values()))["thrust"] ** 2)))
        content["beside"] = {"plant": beside[0], "rms_thrust": rms}
    found = Outcome(content, log, loops, timing(log) if real_time else None)
    content |= _settling(loops, found.reach)
    refusals: list[BadInput] = []
    with _collected(refusals):
        folder.write("hil.json", as_json(content))  # first: on a full disk the reason of the end is worth most
    if loops:
        with _collected(refusals):
            write_run(folder.path / "run.csv", record)
    with _collected(refusals):
        folder.write("report.html", report(found))
    if refusals:
        raise refusals[0]
    return found


@contextlib.contextmanager
def _collected(refusals: list[BadInput]) -> Iterator[None]:
    try:
        yield
    except BadInput as refused:
        refusals.append(refused)


def _with_residual(twin: dict, log: Record | None) -> dict:
    """The twin's entries with its residual, and its alarms from the log if the run could not report them."""
    if log is None or LEARNED + "direction" not in log:
        return {"alarms": [], **twin, "residual_rms": None}
    rows = log.part(np.isfinite(log["residual"]))
    begins = np.flatnonzero(np.diff(rows["alarm"], prepend=0.0) > 0.5)
    at = zip(*(column[begins].tolist() for column in (rows.time, rows["residual"], rows[LEARNED + "direction"])), strict=True)
    found = [alarm_of(*values, twin["adapted"])._asdict() for values in at]
    rms = float(np.sqrt(np.mean(rows["residual"] ** 2))) if len(rows) else None
    return {"alarms": found, **twin, "residual_rms": rms}


def energy(run: Record) -> dict | None:
    """Electrical energy that a loop took from the supply, with mean and largest power [W], as in hil.json; None unless voltage
    and current were both read. A reading holds until the next one."""
    if not {"voltage", "current"} <= set(run.columns):
        return None
    power = run["voltage"] * run["current"]
    if not (read := np.isfinite(power[:-1])).any():
        return None
    mean = float(np.average(power[:-1][read], weights=np.diff(run.time)[read]))
    joule = mean * float(run.time[-1] - run.time[0])
    return {"value": joule, "unit": "J", "mean_power": mean, "peak_power": float(np.nanmax(power))}


def energy_words(taken: Mapping) -> tuple[str, str]:
    """The result of `energy` in words: the energy, and the power."""
    power = f"{number(taken['mean_power'], 3)} W in the mean, {number(taken['peak_power'], 3)} W at most"
    return f"{number(taken['value'], 3)} J", power


def difference(first: Record, second: Record) -> Record:
    """Thrust [N] of the second loop minus that of the first, at the times of the first."""
    both = compare(first, second)
    return Record({"time": both.time, "thrust": both.second["thrust"] - both.first["thrust"]}, "difference")


def reach(*limits: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """(least, greatest) of each command within all of these limits (`omega_min` and so on); a command without any is absent."""
    found = {}
    for name in ("omega", "beta"):
        low, high = ([one[f"{name}_{end}"] for one in limits if f"{name}_{end}" in one] for end in ("min", "max"))
        if low and high:
            found[f"{name}_ref"] = max(low), min(high)
    return found


def limits_by_end(limits: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """A controller's limits, (least, greatest) of each command, as hil.json holds them."""
    return {name.replace("ref", end): x for name, pair in limits.items() for end, x in zip(("min", "max"), pair, strict=True)}


def judged_steps(run: Record, limits: Mapping[str, tuple[float, float]]) -> list[Step]:
    """Every change of the set-point, evaluated on the smoothed thrust; `limits` as of `vpp_fmu.response.steps`."""
    return steps(smoothed(run, SPAN), BAND, limits)


def _settling(loops: Mapping[str, Record], limits: Mapping[str, tuple[float, float]]) -> dict:
    """Entries of hil.json about the changes of the set-point in each loop."""
    judged = {name: [asdict(step) for step in judged_steps(loop, limits)] for name, loop in loops.items()}
    return {"units": UNITS, "steps": judged}


def said(step: Step, name: str) -> str:
    never = f"is out of reach, {step.reached}" if step.stuck else "does not settle"
    when = never if step.settling is None else f"settles within {number(step.settling, 3)} s"
    return f"{name}: the step from {number(step.before)} to {number(step.after)} N at {number(step.time)} s {when}"


def step_lines(loops: dict[str, Record], limits: Mapping[str, tuple[float, float]]) -> list[str]:
    """The steps of the set-point, one a line."""
    judged = [(name, step) for name, loop in loops.items() for step in judged_steps(loop, limits)]
    return [f"{said(step, name)}, overshoot {step.overshoot:.1f} %" for name, step in judged]


def lines_of(found: Outcome) -> list[str]:
    """The results of a run in words."""
    content, lines = found.content, step_lines(found.loops, found.reach)
    if "energy" in content:
        lines.append("energy from the supply: {}, {}".format(*energy_words(content["energy"])))
    if "beside" in content:
        lines.append(f"rig and {content['beside']['plant']} differ by {number(content['beside']['rms_thrust'])} N rms")
    if content.get("twin") and content["twin"]["residual_rms"] is not None:
        twin = content["twin"]
        said_so = ", ".join(f"{one['time']:.1f} s ({one['direction'] or 'no parameter'})" for one in twin["alarms"]) or "none"
        lines.append(f"twin: alarms: {said_so}; residual {number(twin['residual_rms'])} N rms")
    log = content["log"]
    more = "".join(f"; {why}" for why in (log["failure"], log.get("warning")) if why)
    lines.append(f"log: {log['rows']} rows of {log['ticks']} ticks, {log['lost']} lost{more}")
    return [*lines, f"loop: {content.get('real_time', 'not known')}\n{found.timing.text()}"] if found.timing else lines


def kept_of(folder: Path) -> str:
    """Names of a run's files that exist, in words."""
    return ", ".join(name for name in NAMES if (folder / name).exists()) or "nothing"
