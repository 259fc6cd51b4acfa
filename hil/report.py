"""The pages of the rig: the loop, its comparison, the twin, the timing, the events; and a calibration."""

from collections.abc import Mapping, Sequence

import numpy as np
from plotly import graph_objects as go

from hil.calibrate import LoadCell, Measured, PitchTable
from hil.calibration import Calibration
from hil.timing import EDGES, Timing
from vpp_fmu.comparison import compare
from vpp_fmu.digits import number, signed
from vpp_fmu.record import Record
from vpp_fmu.report import Page, closed_loop, style, thinning, two_records
from vpp_fmu.report.panels import add_band, add_line, panels
from vpp_fmu.report.thinning import places
from vpp_fmu.response import Step, smoothed, steps

STEP_COLUMNS = ("loop", "at [s]", "from [N]", "to [N]", "within 5 % after [s]", "overshoot [%]")
BAND, SPAN = 0.05, 0.1
"""A step has settled once its thrust, as a mean over SPAN s, stays within this share of it: noise makes 2 % too narrow."""


def add_loops(page: Page, loops: Mapping[str, Record], notes: str) -> None:
    """The closed loops over one profile, by name, and their steps."""
    judged = {name: judged_steps(loop) for name, loop in loops.items()}
    first, found = next(iter(judged.items()))
    title = said(found[0], first) if found else "Thrust under a constant set-point"
    shown = {name: {column: loop[column] for column in loop.columns} for name, loop in loops.items()}
    rows = max(len(loop) for loop in loops.values())
    caption = f"Thrust with its set-point, speed and pitch with their commands. {notes} {thinning(rows)}"
    page.figure(closed_loop(shown, title), caption)
    table = [_row(name, step) for name, found in judged.items() for step in found]
    page.table(STEP_COLUMNS, table, f"Every change of the set-point, judged on the thrust's mean over {SPAN:g} s.")


def add_difference(page: Page, first: tuple[str, Record], second: tuple[str, Record]) -> float:
    """Thrust of two loops and their difference; returns its root mean square [N]."""
    (name_a, a), (name_b, b) = first, second
    both = compare(a, b)
    difference = both.second["thrust"] - both.first["thrust"]
    rms, mean = float(np.sqrt(np.mean(difference**2))), float(difference.mean())
    slow = smoothed(Record({"time": both.time, "thrust": difference}, "difference"), SPAN)["thrust"]
    title = f"{name_b} and {name_a} differ by {number(rms)} N rms, {signed(mean)} N on average"
    fig = two_records(a.time, a["thrust"], b.time, b["thrust"], name_a, name_b, title, "thrust", "N")
    largest = float(np.max(np.abs(slow)))
    page.figure(fig, f"Smoothed over 0.1 s the difference is {number(largest)} N at most. {thinning(len(a))}")
    return rms


def add_timing(page: Page, found: Timing, limits_text: str) -> None:
    """The histogram of lateness."""
    p999 = 1e6 * found.late[2]
    title = f"99.9 % of {found.ticks} ticks began within {p999:.0f} us of their time, {found.missed} slots were missed"
    page.figure(lateness(found, title), f"How late each tick began, on logarithmic axes. {limits_text}")


def lateness(found: Timing, title: str) -> go.Figure:
    """Number of ticks by lateness."""
    fig = style.figure(title, 340, legend=False)
    labels = [_edge(low) for low in EDGES[:-1]]
    last = max(k for k, count in enumerate(found.counts) if count) + 2
    fig.add_bar(x=labels[:last], y=[count or None for count in found.counts[:last]], marker_color=style.AFTER)
    fig.update_xaxes(title_text="late by at least [s]", type="category")
    fig.update_yaxes(title_text="ticks [-]", type="log", dtick=1)
    return fig


