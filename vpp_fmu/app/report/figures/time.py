"""Figures over time: measurement and prediction, closed loop, two records, planned commands, step responses."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from plotly import graph_objects as go

from identification.fit.uncertainty import NORMAL_95
from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import add_band, add_envelope, add_line, axis, figure, panels, places, to_the_eye
from vpp_fmu.digits import number
from vpp_fmu.record import QUANTITIES, Record

COMMANDS = {"omega_ref": "omega", "beta_ref": "beta"}
"""Commands, and their measured quantities."""

Columns = Record | Mapping[str, np.ndarray]
"""Arrays (n,) by column name."""


_HELD = "hv"
"""Line shape of commands, which are held until the next one."""

_LOOP = ("thrust_set", "thrust", "omega_ref", "omega", "beta_ref", "beta")

_COLUMNS = 5
_PANEL, _GAP, _HEADING = 150, 52, 22
"""Heights in pixels, for step responses: a panel, the gap between two rows, and the headings above the first."""

_RANKS = {"fitted": 2, "left out": 3}
"""Order in the legend, after the measured ones."""

_SETTLED, _ROOM = 0.02, 1.5
"""Share of a step within which a fit counts as settled, and the drawn time as a multiple of that settling time."""

_BEFORE = 0.13
"""Share of the time after the step that is drawn before it."""

_POINTS = 240
"""Points per line: the width of a panel in pixels."""


def measured_against_predicted(
    record: Columns,
    predictions: Mapping[str, np.ndarray],
    title: str,
    noise: float | None = None,
    band: np.ndarray | None = None,
    reading: str = "thrust",
) -> go.Figure:
    """Measured and predicted thrust [N], their difference with a band of +-2 `noise`, and a record's commands with
    their measured quantities, over time [s].

    Predictions are (n,) by name; `noise`: standard deviation [N] of a reading. `band`: standard deviation (n,) of a reading
    about the first prediction; 1.96 of it are drawn around the prediction and in the residual. `reading`: a column in place of
    thrust, in its own unit.
    """
    unit = QUANTITIES[reading].unit
    labels = [style.label(reading), f"residual [{unit}]", *map(style.label, COMMANDS.values())]
    fig = panels(title, labels, [260, 160, 110, 110])
    time = np.asarray(record["time"])
    measured = np.asarray(record[reading] if reading in record else np.full(len(time), np.nan), float)
    residuals = {name: measured - values for name, values in predictions.items()}
    beside = [record[name] for both in COMMANDS.items() for name in both if name in record]
    kept = places([measured, *predictions.values(), *residuals.values(), *beside])
    time = time[kept]
    if band is not None:
        reach, middle = NORMAL_95 * np.asarray(band)[kept], np.asarray(next(iter(predictions.values())))[kept]
        for panel, centre in ((0, middle), (1, 0.0 * middle)):
            add_envelope(fig, time, centre - reach, centre + reach, "95 % of readings expected", style.BAND, panel)
    add_line(fig, time, measured[kept], "measured", style.MEASURED, 1, 0)
    if noise is not None:
        add_band(fig, 1, 2 * noise, f"± 2 noise ({number(2 * noise)} {unit})")
    colours = style.colours(predictions)
    for name, residual in residuals.items():
        seen = residual[np.isfinite(residual)]
        error = f"rmse {number(np.sqrt(np.mean(seen**2)))} {unit}" if len(seen) else "nothing measured beside it"
        add_line(fig, time, np.asarray(predictions[name])[kept], f"{name}, {error}", colours[name], 1.6, 0)
        add_line(fig, time, residual[kept], f"{name}, residual", colours[name], 1, 1, f"{name}, {error}")
    for panel, (name, output) in enumerate(COMMANDS.items(), start=2):
        if output in record:
            add_line(fig, time, np.asarray(record[output])[kept], output, style.MEASURED, 1, panel, "measured")
        group = None if panel == 2 else "commands"
        add_line(
            fig, time, np.asarray(record[name])[kept], "commands", style.SET_POINT, 1.4, panel, group, shape=_HELD, dash="dash"
        )
    return fig


def closed_loop(runs: Mapping[str, Columns], title: str, limits: Mapping[str, tuple[float, float]] | None = None) -> go.Figure:
    """Thrust with its set-point [N], speed [rpm] and pitch [deg] of each run over time [s]; commands dotted. `limits`: (least,
    greatest) of each command by its name, drawn if known.

    A run holds arrays (n,) by column name: time, thrust_set, thrust, omega_ref, omega, beta_ref, beta. Unmeasured ones may
    be missing. The set-point is drawn once if all runs share it.
    """
    fig = panels(title, [style.label(name) for name in ("thrust", "omega", "beta")], [260, 150, 150])
    colours = style.colours(runs)
    drawn = []
    for name, run in runs.items():
        kept = places([run[column] for column in _LOOP if column in run])
        columns = {column: np.asarray(run[column])[kept] for column in ("time", *_LOOP) if column in run}
        if not any(all(np.array_equal(run[column], other[column]) for column in ("time", "thrust_set")) for other in drawn):
            group = "set-point" if drawn else None
            held = {"dash": "dash", "shape": _HELD}
            add_line(fig, columns["time"], columns["thrust_set"], "set-point", style.SET_POINT, 1.8, 0, group, **held)
            drawn.append(run)
        _add_run(fig, name, columns, colours[name])
    first = next(iter(runs.values()))["time"]
    ends = np.array([first[0], first[-1]], float)
    for panel, column in ((1, "omega_ref"), (2, "beta_ref")):
        for k, end in enumerate(dict.fromkeys((limits or {}).get(column, ()))):
            group = None if panel == 1 and k == 0 else "limits"
            add_line(fig, ends, np.full(2, end), "limits", style.SET_POINT, 1, panel, group, dash="dashdot")
    return fig


def _add_run(fig: go.Figure, name: str, run: Mapping[str, np.ndarray], colour: str) -> None:
    """The lines of one run in the panels thrust, speed, pitch."""
    dotted = {"dash": "dot", "shape": _HELD}
    time, commands = run["time"], f"{name}, commands"
    add_line(fig, time, run["thrust"], name, colour, 1.5, 0)
    add_line(fig, time, run["omega_ref"], commands, colour, 1.2, 1, **dotted)
    add_line(fig, time, run["beta_ref"], f"{name}, pitch command", colour, 1.2, 2, commands, **dotted)
    for panel, column, word in ((1, "omega", "speed"), (2, "beta", "pitch")):
        if column in run:
            add_line(fig, time, run[column], f"{name}, {word}", colour, 1.5, panel, name)


def two_records(
    first: tuple[str, np.ndarray, np.ndarray],
    second: tuple[str, np.ndarray, np.ndarray],
    title: str,
    quantity: str,
    unit: str,
) -> go.Figure:
    """Two records (name, time [s], values), values in `unit`, all (n,), and their difference.

    The difference, second less first, is at the common times of the first; the second is interpolated linearly.
    """
    fig = panels(title, [f"{quantity} [{unit}]", f"difference [{unit}]"], [260, 160])
    (name_a, *a), (name_b, *b) = first, second
    (time_a, a), (time_b, b) = ([np.asarray(values, float) for values in each] for each in (a, b))
    colours = style.colours((name_a, name_b))
    common = (time_a >= time_b[0]) & (time_a <= time_b[-1])
    difference = np.where(common, np.interp(time_a, time_b, b) - a, np.nan)
    kept_a, kept_b = places([a, difference]), places([b])
    if np.array_equal(time_a, time_b):
        kept_a = kept_b = places([a, b, difference])
    # Equal records hide each other, so the first is a wide line under the second.
    add_line(fig, time_a[kept_a], a[kept_a], name_a, colours[name_a], 2.6, 0)
    add_line(fig, time_b[kept_b], b[kept_b], name_b, colours[name_b], 1, 0)
    add_line(fig, time_a[kept_a], difference[kept_a], f"{name_b} − {name_a}", style.MEASURED, 1, 1)
    return fig


def stacked(time: np.ndarray, rows: Mapping[str, Mapping[str, np.ndarray]], title: str) -> go.Figure:
    """A panel for each of the `rows`, named by its axis label with unit: lines (n,) by name over the time [s].

    Lines with "command" in their name are held and dotted, "measured" ones thin; one name has one colour in all panels.
    """
    fig = panels(title, list(rows), [180] * len(rows))
    names = dict.fromkeys(name for lines in rows.values() for name in lines)
    colours, shown = style.colours(n for n in names if "command" not in n), set()
    for panel, lines in enumerate(rows.values()):
        for name, values in lines.items():
            colour, width = colours.get(name, style.SET_POINT), 1.0 if name == "measured" else 1.8
            held = {"dash": "dot", "shape": _HELD} if "command" in name else {}
            add_line(fig, time, values, name, colour, width, panel, name if name in shown else None, **held)
            shown.add(name)
    return fig


def planned_commands(
    time: np.ndarray, omega_ref: np.ndarray, beta_ref: np.ndarray, thrust: np.ndarray, title: str
) -> go.Figure:
    """Commands [rpm], [deg], held from row to row, and the thrust [N] that the model predicts, over time [s]; each (n,)."""
    fig = panels(title, [*map(style.label, COMMANDS), "predicted thrust [N]"], [180, 180, 180])
    kept = places([omega_ref, beta_ref, thrust])
    add_line(fig, time[kept], omega_ref[kept], "commands", style.SET_POINT, 1.3, 0, shape=_HELD)
    add_line(fig, time[kept], beta_ref[kept], "pitch command", style.SET_POINT, 1.3, 1, "commands", shape=_HELD)
    add_line(fig, time[kept], thrust[kept], "thrust", style.AFTER, 1.3, 2)
    return fig


class Run(Protocol):
    """A run: `time` (rows,) s from the step, commands, and the reason if it is excluded."""

    time: np.ndarray
    start: float
    end: float
    level: float
    direction: str
    reason: str

    def normalised(self, delayed: bool) -> tuple[np.ndarray, np.ndarray]:
        """(measured, fitted), each (rows,): thrust as a share of the step."""


def step_responses(
    runs: Sequence[Run], title: str, unit: str = "rpm", level_unit: str = "deg", delayed: bool = False
) -> go.Figure:
    """Normalised thrust over the time from the step, of the runs (at least one) of one channel, as in the paper; black: fitted.

    Rows of panels: up, then down; columns: steps by size, commands in `unit` above; a colour per level of the other command,
    in `level_unit`. Excluded runs are grey and without a fit; pointing at them shows the reason.
    """
    cells = _cells(runs)
    rows, columns = (1 + max(cell[side] for cell in cells.values()) for side in (0, 1))
    plot = rows * (_PANEL + _GAP) - _GAP
    margin = figure(title, plot).layout.margin
    fig = figure(title, plot + margin.t + _HEADING + margin.b)
    fig.update_layout(hovermode="closest", margin_t=margin.t + _HEADING)
    own = {step: row * columns + column for step, (row, column) in cells.items()}
    after = _after(runs, delayed)
    for step, (row, column) in cells.items():
        _add_axes(fig, own[step], row, column, columns, _PANEL / plot, (_PANEL + _GAP) / plot, step, unit, after)
        if column == 0:
            fig.layout[axis("yaxis", own[step])].title = {"text": "thrust [share of step]", "font": {"size": 12}}
        if own[step] + columns not in own.values():
            fig.layout[axis("xaxis", own[step])].title = {"text": "time [s]", "font": {"size": 12}, "standoff": 2}
    levels = sorted({run.level for run in runs})
    shades = {level: style.OTHERS[k % len(style.OTHERS)] for k, level in enumerate(levels)}
    named: set[str] = set()
    for run in sorted(runs, key=lambda run: not run.reason):  # the excluded runs first, under the others
        name = "left out" if run.reason else f"measured at {run.level:g} {level_unit}"
        _add_step(fig, own[run.direction, run.start, run.end], run, name, shades[run.level], delayed, named, after)
    return fig


def _after(runs: Sequence[Run], delayed: bool) -> float:
    """Drawn time [s] from the step: until the slowest included run has settled, and some more."""
    longest = max(float(run.time[-1]) for run in runs)
    times = [0.0]
    for run in runs:
        if not run.reason:
            away = np.abs(run.normalised(delayed)[1] - 1.0) > _SETTLED
            times.append(float(run.time[away].max(initial=0.0)))
    return min(_ROOM * max(times), longest) or longest


def _cells(runs: Sequence[Run]) -> dict[tuple[str, float, float], tuple[int, int]]:
    """Row and column of each step (direction, start, end): by direction, then by size, a new row after _COLUMNS."""
    found, row = {}, 0
    for direction in ("up", "down"):
        steps = {(run.direction, run.start, run.end) for run in runs if run.direction == direction}
        for k, step in enumerate(sorted(steps, key=lambda s: (abs(s[2] - s[1]), s[1]))):
            found[step] = row + k // _COLUMNS, k % _COLUMNS
        row += -(-len(steps) // _COLUMNS)
    return found


def _add_axes(fig, panel, row, column, columns, tall, pitch, step, unit, after) -> None:
    """The axes of a panel and its heading; `tall` and `pitch` are shares of the plot's height."""
    width, top = 1.0 / columns, 1.0 - row * pitch
    x, y, left = axis("x", panel), axis("y", panel), column * width
    small = {"tickfont": {"size": 11}}
    across = {"domain": [left + 0.012, left + width - 0.012], "anchor": y, "range": [-_BEFORE * after, after]}
    down = {"domain": [max(0.0, top - tall), top], "anchor": x, "range": [-0.45, 1.55], "showticklabels": column == 0}
    fig.update_layout({axis("xaxis", panel): across | small, axis("yaxis", panel): down | small})
    fig.add_annotation(
        text=f"{step[1]:g} → {step[2]:g} {unit}",
        font={"size": 12},
        showarrow=False,
        x=0.5,
        y=1.0,
        xref=f"{x} domain",
        yref=f"{y} domain",
        xanchor="center",
        yanchor="bottom",
    )


def _add_step(fig, panel, run, name, colour, delayed, named, after) -> None:
    """The lines of one run until `after` s; `named`: names that are in the legend already."""
    measured, fitted = run.normalised(delayed)
    near = np.flatnonzero((run.time >= -_BEFORE * after) & (run.time <= after) & np.isfinite(measured))
    kept = near[places([measured[near]], most=_POINTS)]
    lines = [(name, measured, style.FAINT if run.reason else colour, 1, 0.75)]
    if not run.reason:
        lines.append(("fitted", fitted, style.FIT, 1.6, 1.0))
    for label, values, shade, width, opacity in lines:
        own = {"legendgroup": label, "showlegend": label not in named, "legendrank": _RANKS.get(label, 1), "opacity": opacity}
        own |= {"xaxis": axis("x", panel), "yaxis": axis("y", panel)}
        hover = f"%{{y:.2f}} at %{{x:.3f}} s<br>{style.escaped(run.reason or label)}<extra></extra>"
        add_line(fig, to_the_eye(run.time[kept]), to_the_eye(values[kept]), label, shade, width, hovertemplate=hover, **own)
        named.add(label)
