"""Figures of a fit: change and correlation of the parameters, convergence."""

from collections.abc import Sequence

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.digits import interval, number
from vpp_fmu.report import style


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
    fig = style.figure(title, 130 + 44 * len(rows))
    marker = {"symbol": "line-ns-open", "size": 16, "color": style.BEFORE, "line": {"width": 3}}
    fig.add_scatter(x=np.where(np.isnan(scale), np.nan, 0.0), y=rows, mode="markers", name="start", marker=marker)
    fig.add_scatter(
        x=change,
        y=rows,
        mode="markers",
        name="fitted, 95 % interval",
        marker={"size": 9, "color": style.AFTER},
        error_x={
            "array": (high - final) / scale,
            "arrayminus": (final - low) / scale,
            "color": style.AFTER,
            "thickness": 1.6,
            "width": 4,
        },
        hovertemplate=f"%{{x:+{style.SHOWN}}} %<extra></extra>",
    )
    fig.update_xaxes(title_text="change from the start [%]", range=_reach(change, (high - low) / scale))
    fig.update_yaxes(title_text="parameter [-]", type="category", autorange="reversed", tickfont_size=12)
    return fig


def correlation_heatmap(names: Sequence[str], matrix: np.ndarray, title: str) -> go.Figure:
    """The correlation matrix (n, n) of n parameters with its values; the diagonal is blank."""
    labels = [style.escaped(name) for name in names]
    fig = style.figure(title, 170 + max(28 * len(labels), 200), legend=False)
    fig.add_heatmap(
        x=labels,
        y=labels,
        z=np.where(np.eye(len(labels)), np.nan, matrix),
        zmin=-1,
        zmax=1,
        colorscale=style.DIVERGING,
        colorbar={"title": {"text": "correlation [-]"}},
        texttemplate="%{z:.2f}",
        textfont={"size": 11},
        xgap=1,
        ygap=1,
        hovertemplate="%{y}, %{x}: %{z:.3f}<extra></extra>",
    )
    fig.update_xaxes(title_text="parameter [-]", type="category", showgrid=False)
    fig.update_yaxes(title_text="parameter [-]", type="category", showgrid=False, autorange="reversed")
    return fig


def learning_curve(evaluations: np.ndarray, cost: np.ndarray, title: str, quantity: str = "cost [-]") -> go.Figure:
    """The cost at each of n evaluations, both (n,), and the lowest so far; cost on a logarithmic axis."""
    fig = style.figure(title, 340)
    fig.add_scatter(x=evaluations, y=cost, mode="markers", name="evaluation", marker={"size": 5, "color": style.SET_POINT})
    best = np.fmin.accumulate(np.asarray(cost, float))
    fig.add_scatter(
        x=evaluations, y=best, mode="lines", name="best so far", line={"color": style.AFTER, "width": 2, "shape": "hv"}
    )
    fig.update_xaxes(title_text="evaluations [-]", dtick=1 if len(cost) <= 20 else None)  # whole evaluations only
    fig.update_yaxes(title_text=quantity, type="log", dtick=_ticks(cost), tickformat=".0e", hoverformat=".4~g")
    return fig


def _row(name: str, start: float, final: float, low: float, high: float) -> str:
    """The label of a parameter: its values, and its interval below."""
    ends = interval(low, high) if np.isfinite(high - low) else "interval unknown"
    return f"<b>{style.escaped(name)}</b>  {number(start)} → {number(final)}<br>{ends}"


def _ticks(cost: np.ndarray) -> str | int:
    """Labels on a logarithmic axis: every digit within two thirds of a decade, 1 2 5 up to three decades, else powers."""
    decades = np.log10(np.max(cost) / np.min(cost))
    return "D1" if decades < 0.7 else "D2" if decades < 3.0 else 1


def _reach(change: np.ndarray, widths: np.ndarray) -> list[float]:
    """The range [%] that shows every change and the typical interval, so that one unidentifiable parameter does not set it."""
    known = np.isfinite(change)
    if not known.any():
        return [-1.0, 1.0]
    typical = float(np.median(widths[np.isfinite(widths)])) if np.isfinite(widths).any() else 0.0
    margin = typical + 0.1 * float(np.max(np.abs(change[known]))) + 0.5
    return [min(0.0, float(change[known].min())) - margin, max(0.0, float(change[known].max())) + margin]