def add_twin(page: Page, time: np.ndarray, residual: np.ndarray, alarm: np.ndarray, band: float, text: str) -> None:
    """The rig's thrust less its twin's, all (rows,)."""
    alarmed = np.flatnonzero(alarm > 0.5)
    begin = (
        f"from {time[alarmed[0]]:.2f} s on the rig was not its twin"
        if len(alarmed)
        else "the rig stayed within its twin's band"
    )
    fig = panels(f"Twin: {begin}", ["residual [N]"], [240])
    add_band(fig, 0, 2 * band, f"± 2 noise ({number(2 * band)} N)")
    kept = places([residual])
    add_line(fig, 0, time[kept], residual[kept], "rig − twin", {"color": style.MEASURED, "width": 1})
    if len(alarmed):
        fig.add_vline(x=float(time[alarmed[0]]), line={"color": style.BEFORE, "width": 1.6, "dash": "dash"})
    page.figure(fig, f"{text} {thinning(len(time))}")


def add_counts(page: Page, counters: Mapping[str, Mapping[str, int]], transitions: Sequence[Sequence]) -> None:
    """Recovered device errors, and the states of the rig."""
    page.table(("at [s]", "state", "why"), transitions, "States of the rig.")
    rows = [(device, name, count) for device, counts in counters.items() for name, count in counts.items()]
    page.table(("device", "what", "times"), rows, "What the devices counted.")


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
        _add_cell(page, cell)
    if pitch:
        page.tiles([("play of the pitch", f"{pitch.play:.2f} deg", "at most, from one side against the other")])
        _add_pitch_table(page, pitch)
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


def _add_cell(page: Page, cell: LoadCell) -> None:
    """The load cell's residuals, with rising and with falling weights."""
    top = int(np.argmax(np.abs(cell.forces)))
    worst = max(map(abs, cell.residuals))
    fig = style.figure(f"The load cell is straight within {number(worst)} N", 340)
    for rows, name, colour in ((slice(0, top + 1), "rising", style.AFTER), (slice(top, None), "falling", style.BEFORE)):
        force, residual = cell.forces[rows], [1e3 * value for value in cell.residuals[rows]]
        fig.add_scatter(x=force, y=residual, mode="lines+markers", name=name, line={"color": colour})
    fig.update_xaxes(title_text="force of the weights, thrust positive [N]")
    fig.update_yaxes(title_text="line − weight [mN]")
    page.figure(fig, "What the straight line says above what hung there. Rising and falling apart: friction.")
    page.table(
        ("force [N]", "counts", "residual [N]"),
        list(zip(cell.forces, cell.counts, cell.residuals, strict=True)),
        "Means over 4 s each.",
    )


def _add_pitch_table(page: Page, found: PitchTable) -> None:
    """Pitch over the pulses, from both sides."""
    low, high = min(found.pitches), max(found.pitches)
    fig = style.figure(f"The pitch goes from {low:g} to {high:g} deg, with {found.play:.2f} deg of play", 380)
    pulses = [1e6 * pulse for pulse in found.pulses]
    for pitches, name, colour in ((found.up, "rising pulses", style.AFTER), (found.down, "falling pulses", style.BEFORE)):
        fig.add_scatter(x=pulses, y=pitches, mode="lines+markers", name=name, line={"color": colour})
    fig.update_xaxes(title_text="pulse [us]")
    fig.update_yaxes(title_text="blade pitch [deg]")
    page.figure(fig, "As read off at 75 % of the radius. The table takes the mean of both, the middle of the play.")
    rows = list(zip(pulses, found.up, found.down, found.pitches, strict=True))
    page.table(("pulse [us]", "rising [deg]", "falling [deg]", "table [deg]"), rows, "The pitch table.")


def judged_steps(run: Record) -> list[Step]:
    """Every change of the set-point, evaluated on the smoothed thrust."""
    return steps(smoothed(run, SPAN), BAND)


def said(step: Step, name: str) -> str:
    """A step in words."""
    when = "does not settle" if step.settling is None else f"settles within {number(step.settling, 3)} s"
    return f"{name}: the step from {number(step.before)} to {number(step.after)} N at {number(step.time)} s {when}"


def _row(name: str, step: Step) -> tuple:
    never = "not by the end" if step.last else "not before the next"
    settled = never if step.settling is None else step.settling
    return name, step.time, step.before, step.after, settled, f"{step.overshoot:.1f}"


def _edge(seconds: float) -> str:
    return f"{1e6 * seconds:.0f} us" if seconds < 1e-3 else f"{1e3 * seconds:.0f} ms" if seconds < 1.0 else f"{seconds:.0f} s"
