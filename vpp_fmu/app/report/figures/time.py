"""Figures over time: measurement and prediction, two records, planned commands, step responses."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import add_band, add_envelope, add_line, panels, places, to_the_eye
from vpp_fmu.digits import number

_NORMAL_95 = 1.959963984540054

_HELD = "hv"
"""Line shape of commands, which are held until the next one."""

_LOOP = ("thrust_set", "thrust", "omega_ref", "omega", "beta_ref", "beta")


def measured_against_predicted(
    time: np.ndarray,
    measured: np.ndarray,
    predictions: Mapping[str, np.ndarray],
    title: str,
    quantity: str = "thrust",
    unit: str = "N",
    commands: Mapping[str, np.ndarray] | None = None,
    noise: float | None = None,
    band: np.ndarray | None = None,
) -> go.Figure:
    """Measured and predicted values, their difference with a band of +-2 `noise`, and a panel per command; over time [s].

    All arrays are (n,), values and `noise` (standard deviation) in `unit`. Commands are by column name. `band`: standard
    deviation of a reading about the first prediction; 1.96 of it are drawn around the prediction and in the residual.
    """
    commands = commands or {}
    labels = [f"{quantity} [{unit}]", f"residual [{unit}]", *map(style.label, commands)]
    fig = panels(title, labels, [260, 160] + [110] * len(commands))
    measured = np.asarray(measured, float)
    residuals = {name: measured - values for name, values in predictions.items()}
    kept = places([measured, *predictions.values(), *residuals.values(), *commands.values()])
    time = np.asarray(time)[kept]
    if band is not None:
        reach, middle = _NORMAL_95 * np.asarray(band)[kept], np.asarray(next(iter(predictions.values())))[kept]
        for panel, centre in ((0, middle), (1, 0.0 * middle)):
            add_envelope(fig, panel, time, centre - reach, centre + reach, "95 % of readings expected", style.BAND)
    add_line(fig, 0, time, measured[kept], "measured", {"color": style.MEASURED, "width": 1})
    if noise is not None:
        add_band(fig, 1, 2 * noise, f"± 2 noise ({number(2 * noise)} {unit})")
    colours = style.colours(predictions)
    for name, residual in residuals.items():
        seen = residual[np.isfinite(residual)]
        shown = (
            f"{name}, rmse {number(np.sqrt(np.mean(seen**2)))} {unit}" if len(seen) else f"{name}, nothing measured beside it"
        )
        add_line(fig, 0, time, np.asarray(predictions[name])[kept], shown, {"color": colours[name], "width": 1.6})
        add_line(fig, 1, time, residual[kept], f"{name}, residual", {"color": colours[name], "width": 1}, group=shown)
    for k, (name, values) in enumerate(commands.items(), start=2):
        line = {"color": style.SET_POINT, "width": 1.4, "shape": _HELD}
        add_line(fig, k, time, np.asarray(values)[kept], name, line, group="commands")
    return fig


def closed_loop(
    runs: Mapping[str, Mapping[str, np.ndarray]], title: str, limits: Mapping[str, tuple[float, float]] | None = None
) -> go.Figure:
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
            line = {"color": style.SET_POINT, "width": 1.8, "dash": "dash", "shape": _HELD}
            group = "set-point" if drawn else None
            add_line(fig, 0, columns["time"], columns["thrust_set"], "set-point", line, group)
            drawn.append(run)
        _add_run(fig, name, columns, colours[name])
    first = next(iter(runs.values()))["time"]
    ends = np.array([first[0], first[-1]], float)
    for panel, column in ((1, "omega_ref"), (2, "beta_ref")):
        for k, end in enumerate(dict.fromkeys((limits or {}).get(column, ()))):
            line = {"color": style.FAINT, "width": 1, "dash": "dashdot"}
            add_line(fig, panel, ends, np.full(2, end), "limits", line, None if panel == 1 and k == 0 else "limits")
    return fig


def _add_run(fig: go.Figure, name: str, run: Mapping[str, np.ndarray], colour: str) -> None:
    """The lines of one run in the panels thrust, speed, pitch."""
    solid = {"color": colour, "width": 1.5}
    dotted = {"color": colour, "width": 1.2, "dash": "dot", "shape": _HELD}
    time, commands = run["time"], f"{name}, commands"
    add_line(fig, 0, time, run["thrust"], name, solid)
    add_line(fig, 1, time, run["omega_ref"], commands, dotted)
    add_line(fig, 2, time, run["beta_ref"], f"{name}, pitch command", dotted, group=commands)
    for panel, column, word in ((1, "omega", "speed"), (2, "beta", "pitch")):
        if column in run:
            add_line(fig, panel, time, run[column], f"{name}, {word}", solid, group=name)


def two_records(
    time_a: np.ndarray,
    a: np.ndarray,
    time_b: np.ndarray,
    b: np.ndarray,
    name_a: str,
    name_b: str,
    title: str,
    quantity: str,
    unit: str,
) -> go.Figure:
    """Two records over time [s], values in `unit`, and b - a at the common times of a, with b interpolated linearly."""
    fig = panels(title, [f"{quantity} [{unit}]", f"difference [{unit}]"], [260, 160])
    time_a, a, time_b, b = (np.asarray(values, float) for values in (time_a, a, time_b, b))
    colours = style.colours((name_a, name_b))
    common = (time_a >= time_b[0]) & (time_a <= time_b[-1])
    difference = np.where(common, np.interp(time_a, time_b, b) - a, np.nan)
    kept_a, kept_b = places([a, difference]), places([b])
    if np.array_equal(time_a, time_b):
        kept_a = kept_b = places([a, b, difference])
    # Equal records hide each other, so the first is a wide line under the second.
    add_line(fig, 0, time_a[kept_a], a[kept_a], name_a, {"color": colours[name_a], "width": 2.6})
    add_line(fig, 0, time_b[kept_b], b[kept_b], name_b, {"color": colours[name_b], "width": 1})
    line = {"color": style.MEASURED, "width": 1}
    add_line(fig, 1, time_a[kept_a], difference[kept_a], f"{name_b} − {name_a}", line)
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
            line = {"color": colours.get(name, style.SET_POINT), "width": 1.0 if name == "measured" else 1.8}
            if "command" in name:
                line |= {"dash": "dot", "shape": "hv"}
            add_line(fig, panel, time, values, name, line, name if name in shown else None)
            shown.add(name)
    return fig


def planned_commands(
    time: np.ndarray, omega_ref: np.ndarray, beta_ref: np.ndarray, thrust: np.ndarray, title: str
) -> go.Figure:
    """Commands [rpm], [deg], held from row to row, and the thrust [N] that the model predicts, over time [s]; each (n,)."""
    fig = panels(title, [*map(style.label, ("omega_ref", "beta_ref")), "predicted thrust [N]"], [180, 180, 180])
    kept = places([omega_ref, beta_ref, thrust])
    for panel, (name, values) in enumerate((("commands", omega_ref), ("pitch command", beta_ref))):
        line = {"color": style.SET_POINT, "width": 1.3, "shape": "hv"}
        add_line(fig, panel, time[kept], values[kept], name, line, "commands" if panel else None)
    add_line(fig, 2, time[kept], thrust[kept], "thrust", {"color": style.AFTER, "width": 1.3})
    return fig


_COLUMNS = 5

_PANEL, _GAP, _HEADING = 150, 52, 22
"""Pixels: height of a panel, from one row to the next, and of the headings above the first."""

_RANKS = {"fitted": 2, "left out": 3}
"""Order in the legend, after the measured ones."""

_SETTLED, _ROOM = 0.02, 1.5
"""Share of a step within which a fit counts as settled, and the drawn time as a multiple of that settling time."""

_BEFORE = 0.13
"""Share of the time after the step that is drawn before it."""

_POINTS = 240
"""Points per line: the width of a panel in pixels."""


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
    """Normalised thrust over the time from the step, of the runs (at least one) of one channel; black: fitted.

    Rows of panels: up, then down; columns: steps by size, commands in `unit` above; a colour per level of the other command,
    in `level_unit`. Excluded runs are grey and without a fit; pointing at them shows the reason.
    """
    places_of = _grid(runs)
    rows = 1 + max(row for row, _ in places_of.values())
    columns = 1 + max(column for _, column in places_of.values())
    plot = rows * (_PANEL + _GAP) - _GAP
    margin = style.figure(title, plot).layout.margin
    fig = style.figure(title, plot + margin.t + _HEADING + margin.b)
    fig.update_layout(hovermode="closest", margin_t=margin.t + _HEADING)
    panels = {step: row * columns + column for step, (row, column) in places_of.items()}
    after = _after(runs, delayed)
    for step, (row, column) in places_of.items():
        _add_axes(fig, panels[step], row, column, columns, _PANEL / plot, (_PANEL + _GAP) / plot, step, unit, after)
        if column == 0:
            fig.layout[_axis("yaxis", panels[step])].title = {"text": "thrust [share of step]", "font": {"size": 12}}
        if panels[step] + columns not in panels.values():
            fig.layout[_axis("xaxis", panels[step])].title = {"text": "time [s]", "font": {"size": 12}, "standoff": 2}
    levels = sorted({run.level for run in runs})
    shades = {level: style.OTHERS[k % len(style.OTHERS)] for k, level in enumerate(levels)}
    named: set[str] = set()
    for run in sorted(runs, key=lambda run: not run.reason):  # the excluded runs first, under the others
        name = "left out" if run.reason else f"measured at {run.level:g} {level_unit}"
        _add_step(fig, panels[run.direction, run.start, run.end], run, name, shades[run.level], delayed, named, after)
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


def _grid(runs: Sequence[Run]) -> dict[tuple[str, float, float], tuple[int, int]]:
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
    x, y = _axis("xaxis", panel), _axis("yaxis", panel)
    left = column * width
    fig.update_layout(
        {
            x: {
                "domain": [left + 0.012, left + width - 0.012],
                "anchor": _axis("y", panel),
                "range": [-_BEFORE * after, after],
                "tickfont": {"size": 11},
            },
            y: {
                "domain": [max(0.0, top - tall), top],
                "anchor": _axis("x", panel),
                "range": [-0.45, 1.55],
                "showticklabels": column == 0,
                "tickfont": {"size": 11},
            },
        }
    )
    fig.add_annotation(
        text=f"{step[1]:g} → {step[2]:g} {unit}",
        font={"size": 12},
        showarrow=False,
        x=0.5,
        y=1.0,
        xref=f"{_axis('x', panel)} domain",
        yref=f"{_axis('y', panel)} domain",
        xanchor="center",
        yanchor="bottom",
    )


def _add_step(fig, panel, run, name, colour, delayed, named, after) -> None:
    """The lines of one run until `after` s; `named`: names that are in the legend already."""
    measured, fitted = run.normalised(delayed)
    near = np.flatnonzero((run.time >= -_BEFORE * after) & (run.time <= after) & np.isfinite(measured))
    kept = near[places([measured[near]], most=_POINTS)]
    lines = [(name, measured, {"color": style.FAINT if run.reason else colour, "width": 1})]
    if not run.reason:
        lines.append(("fitted", fitted, {"color": style.FIT, "width": 1.6}))
    for label, values, line in lines:
        fig.add_scatter(
            x=to_the_eye(run.time[kept]),
            y=to_the_eye(values[kept]),
            mode="lines",
            name=label,
            legendgroup=label,
            showlegend=label not in named,
            legendrank=_RANKS.get(label, 1),
            line=line,
            opacity=1.0 if label == "fitted" else 0.75,
            xaxis=_axis("x", panel),
            yaxis=_axis("y", panel),
            hovertemplate=f"%{{y:.2f}} at %{{x:.3f}} s<br>{style.escaped(run.reason or label)}<extra></extra>",
        )
        named.add(label)


def _axis(kind: str, panel: int) -> str:
    """Plotly's name of an axis: the first has no number."""
    return kind if panel == 0 else f"{kind}{panel + 1}"
