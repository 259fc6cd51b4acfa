"""Figures of parameters: change, convergence, intervals, learned curves."""

from collections.abc import Mapping, Sequence

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import add_envelope, add_line, add_points, figure, panels
from vpp_fmu.app.report.sentences import words
from vpp_fmu.digits import interval, number

MOST = 300.0
"""Half-widths beyond this, in %, are drawn at the edge: the parameter is unknown."""

BINS = 60

_NAMES = {"type": "category", "autorange": "reversed"}
"""Axis of parameters, the first on top."""


def parameter_change(
    names: Sequence[str], start: np.ndarray, final: np.ndarray, low: np.ndarray, high: np.ndarray, title: str
) -> go.Figure:
    """Parameters before and after the fit with the 95 % interval low to high, as change in % of the start; arrays (n,).

    The labels hold the values. A parameter that starts from 0 has no relative change and is shown in its label only; nan: an
    unknown bound.
    """
    start, final, low, high = (np.asarray(values, float) for values in (start, final, low, high))
    scale = np.where(start == 0.0, np.nan, np.abs(start)) / 100.0
    change = (final - start) / scale
    rows = [_row(*values) for values in zip(names, start, final, low, high, strict=True)]
    fig = figure(title, 130 + 44 * len(rows), "change from the start [%]")
    add_points(fig, np.where(np.isnan(scale), np.nan, 0.0), rows, "start", style.BEFORE, 16, "line-ns-open")
    bar = {"array": (high - final) / scale, "arrayminus": (final - low) / scale}
    hover = f"%{{x:+{style.SHOWN}}} %<extra></extra>"
    add_points(fig, change, rows, "fitted, 95 % interval", style.AFTER, 9, error_x=bar, hovertemplate=hover)
    fig.update_xaxes(range=_reach(change, (high - low) / scale))
    fig.update_yaxes(**_NAMES)
    return fig


def learning_curve(evaluations: np.ndarray, cost: np.ndarray, title: str, quantity: str = "cost [-]") -> go.Figure:
    """The cost at each of n evaluations, both (n,), and the lowest so far; cost on a logarithmic axis."""
    fig = figure(title, 340, "evaluations [-]", quantity)
    add_points(fig, evaluations, cost, "evaluation", style.SET_POINT, 5)
    best = np.fmin.accumulate(np.asarray(cost, float))
    add_line(fig, evaluations, best, "best so far", style.AFTER, 2, shape="hv")
    fig.update_yaxes(type="log", hoverformat=".4~g")
    return fig


def _named(name: str) -> str:
    return style.escaped(words(name))


def _row(name: str, start: float, final: float, low: float, high: float) -> str:
    """The label of a parameter: its values, and its interval below."""
    ends = interval(low, high) if np.isfinite(high - low) else "interval unknown"
    return f"<b>{_named(name)}</b>  {number(start)} → {number(final)}<br>{ends}"


def _reach(change: np.ndarray, widths: np.ndarray) -> list[float]:
    """The range [%] that shows every change and the typical interval, so that one unidentifiable parameter does not set it."""
    known = np.isfinite(change)
    if not known.any():
        return [-1.0, 1.0]
    typical = float(np.median(widths[np.isfinite(widths)])) if np.isfinite(widths).any() else 0.0
    margin = typical + 0.1 * float(np.max(np.abs(change[known]))) + 0.5
    return [min(0.0, float(change[known].min())) - margin, max(0.0, float(change[known].max())) + margin]


def interval_widths(names: Sequence[str], widths: Mapping[str, np.ndarray], title: str) -> go.Figure:
    """Half-widths of 95 % intervals of n parameters in % of their size, each (n,), by data set; the last is best.

    A line per parameter joins the widest with the last.
    """
    labels = [_named(name) for name in names]
    shown = {name: np.minimum(np.asarray(values, float), MOST) for name, values in widths.items()}
    fig = figure(title, 130 + 34 * len(labels), "half-width of the 95 % interval [% of the value]")
    last, widest = list(shown.values())[-1], np.max(list(shown.values()), axis=0)
    for label, low, high in zip(labels, last, widest, strict=True):
        add_line(fig, [low, high], [label, label], "", style.FAINT, 3, showlegend=False, hoverinfo="skip")
    colours = style.colours(shown)
    for name, values in shown.items():
        text = [f"± {width:.3g} %" if width <= MOST else "unknown" for width in np.asarray(widths[name], float)]
        colour = style.SET_POINT if "paper" in name else colours[name]
        add_points(fig, values, labels, name, colour, 10, text=text, hovertemplate="%{y}: %{text}<extra></extra>")
    fig.update_xaxes(type="log")
    fig.update_yaxes(**_NAMES)
    return fig


def learned_curve(
    at: np.ndarray,
    value: np.ndarray,
    half: np.ndarray,
    lines: Mapping[str, tuple[np.ndarray, np.ndarray]],
    data: np.ndarray,
    title: str,
    driver: tuple[str, str],
    term: tuple[str, str],
) -> go.Figure:
    """A curve `value` (knots,) +- `half` over `at`, further `lines` (x, y) by name, and a histogram of the `data` (n,) below.

    `driver`, `term`: (words, unit) of the axes.
    """
    labels = [f"{term[0]} [{'-' if term[1] == '1' else term[1]}]", "share of time [%]"]
    fig = panels(title, labels, [320, 110])
    add_envelope(fig, at, value - half, value + half, "95 %", style.VEIL)
    colours = style.colours(lines)
    for name, (x, y) in lines.items():
        add_line(fig, x, y, name, colours[name], mode="lines+markers" if len(x) == len(at) else "lines")
    count, edges = np.histogram(data, BINS)
    share = 100.0 * count / max(count.sum(), 1)
    add_line(fig, edges, np.append(share, 0.0), "data", style.MEASURED, panel=1, group="data", shape="hv")
    fig.update_xaxes(title_text=f"{driver[0]} [{driver[1]}]", hoverformat=".4~g")
    return fig
