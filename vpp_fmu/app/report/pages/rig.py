"""The pages of the rig: a run with its loop, twin, timing and events; self-test, replay and calibration."""

from collections.abc import Mapping

import numpy as np

from hil.calibrate import Measured
from hil.devices.calibration import Calibration
from hil.loop.columns import LEARNED
from hil.loop.timing import PERCENTILES, Timing
from hil.replay import Replay
from hil.results.outcome import SPAN, Outcome, difference, energy_words, said
from hil.run import profile_start
from hil.selftest import SelfTest
from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import figure
from vpp_fmu.app.report.figures import stacked, two_records
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.pages.loop import add_adaptive, add_loops, headline, step_tiles
from vpp_fmu.digits import number, signed
from vpp_fmu.record import QUANTITIES, Record
from vpp_fmu.response import smoothed

WITHIN = f"the thrust's mean over {SPAN:g} s stays within 5 % of the step"
"""When a step counts as settled: with noise 2 % is too narrow."""


def run_page(found: Outcome) -> Page:
    content, loops, log = found.content, found.loops, found.log
    begin = 0.0
    if log is not None:
        begin = profile_start(log)
        log = log.with_columns(time=np.round(log.time - begin, 9))
    result = headline(next(iter(found.steps.values()))) if loops else "There is no closed loop to judge."
    page = Page("Hardware in the loop", result, _summary(content))
    _tiles(page, found)
    if content["ended"]:
        page.note(f"The run ended early. {content['ended']}.")
    if loops:
        _add_loops(page, found)
    if len(loops) > 1:
        _add_difference(page, *reversed(loops.items()))
    if log is not None and content.get("twin"):
        add_twin(page, log, content["twin"], begin)
    if found.timing:
        _add_timing(page, found.timing, content.get("real_time", "not known"))
    _add_counts(page, content, begin)
    return page


def fmu_page(plant: str, profile: str, found: Outcome) -> Page:
    """The page of a run with a plant FMU in the rig's place; `plant`, `profile`: their files."""
    page = Page("Hardware in the loop, with a plant FMU", f"{plant} over {profile}.")
    _add_loops(page, found)
    return page


def selftest_page(found: SelfTest, content: Mapping, seconds: float) -> Page:
    """The page of a self-test of so many seconds; `content`: hil.json."""
    page = Page("Self-test of the rig", f"{seconds:g} s at the idle pulse, {found.load} busy processes beside the loop.")
    good = sum(check.good for check in found.checks)
    page.tiles([("checks passed", f"{good} of {len(found.checks)}", "see the table")])
    if found.session.timing:
        _add_timing(page, found.session.timing, content["real_time"])
    rows = [(check.what, "good" if check.good else "not good", check.found) for check in found.checks]
    page.table(("what", "verdict", "found"), rows, "What was looked at.")
    _add_counts(page, content)
    return page


def replay_page(found: Replay, text: str) -> Page:
    """Each command as recorded and as replayed, under a `text`."""
    page = Page("Replay", text)
    names = {"omega_ref": "speed [rpm]", "beta_ref": "pitch [deg]"}
    rows = {label: {"recorded": found.recorded[name], "replayed": found.record[name]} for name, label in names.items()}
    apart = " and ".join(f"{found.largest[name]:.3g} {QUANTITIES[name].unit}" for name in names)
    page.figure(stacked(found.record.time, rows, f"The replayed commands differ by at most {apart}"))
    return page


def _add_loops(page: Page, found: Outcome) -> None:
    name, steps = next(iter(found.steps.items()))
    add_loops(page, found.loops, found.steps, found.limits, said(steps[0], name) if steps else "", WITHIN)


def _add_difference(page: Page, first: tuple[str, Record], second: tuple[str, Record]) -> None:
    (name_a, a), (name_b, b) = first, second
    between = difference(a, b)
    rms, mean = np.sqrt(np.mean(between["thrust"] ** 2)), float(between["thrust"].mean())
    title = f"{name_b} and {name_a} differ by {number(float(rms))} N rms, {signed(mean)} N on average"
    fig = two_records((name_a, a.time, a["thrust"]), (name_b, b.time, b["thrust"]), title, "thrust", "N")
    largest = float(np.max(np.abs(smoothed(between, SPAN)["thrust"])))
    page.figure(fig, f"Smoothed over 0.1 s the difference is {number(largest)} N at most.")


