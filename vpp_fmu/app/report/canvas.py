"""Parts of all figures: the empty figure, panels over a common axis, lines, points, bands; thinning of long records."""

import math
import textwrap
from collections.abc import Iterable, Sequence

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.app.report import style

MOST = 4000
"""Maximum points per line. On a slow machine seven SVG lines of 22 500 points take 60 to 120 ms per zoom and 40 ms per hover;
lines of 4000 points take 30 and 18 ms, and a fifth of the bytes."""

_WIDEST = 80
"""Maximum letters in a line of a title in a notebook; the page breaks it itself."""

_GAP = 22
"""Pixels between two panels."""

_ABOVE, _BELOW = 70, 48
"""Pixels above and below the panels."""


def figure(title: str, height: int, x: str = "", y: str = "", legend: bool = True) -> go.Figure:
    """An empty figure `height` px high, as wide as the page, with axis labels; the legend is between title and panels."""
    return go.Figure(
        layout={
            "template": style.TEMPLATE,
            "height": height,
            "title": {"text": "<br>".join(f"<b>{style.escaped(line)}</b>" for line in textwrap.wrap(title, _WIDEST)), "x": 0.0},
            "showlegend": legend,
            "legend": {"orientation": "h", "y": 1.0, "yanchor": "bottom"},
            "margin": {"l": 64, "r": 24, "t": _ABOVE, "b": _BELOW},
            **{f"{side}axis": {"title": {"text": label}} for side, label in (("x", x), ("y", y)) if label},
        }
    )


def panels(title: str, labels: Sequence[str], heights: Sequence[int]) -> go.Figure:
    """A figure of panels from top to bottom with these axis labels and heights [px], over one axis in seconds.

    Zoom and hover act on all of them.
    """
    total = sum(heights) + _GAP * (len(heights) - 1)
    fig = figure(title, total + _ABOVE + _BELOW)
    top = total
    for k, (label, height) in enumerate(zip(labels, heights, strict=True)):
        text = "<br>".join(textwrap.wrap(label, height // 8))  # some 8 pixels per letter
        fig.update_layout({axis("yaxis", k): {"domain": [(top - height) / total, top / total], "title": {"text": text}}})
        fig.layout[axis("yaxis", k)].anchor = "x"
        top -= height + _GAP
    last = axis("y", len(labels) - 1)
    fig.update_xaxes(title_text=style.label("time"), anchor=last, hoverformat=".3f")
    fig.update_layout(hovermode="x unified", hoversubplots="axis")
    return fig


def axis(kind: str, panel: int) -> str:
    """Plotly's name of an axis: the first has no number."""
    return kind if panel == 0 else f"{kind}{panel + 1}"


def add_line(
    fig: go.Figure,
    x,
    y,
    name: str,
    colour: str,
    width: float = 1.8,
    panel: int = 0,
    group: str | None = None,
    **more,
) -> None:
    """A line in a panel, from 0. With a `group` it has no legend entry and is shown with the line of that name. `more`: `dash`
    and `shape` of the line, and properties of plotly's trace."""
    line = {"color": colour, "width": width} | {key: more.pop(key) for key in ("dash", "shape") if key in more}
    more |= {"legendgroup": group or name, "yaxis": axis("y", panel)} | ({"showlegend": False} if group else {})
    fig.add_scatter(**{"x": x, "y": y, "mode": "lines", "name": style.escaped(name), "line": line, **more})


def add_points(fig: go.Figure, x, y, name: str, colour: str, size: float = 6, symbol: str | None = None, **more) -> None:
    """Points without a line."""
    marker = {"size": size, "color": colour, "symbol": symbol}
    fig.add_scatter(**{"x": x, "y": y, "mode": "markers", "name": style.escaped(name), "marker": marker, **more})


def add_envelope(fig: go.Figure, x, low, high, name: str, colour: str, panel: int = 0) -> None:
    """A coloured band from `low` to `high`, all (n,); only the first of a name is in the legend."""
    shown = not any(trace.name == style.escaped(name) for trace in fig.data)
    shared = {"x": x, "mode": "lines", "line": {"width": 0}, "hoverinfo": "skip"}
    shared |= {"legendgroup": name, "yaxis": axis("y", panel)}
    fig.add_scatter(y=low, showlegend=False, **shared)
    fig.add_scatter(y=high, name=style.escaped(name), fill="tonexty", fillcolor=colour, showlegend=shown, **shared)


def add_band(fig: go.Figure, panel: int, half_width: float, name: str) -> None:
    """A band around zero under the lines of a panel. Its dotted edges are above them: a dense residual hides the rest."""
    edge = {"color": style.MEASURED, "width": 1, "dash": "dot"}
    _across(fig, panel, "rect", -half_width, half_width, fillcolor=style.NOISE, line=edge, name=name, showlegend=True)


def add_level(fig: go.Figure, panel: int, at: float) -> None:
    """A dashed line across a panel."""
    _across(fig, panel, "line", at, at, line={"color": style.SET_POINT, "width": 1.2, "dash": "dash"})


def _across(fig: go.Figure, panel: int, kind: str, low: float, high: float, **more) -> None:
    fig.add_shape(type=kind, xref="x domain", yref=axis("y", panel), x0=0, x1=1, y0=low, y1=high, **more)


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
