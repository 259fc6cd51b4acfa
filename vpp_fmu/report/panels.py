"""Panels over one common time axis: zoom and hover act on all of them."""

from collections.abc import Sequence

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.report import style
from vpp_fmu.report.thinning import thinned

_GAP = 22
"""Pixels between two panels."""


def panels(title: str, labels: Sequence[str], heights: Sequence[int]) -> go.Figure:
    """A figure of panels from top to bottom with these axis labels and heights [px], over one axis in seconds."""
    total = sum(heights) + _GAP * (len(heights) - 1)
    fig = style.figure(title, total + 130)
    top = total
    for k, (label, height) in enumerate(zip(labels, heights, strict=True)):
        domain = [(top - height) / total, top / total]
        fig.update_layout({_axis("yaxis", k): {"domain": domain, "title": {"text": label}, "anchor": "x"}})
        top -= height + _GAP
    last = _axis("y", len(labels) - 1)
    fig.update_layout(
        xaxis={"title": {"text": style.label("time")}, "anchor": last, "hoverformat": ".3f"},
        hovermode="x unified",
        hoversubplots="axis",
    )
    return fig


def add_line(fig: go.Figure, panel: int, time: np.ndarray, values: np.ndarray, name: str, line: dict, legend: bool = True):
    """A line in the given panel (from 0), thinned if long. Lines of one name go on and off together."""
    x, y = thinned(np.asarray(time, float), np.asarray(values, float))
    fig.add_scatter(
        x=x,
        y=y,
        mode="lines",
        name=style.escaped(name),
        legendgroup=name,
        showlegend=legend,
        line=line,
        yaxis=_axis("y", panel),
    )


def add_band(fig: go.Figure, panel: int, half_width: float, name: str):
    """A band around zero behind the lines of a panel."""
    axis = _axis("y", panel)
    fig.add_shape(
        type="rect",
        layer="below",
        xref="x domain",
        yref=axis,
        x0=0,
        x1=1,
        y0=-half_width,
        y1=half_width,
        fillcolor=style.NOISE,
        line_width=0,
        name=style.escaped(name),
        showlegend=True,
    )


def _axis(kind: str, panel: int) -> str:
    """Plotly's name of an axis: the first bears no number."""
    return kind if panel == 0 else f"{kind}{panel + 1}"
