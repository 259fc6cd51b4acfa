"""Figure of step responses: a small panel per step, as in the paper."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.report import style
from vpp_fmu.report.thinning import places, to_the_eye

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
        _add_run(fig, panels[run.direction, run.start, run.end], run, name, shades[run.level], delayed, named, after)
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


def _add_run(fig, panel, run, name, colour, delayed, named, after) -> None:
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
