"""What all figures are drawn on: panels over a common time axis, and long records thinned."""

import math
import re
import textwrap
from collections.abc import Iterable, Sequence

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.app.report import style

_GAP = 22
"""Pixels between two panels."""


def panels(title: str, labels: Sequence[str], heights: Sequence[int]) -> go.Figure:
    """A figure of panels from top to bottom with these axis labels and heights [px], over one axis in seconds."""
    total = sum(heights) + _GAP * (len(heights) - 1)
    fig = style.figure(title, total + 130)
    top = total
    for k, (label, height) in enumerate(zip(labels, heights, strict=True)):
        domain = [(top - height) / total, top / total]
        fig.update_layout({_axis("yaxis", k): {"domain": domain, "title": {"text": _folded(label, height)}, "anchor": "x"}})
        top -= height + _GAP
    last = _axis("y", len(labels) - 1)
    fig.update_layout(
        xaxis={"title": {"text": style.label("time")}, "anchor": last, "hoverformat": ".3f"},
        hovermode="x unified",
        hoversubplots="axis",
    )
    return fig


def add_line(
    fig: go.Figure, panel: int, time: np.ndarray, values: np.ndarray, name: str, line: dict, group: str | None = None
) -> None:
    """A line in the given panel (from 0). With a `group` it has no legend entry and is shown with the line of that name."""
    fig.add_scatter(
        x=time,
        y=values,
        mode="lines",
        name=style.escaped(name),
        legendgroup=group or name,
        showlegend=group is None,
        line=line,
        yaxis=_axis("y", panel),
    )


def add_band(fig: go.Figure, panel: int, half_width: float, name: str) -> None:
    """A band around zero, drawn over the lines of a panel, or a dense residual would hide it."""
    axis = _axis("y", panel)
    fig.add_shape(
        type="rect",
        xref="x domain",
        yref=axis,
        x0=0,
        x1=1,
        y0=-half_width,
        y1=half_width,
        fillcolor=style.NOISE,
        line={"color": style.MEASURED, "width": 1, "dash": "dot"},
        name=style.escaped(name),
        showlegend=True,
    )


def add_envelope(
    fig: go.Figure, panel: int, time: np.ndarray, low: np.ndarray, high: np.ndarray, name: str, colour: str
) -> None:
    """A coloured band from `low` to `high`, both (n,), over the time [s]; only the first of a name is in the legend."""
    shown = not any(trace.name == style.escaped(name) for trace in fig.data)
    shared = {"mode": "lines", "legendgroup": name, "yaxis": _axis("y", panel), "line": {"width": 0}, "hoverinfo": "skip"}
    fig.add_scatter(x=time, y=low, showlegend=False, **shared)
    filled = {"fill": "tonexty", "fillcolor": colour, "showlegend": shown}
    fig.add_scatter(x=time, y=high, name=style.escaped(name), **filled, **shared)


def _folded(label: str, height: int) -> str:
    """The label in lines that fit along `height` pixels, at some 8 pixels per letter."""
    at_dots = re.sub(r"\.(?=[a-z])", ". ", label)  # an effect's name, and its parameter's
    return "<br>".join(line.replace(". ", ".") for line in textwrap.wrap(at_dots, height // 8))


def _axis(kind: str, panel: int) -> str:
    """Plotly's name of an axis: the first has no number."""
    return kind if panel == 0 else f"{kind}{panel + 1}"


MOST = 4000
"""Maximum points per line. On a slow machine seven SVG lines of 22 500 points take 60 to 120 ms per zoom and 40 ms per hover,
of 4000 points 30 and 18 ms, at a fifth of the bytes. WebGL lines need eval, which the page forbids, and plotly takes three
WebGL contexts per figure where a browser allows some 16 per page."""


def places(lines: Iterable[np.ndarray], most: int = MOST) -> np.ndarray:
    """Indices (k,) of at most `most` samples to draw of lines over one time axis, each (n,).

    The record is cut into equal bins, as short as the number allows; each gives its lowest and highest sample of every line.
    All lines keep the same samples, so that values under the pointer are of one time.
    """
    lines = [np.asarray(line, float) for line in lines]
    n = len(lines[0])
    if n <= most:
        return np.arange(n)
    bounds = [np.where(np.isnan(line), np.inf, sign * line) for line in lines for sign in (1, -1)]
    size = 2 * n // most
    while len(kept := _lowest(bounds, size)) > most and size < n:
        size += 1 + size // 8
    return kept


def thinning(samples: int) -> str:
    """A sentence for the caption of thinned lines; empty if all samples are drawn."""
    if samples <= MOST:
        return ""
    return f"Drawn are at most {MOST} of the {samples} samples, the extremes of every line among them."


def to_the_eye(values: np.ndarray) -> np.ndarray:
    """Values rounded to some 1e-5 of their span, far less than a pixel, to keep the page small."""
    seen = values[np.isfinite(values)]
    span = float(np.ptp(seen)) if len(seen) else 0.0
    return np.round(values, 5 - math.floor(math.log10(span))) if span > 0.0 else values


def _lowest(lines: list[np.ndarray], size: int) -> np.ndarray:
    """Indices of the first sample, the last, and each line's lowest in every bin of `size` samples."""
    n = len(lines[0])
    starts = np.arange(0, n, size)
    padding = (0, len(starts) * size - n)
    kept = [starts + np.pad(line, padding, constant_values=np.inf).reshape(-1, size).argmin(axis=1) for line in lines]
    return np.unique(np.concatenate([[0, n - 1], *kept]))