def _add_timing(page: Page, found: Timing, granted: str) -> None:
    """Lateness and work of the ticks; `granted`: real-time rights of the loop."""
    late, busy = ([f"{1e6 * value:.0f}" for value in values] for values in (found.late, found.busy))
    columns = ("us", *(f"{p:g} %" if p < 100.0 else "most" for p in PERCENTILES))
    caption = (
        f"How late the {found.ticks} ticks began, and how long each worked: percentiles. {found.missed} slots were missed."
    )
    page.table(columns, [("late", *late), ("work", *busy)], f"{caption} The loop had: {granted}.")


def _add_counts(page: Page, content: Mapping, begin: float = 0.0) -> None:
    """Recovered device errors, and the states of the rig; `content`: hil.json, `begin`: time [s] of the profile's first row."""
    states = [(round(one["time"] - begin, 9), one["state"], one["why"]) for one in content["transitions"]]
    since = "; times count from the begin of the profile" if begin else ""
    page.table(("at [s]", "state", "why"), states, f"States of the rig{since}.")
    log = content["log"]
    rows = [("log", "rows", log["rows"]), ("log", "ticks lost", log["lost"])]
    rows += [("load cell", "zero at the last tare [counts]", tare["zero_counts"]) for tare in content["tares"][-1:]]
    rows += [(device, name, count) for device, counts in content["counters"].items() for name, count in counts.items()]
    page.table(("device", "what", "times"), rows, "What the devices counted.")


def add_twin(page: Page, log: Record, twin: Mapping, begin: float = 0.0) -> None:
    """Residual and parameters of the twin, if the log has them; `begin`: time [s] of the profile's first row by its alarms."""
    units = {name: unit for name, unit in twin["units"].items() if LEARNED + name in log}
    if not units or not np.isfinite(log[LEARNED + "band"]).any():
        return
    rows = log.part(np.isfinite(log[LEARNED + "band"]))
    outputs = {name: rows[LEARNED + name] for name in units}
    causes = "".join(f" At {one['time'] - begin:.1f} s: {one['cause']}." for one in twin["alarms"])
    caption = f"What the twin made of its parameters. At most {twin['false_alarms_per_hour']:g} false alarms an hour.{causes}"
    add_adaptive(page, rows.time, outputs, units, "the twin's", caption)


def _summary(content: dict) -> str:
    hidden = f" with {', '.join(content['hidden'])} hidden in it" if content.get("hidden") else ""
    profile, calibration = (
        content.get("profile", {}).get("file", "a profile"),
        content.get("calibration", {}).get("sha256", "not known"),
    )
    made = "" if "made_from" not in content else ". Its loop was gone at the end: this was made from its log"
    return (
        f"The {content.get('rig', '')} rig{hidden}, {content.get('time', 'not known')} time, over {profile}. "
        f"Calibration {calibration[:12]}. Begun {content.get('begun', 'at a time not known')}{made}"
    )


def _tiles(page: Page, run: Outcome) -> None:
    """Key figures of the control, then of the timing and the devices."""
    content, found = run.content, run.timing
    for name, steps in run.steps.items():
        page.tiles(step_tiles(steps, f", {name}"))
    if "energy" in content:
        page.tiles([("energy from the supply", *energy_words(content["energy"]))])
    if "beside" in content:
        page.tiles([("rig against plant FMU", f"{number(content['beside']['rms_thrust'])} N", "rms of the thrust difference")])
    if found:
        page.tiles([("late, p99.9", f"{1e6 * found.late[2]:.0f} us", f"{found.missed} slots missed")])
    if content["tares"]:
        page.tiles([("noise of a reading", f"{number(content['tares'][-1]['noise_N'])} N", "at rest, of the last tare")])
    log, counters = content["log"], content["counters"]
    healed = sum(n for device in counters.values() for name, n in device.items() if name != "pulses")
    if log["lost"] or healed:
        page.tiles([("not as planned", f"{log['lost'] + healed}", f"{log['lost']} ticks lost, {healed} transfers repeated")])


