"""A run on the rig and its files: hil.json, run.csv, report.html; written by the run, or from its log if the run could not."""

import contextlib
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from hil.loop.log import events_of
from hil.loop.rig import RunEnded
from hil.loop.session import LOG, read_log
from hil.loop.timing import Timing, timing
from hil.page.operator_page import OperatorPage
from hil.results.runs import ENDED, ENDED_EARLY, NAMES, RUNNING, run_folder, summary_of_files, twin_entry
from hil.run import Run, loop_part, write_run
from vpp_fmu.comparison import compare
from vpp_fmu.date import now
from vpp_fmu.digits import number
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder
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
class Outcome:
    """The results of a run: the content of hil.json, the `log` (None if it has no row), the loops over the profile by name, the
    rig's first, the timing of its ticks in real time, and (least, greatest) of each command by name, if known."""

    content: dict
    log: Record | None
    loops: dict[str, Record]
    timing: Timing | None
    limits: Mapping[str, tuple[float, float]]

    @cached_property
    def steps(self) -> dict[str, list[Step]]:
        """The changes of the set-point in each loop."""
        return {name: judged_steps(loop, self.limits) for name, loop in self.loops.items()}

    def judged(self) -> dict:
        """Entries of hil.json about these changes."""
        return {"units": UNITS, "steps": {name: [asdict(one) for one in found] for name, found in self.steps.items()}}


Report = Callable[[Outcome], str]
"""Makes the page of a run, as HTML."""


def carry_out(
    run: Callable[[Path, Sequence[str]], Run],
    begun: dict,
    parent: OutputFolder,
    page: OperatorPage | None,
    say: Say,
    report: Report,
    beside: tuple[str, Record] | None = None,
) -> tuple[Run, OutputFolder, Outcome]:
    """Carry out a run; returns it, the folder of its files below `parent`, and the outcome. `run` makes it, with the log in a
    folder and the command `after` of `session`. `begun`: content of hil.json before it. `beside`: a plant FMU's name and its
    loop. An unforeseen error is raised after the files are written from the log, as far as possible."""
    if page:
        page.part("run")
    folder = OutputFolder(run_folder(parent.path, begun["begun"]))
    folder.write("hil.json", as_json(begun))
    say(f"this run's files: {folder.path}")
    try:
        done = run(folder.path, [sys.executable, "-m", "vpp_fmu", "hil", "report", str(folder.path.absolute())])
    except BaseException as error:
        record, content = summary_of_files(folder.path / LOG, begun)
        content["ended"] = " ".join(str(error).split()) or type(error).__name__
        with contextlib.suppress(BadInput):  # the first error is the one to report
            found = finish(folder, content, record, report)
            for line in lines_of(found) if record else ():
                say(line)
        raise
    if page:
        page.end(done.ended or "as planned")
    content = done.session.summary() | begun | {"ended": done.ended}
    content |= twin_entry(begun, done.session.rig.events)
    try:
        return done, folder, finish(folder, content, done.log, report, beside)
    except BadInput as refused:
        if not done.ended:
            raise
        raise RunEnded(f"{done.ended}; {refused}") from refused


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


def finish_fmu(folder: OutputFolder, plant: str, record: Record, limits: Mapping[str, tuple[float, float]]) -> Outcome:
    """Write the files of a run with a plant FMU instead of the rig, except its page. `limits` of its commands."""
    write_run(folder.path / "run.csv", record)
    found = Outcome({"format": "vpp-hil/1", "rig": "fmu", "plant": Path(plant).name}, None, {"plant FMU": record}, None, limits)
    found.content.update(found.judged())
    folder.write("hil.json", as_json(found.content))
    return found


def finish(
    folder: OutputFolder, content: dict, log: Record | None, report: Report, beside: tuple[str, Record] | None = None
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
        content["twin"] = {"alarms": [], **content["twin"], "residual_rms": None if log is None else _rms(log["residual"])}
    real_time = log is not None and content.get("timing")
    if loops and beside is not None:
        loops["plant FMU"] = beside[1]
        content["beside"] = {"plant": beside[0], "rms_thrust": _rms(difference(*reversed(loops.values()))["thrust"])}
    limits = reach(content.get("limits", {}), content.get("controller", {}).get("limits", {}))
    found = Outcome(content, log, loops, timing(log) if real_time else None, limits)
    content |= found.judged()
    refusals: list[BadInput] = []
    for write in (  # hil.json first: on a full disk the reason of the end is worth most
        lambda: folder.write("hil.json", as_json(content)),
        lambda: write_run(folder.path / "run.csv", record) if loops else None,
        lambda: folder.write("report.html", report(found)),
    ):
        try:
            write()
        except BadInput as refused:
            refusals.append(refused)
    if refusals:
        raise refusals[0]
    return found


def _rms(values: np.ndarray) -> float | None:
    """Root mean square of the known ones of (n,) values."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else None


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


def said(step: Step, name: str) -> str:
    never = f"is out of reach, {step.reached}" if step.stuck else "does not settle"
    when = never if step.settling is None else f"settles within {number(step.settling, 3)} s"
    return f"{name}: the step from {number(step.before)} to {number(step.after)} N at {number(step.time)} s {when}"


def step_lines(found: Outcome) -> list[str]:
    """The steps of the set-point, one a line."""
    steps = [(name, step) for name, steps in found.steps.items() for step in steps]
    return [f"{said(step, name)}, overshoot {step.overshoot:.1f} %" for name, step in steps]


def lines_of(found: Outcome) -> list[str]:
    """The results of a run in words."""
    content, lines = found.content, step_lines(found)
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
