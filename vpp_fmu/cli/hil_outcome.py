"""What a run on the rig leaves: hil.json, run.csv, report.html; made by the run itself, or of its log by whoever is left."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hil.columns import LEARNED
from hil.report import add_counts, add_difference, add_loops, add_timing, add_twin, judged_steps, said
from hil.run import loop_part, write_run
from hil.runs import alarm_of
from hil.timing import Timing, timing
from vpp_fmu.cli.output import as_json
from vpp_fmu.date import now
from vpp_fmu.digits import number
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder
from vpp_fmu.record import Record
from vpp_fmu.report import Page, adapted_parameters, residual_in_band, thinning
from vpp_fmu.report.twin import ADAPTED

RUNNING, ENDED, ENDED_EARLY = "running", "ended", "ended early"
"""`status` in hil.json."""


def finish(folder: OutputFolder, told: dict, log: Record | None, beside: tuple[str, Record] | None = None) -> None:
    """Write what a run leaves, and print its figures. `told`: what hil.json says, with `ended`, why it ended early, or "".

    What one file is refused doesn't keep the others from being written: BadInput, for the first of them, comes at the end.
    """
    told = {**told, "status": ENDED_EARLY if told["ended"] else ENDED, "completed": now()}
    record = loop_part(log) if log is not None else None
    loops = {"rig": record} if record is not None and len(record.time) > 1 else {}
    if "twin" in told:
        told["twin"] = _with_residual(told["twin"], log)
    real_time = log is not None and told.get("timing")
    found = timing(log["late"], log["busy"], log["missed"]) if real_time else None
    page = Page(
        "Hardware in the loop",
        _summary(told),
        f"{told.get('rig') or 'unknown'} rig, run of {(told.get('begun') or 'a date not known')[:10]}",
    )
    _tiles(page, told, found)
    if told["ended"]:
        page.note(f"The run ended early. {told['ended']}.")
    if loops and beside is not None:
        loops["plant FMU"] = beside[1]
    refusals: list[BadInput] = []
    if loops:
        with _borne(refusals):
            write_run(folder.path / "run.csv", record)
        add_loops(page, loops, "Pitch is not measured on the rig.")
    if len(loops) > 1:
        told["beside"] = {"plant": beside[0], "rms_thrust": add_difference(page, *reversed(loops.items()))}
    if log is not None and told.get("twin"):
        _add_twin(page, log, told["twin"])
    if log is not None and told.get("adaptive_twin"):
        _add_adaptive(page, log, told["adaptive_twin"])
    if found:
        add_timing(page, found, f"The loop had: {told.get('real_time', 'not known')}.")
    add_counts(page, told["counters"], [(t["time"], t["state"], t["why"]) for t in told["transitions"]])
    with _borne(refusals):
        folder.write("hil.json", as_json(told))
    with _borne(refusals):
        folder.write("report.html", page.html())
    _say(loops, told, found)
    if refusals:
        raise refusals[0]


@contextlib.contextmanager
def _borne(refusals: list[BadInput]) -> Iterator[None]:
    try:
        yield
    except BadInput as refused:
        refusals.append(refused)


def _with_residual(twin: dict, log: Record | None) -> dict:
    """What became of the twin, as the log has it where the run could not say it."""
    residual = log["residual"][np.isfinite(log["residual"])] if log is not None else np.empty(0)
    since = alarm_of(log) if log is not None else None
    known = {"alarmed": since is not None, "since": since}
    return {**known, **twin, "residual_rms": float(np.sqrt(np.mean(residual**2))) if len(residual) else None}


def _add_twin(page: Page, log: Record, twin: dict) -> None:
    rows = log.part(np.isfinite(log["residual"]))
    text = (
        f"At most {twin['false_alarms_per_hour']:g} false alarms an hour; a constant {number(twin['smallest_found'], 3)} N is "
        f"found after {twin['delay']:.1f} s in the mean."
    )
    if len(rows):
        add_twin(page, rows.time, rows["residual"], rows["alarm"], twin["noise"], text)


def _add_adaptive(page: Page, log: Record, twin: dict) -> None:
    """What the twin that learns made of the run, where the log has it."""
    units = {name: unit for name, unit in twin["units"].items() if LEARNED + name in log}
    if not units or not np.isfinite(log[LEARNED + "band"]).any():
        return
    rows = log.part(np.isfinite(log[LEARNED + "band"]))
    told = {name: rows[LEARNED + name] for name in units}
    page.figure(residual_in_band(rows.time, told), f"Measured thrust less the adapted model's. {thinning(len(rows))}")
    own = {name.removeprefix(ADAPTED): unit for name, unit in units.items() if name.startswith(ADAPTED)}
    page.figure(adapted_parameters(rows.time, told, own), "What the adaptive twin made of its parameters.")


def _summary(told: dict) -> str:
    hidden = f" with {', '.join(told['hidden'])} hidden in it" if told.get("hidden") else ""
    profile, calibration = (
        told.get("profile", {}).get("file", "a profile"),
        told.get("calibration", {}).get("sha256", "not known"),
    )
    made = "" if "made_from" not in told else " Its loop was gone at the end: this was made from its log."
    return (
        f"The {told.get('rig', '')} rig{hidden}, {told.get('time', 'not known')} time, over {profile}. "
        f"Calibration {calibration[:12]}. Begun {told.get('begun', 'at a time not known')}.{made}"
    )


def _tiles(page: Page, told: dict, found: Timing | None) -> None:
    log = told["log"]
    page.tiles([("rows in the log", f"{log['rows']}", f"{log['lost']} of {log['ticks']} ticks lost")])
    if found:
        page.tiles([("late, p99.9", f"{1e6 * found.late[2]:.0f} us", f"{found.missed} slots missed")])
    if told["tares"]:
        tare = told["tares"][-1]
        page.tiles([("tare", f"{tare['zero_counts']:.1f} counts", f"noise {number(tare['noise_N'])} N")])
    healed = sum(n for device in told["counters"].values() for name, n in device.items() if name != "pulses")
    page.tiles([("healed", f"{healed}", "transfers and frames that failed once")])


def say_steps(loops: dict[str, Record]) -> None:
    """The steps of the set-point, one a line."""
    for name, loop in loops.items():
        for step in judged_steps(loop):
            print(f"{said(step, name)}, overshoot {step.overshoot:.1f} %")


def _say(loops: dict[str, Record], told: dict, found: Timing | None) -> None:
    say_steps(loops)
    if "beside" in told:
        print(f"rig and {told['beside']['plant']} differ by {number(told['beside']['rms_thrust'])} N rms")
    if told.get("twin") and told["twin"]["residual_rms"] is not None:
        twin = told["twin"]
        said_so = f"alarm, since {twin['since']:.2f} s" if twin["alarmed"] else "no alarm"
        print(f"twin: {said_so}; residual {number(twin['residual_rms'])} N rms")
    if told.get("adaptive_twin"):
        alarms = told["adaptive_twin"].get("alarms", ())
        said_so = ", ".join(f"{one['time']:.1f} s ({one['points_to']})" for one in alarms) or "none"
        print(f"adaptive twin: alarms: {said_so}")
    log = told["log"]
    failure = f"; {log['failure']}" if log["failure"] else ""
    print(f"log: {log['rows']} rows of {log['ticks']} ticks, {log['lost']} lost{failure}")
    if found:
        print(f"loop: {told.get('real_time', 'not known')}\n{found.text()}")


def kept_of(folder: Path) -> str:
    """Which of a run's files stand, in words."""
    there = [name for name in ("hil.json", "log.csv", "run.csv", "report.html") if (folder / name).exists()]
    return ", ".join(there) or "nothing"