def campaign_page(content: Mapping, summary: str, records: Mapping[str, Record]) -> Page:
    """The page of a measured campaign; `content`: hil.json, `records`: its parts over time by name."""
    hidden = f" with {', '.join(content['hidden'])} hidden in it" if content.get("hidden") else ""
    page = Page("Campaign", summary, f"The {content['rig']} rig{hidden}. Begun {content['begun']}.")
    rows = [
        (name, part["log"]["rows"], part["log"]["lost"], part["attempts"], part["ended"] or "as planned")
        for name, part in content["parts"].items()
    ]
    page.table(("part", "rows of the log", "lost", "attempts", "ended"), rows, "The parts, each with its log.")
    for name, record in records.items():
        lines = {"omega_ref": "command", "beta_ref": "command", "thrust": "measured"}
        rows = {style.label(signal): {kind: record[signal]} for signal, kind in lines.items()}
        page.figure(stacked(record.time, rows, f"Commands and thrust of {name}"))
    return page


def calibration_page(before: Calibration, found: Calibration, measured: Measured) -> Page:
    """A calibration that was measured, beside the one before it."""
    cell, pitch, throttle = measured.cell, measured.pitch, measured.throttle
    hashes = f"Sha256 {found.sha256[:12]}; it was {before.sha256[:12]}."
    page = Page("Calibration", f"{hashes} What was not measured stays as it was.")
    rows = []
    if cell:
        change = 100.0 * (cell.newton_per_count / before.newton_per_count - 1.0)
        page.tiles([("force per count", f"{1e3 * cell.newton_per_count:.5g} mN", f"± {1e3 * cell.std:.2g} mN")])
        page.tiles([("residuals", f"{number(max(map(abs, cell.residuals)))} N", f"hysteresis {number(cell.hysteresis)} N")])
        rows += [("force per count [mN]", 1e3 * before.newton_per_count, 1e3 * cell.newton_per_count, f"{change:+.2f} %")]
        rows += [("zero [counts]", before.zero, cell.zero, f"{cell.zero - before.zero:+.1f}")]
        top, off = int(np.argmax(np.abs(cell.forces))), 1e3 * np.array(cell.residuals)
        title = f"The load cell is straight within {number(max(map(abs, cell.residuals)))} N"
        fig = figure(title, 230, "force of the weights, thrust positive [N]", "line − weight [mN]")
        fig.line(cell.forces[: top + 1], off[: top + 1], "rising", style.AFTER, size=6)
        fig.line(cell.forces[top:], off[top:], "falling", style.BEFORE, size=6)
        page.figure(fig, "What the straight line says above what hung there. Rising and falling apart: friction.")
    if pitch:
        page.tiles([("play of the pitch", f"{pitch.play:.2f} deg", "at most, from one side against the other")])
        title = f"The pitch goes from {min(pitch.pitches):g} to {max(pitch.pitches):g} deg, with {pitch.play:.2f} deg of play"
        fig, pulses = figure(title, 230, "pulse [us]", "blade pitch [deg]"), [1e6 * pulse for pulse in pitch.pulses]
        fig.line(pulses, pitch.up, "rising pulses", style.AFTER, size=6)
        fig.line(pulses, pitch.down, "falling pulses", style.BEFORE, size=6)
        page.figure(fig, "As read off at 75 % of the radius. The table takes the mean of both, the middle of the play.")
    if throttle:
        page.tiles([("the motor starts at", f"{1e6 * throttle[0]:g} us", f"idle pulse {1e6 * found.esc_idle:g} us")])
        change = 1e6 * (found.esc_idle - before.esc_idle)
        rows += [("idle pulse [us]", 1e6 * before.esc_idle, 1e6 * found.esc_idle, f"{change:+.1f}")]
    if rows:
        page.table(("what", "before", "now", "change"), rows, "What the calibration said before, and what it says now.")
    sources = found.source.items()
    known = [(name, entry["who"], entry["when"]) for name, entry in sources if isinstance(entry, dict) and "who" in entry]
    page.table(("section", "who", "when"), known, "Who measured what.")
    return page
