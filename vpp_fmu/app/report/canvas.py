"""Parts of all figures: the empty figure, panels over a common axis, lines, bands, heat maps; thinning of long records."""

import math
import textwrap
from collections.abc import Iterable, Sequence

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.app.report import style

MOST = 4000
"""Maximum points per line. On a slow machine seven SVG lines of 22 500 points take 60 to 120 ms per zoom and 40 ms per hover;
lines of 4000 points take 30 and 18 ms, and a fifth of the bytes. WebGL lines need eval, which the page forbids. plotly takes
three WebGL contexts per figure, while a browser allows some 16 per page."""

_WIDEST = 80
"""Maximum letters in a line of a title, for A4."""

_GAP = 22
"""Pixels between two panels."""


def figure(title: str, height: int, x: str = "", y: str = "", legend: bool = True) -> go.Figure:
    """An empty figure `height` px high, as wide as the page, with axis labels; the title wraps, the legend is below it."""
    lines = _lines(title)
    below_title = 14 + 21 * len(lines)
    corner = {"x": 0.0, "xref": "container", "xanchor": "left", "yref": "container", "yanchor": "top"}
    return go.Figure(
        layout={
            "template": style.TEMPLATE,
            "height": height,
            "title": {
                "text": "<br>".join(f"<b>{style.escaped(line)}</b>" for line in lines),
                "font": {"size": 15},
                "y": 1.0,
                # plotly forgets to lower a title of several lines by the height of a capital.
                "pad": {"t": 8 if len(lines) < 2 else 19},
                **corner,
            },
            "showlegend": legend,
            "legend": {"orientation": "h", "y": 1.0 - below_title / height, "bgcolor": "rgba(0,0,0,0)", **corner},
            "margin": {"l": 64, "r": 24, "t": below_title + (34 if legend else 10), "b": 48},
            **{f"{side}axis": {"title": {"text": label}} for side, label in (("x", x), ("y", y)) if label},
        }
    )


def panels(title: str, labels: Sequence[str], heights: Sequence[int]) -> go.Figure:
    """A figure of panels from top to bottom with these axis labels and heights [px], over one axis in seconds.

    Zoom and hover act on all of them.
    """
    total = sum(heights) + _GAP * (len(heights) - 1)
    fig = figure(title, total + 130)
    top = total
    for k, (label, height) in enumerate(zip(labels, heights, strict=True)):
        domain = [(top - height) / total, top / total]
        fig.update_layout({axis("yaxis", k): {"domain": domain, "title": {"text": _folded(label, height)}, "anchor": "x"}})
        top -= height + _GAP
    last = axis("y", len(labels) - 1)
    fig.update_layout(
        xaxis={"title": {"text": style.label("time")}, "anchor": last, "hoverformat": ".3f"},
        hovermode="x unified",
        hoversubplots="axis",
    )
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
    panel: int | None = None,
    group: str | None = None,
    **more,
) -> None:
    """A line, in the given panel (from 0) if there are panels. With a `group` it has no legend entry and is shown with the line
    of that name. `more`: `dash` and `shape` of the line, and properties of plotly's trace."""
    line = {"color": colour, "width": width} | {key: more.pop(key) for key in ("dash", "shape") if key in more}
    if panel is not None:
        more |= {"legendgroup": group or name, "showlegend": group is None, "yaxis": axis("y", panel)}
    fig.add_scatter(**{"x": x, "y": y, "mode": "lines", "name": style.escaped(name), "line": line, **more})


def add_points(fig: go.Figure, x, y, name: str, colour: str, size: float = 6, symbol: str | None = None, **more) -> None:
    """Points without a line."""
    marker = {"size": size, "color": colour, "symbol": symbol}
    fig.add_scatter(**{"x": x, "y": y, "mode": "markers", "name": style.escaped(name), "marker": marker, **more})


def add_envelope(fig: go.Figure, x, low, high, name: str, colour: str, panel: int | None = None) -> None:
    """A coloured band from `low` to `high`, all (n,); only the first of a name is in the legend."""
    shown = not any(trace.name == style.escaped(name) for trace in fig.data)
    shared = {"x": x, "mode": "lines", "line": {"width": 0}, "hoverinfo": "skip"}
    if panel is not None:
        shared |= {"legendgroup": name, "yaxis": axis("y", panel)}
    fig.add_scatter(y=low, showlegend=False, **shared)
    fig.add_scatter(y=high, name=style.escaped(name), fill="tonexty", fillcolor=colour, showlegend=shown, **shared)


def add_band(fig: go.Figure, panel: int, half_width: float, name: str) -> None:
    """A band around zero under the lines of a panel. Its dotted edges are above them: a dense residual hides the rest."""
    fig.add_shape(
        type="rect",
        xref="x domain",
        yref=axis("y", panel),
        x0=0,
        x1=1,
        y0=-half_width,
        y1=half_width,
        fillcolor=style.NOISE,
        line={"color": style.MEASURED, "width": 1, "dash": "dot"},
        name=style.escaped(name),
        showlegend=True,
    )


def heatmap(
    title: str, height: int, x, y, z: np.ndarray, ends: tuple[float, float], colours, labels: tuple[str, str, str], **more
) -> go.Figure:
    """Values z (rows, columns) over y (rows,) and x (columns,) in colours from one end to the other; `labels` of x, y, z."""
    fig = figure(title, height, *labels[:2], legend=False)
    bar = {"title": {"text": labels[2]}}
    fig.add_heatmap(x=x, y=y, z=z, zmin=ends[0], zmax=ends[1], colorscale=colours, colorbar=bar, **more)
    fig.update_xaxes(showgrid=False)
    fig.update_yaxes(showgrid=False)
    return fig


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


def _lines(title: str) -> list[str]:
    """The title in the fewest lines that fit on A4, of similar length."""
    widest = textwrap.wrap(title, _WIDEST)
    shorter = (textwrap.wrap(title, width) for width in range(24, _WIDEST))
    return next((lines for lines in shorter if len(lines) == len(widest)), widest)


def _folded(label: str, height: int) -> str:
    """The label in lines that fit along `height` pixels, at some 8 pixels per letter."""
    return "<br>".join(textwrap.wrap(label, height // 8))
