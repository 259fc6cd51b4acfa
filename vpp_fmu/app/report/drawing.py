"""Convert a plotly figure to the data that `draw.js` draws.

plotly's own script takes 4.8 MB in every page, 2.0 MB packed. The pages need only lines, markers and bands in panels over one x
axis: `draw.js` draws these in the colours of the page, light or dark, at any width. In Python they are plotly figures, made by
`canvas.py` alone.
"""

import base64
import html
import json
import re
from importlib.resources import files
from typing import Any

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.app.report import style

SCRIPT = files(__package__).joinpath("draw.js").read_text(encoding="utf-8")


class Arrays:
    """Numbers as base64 of 32-bit floats, seven digits. Each array is stored once per page, since figures share their times."""

    def __init__(self):
        self._places: dict[str, int] = {}
        self._new: list[str] = []

    def add(self, values) -> int:
        """Index of an array."""
        packed = base64.b64encode(np.asarray(values, np.float32).tobytes()).decode()
        if packed not in self._places:
            self._places[packed] = len(self._places)
            self._new.append(packed)
        return self._places[packed]

    def new(self) -> list[str]:
        """Arrays added since the last call."""
        new, self._new = self._new, []
        return new


def drawing(fig: go.Figure, arrays: Arrays) -> str:
    """The figure as JSON for `draw`, with those of its `arrays` that are not yet in the page. ValueError for a colour that
    may be invisible on dark."""
    layout, margin = fig.to_plotly_json()["layout"], fig.layout.margin
    traces: dict[str, list] = {"x": list(fig.data)}
    for trace in fig.data:
        traces.setdefault(trace.yaxis or "y", []).append(trace)
    axes = {name: _axis(name[0], layout.get(f"{name[0]}axis{name[1:]}", {}), own) for name, own in traces.items()}
    marks = [_mark(trace, axes, arrays, f"mark {k}") for k, trace in enumerate(fig.data)]
    shapes = [_shape(shape, f"shape {k}") for k, shape in enumerate(fig.layout.shapes)]
    entries = [
        _entry(drawn) for drawn, of in zip((*marks, *shapes), (*fig.data, *fig.layout.shapes), strict=True) if _named(of)
    ]
    downs = {name: fig.layout[f"yaxis{name[1:]}"].domain or (0.0, 1.0) for name in axes if name != "x"}
    panels = [{"y": name, "top": 1.0 - high, "tall": high - low} for name, (low, high) in downs.items()]
    spec = {
        "height": fig.layout.height - margin.t - margin.b,
        "panels": sorted(panels, key=lambda panel: panel["top"]),
        "axes": axes,
        "marks": marks,
        "shapes": shapes,
        "legend": entries if fig.layout.showlegend is not False else [],
        "hover": "x" if fig.layout.hovermode == "x unified" else "closest",
        "arrays": arrays.new(),
    }
    # "</script>" in a label would end the script.
    return json.dumps(_bare(spec), ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def heading(fig: go.Figure) -> str:
    """The figure's title as text, which the page breaks into lines itself."""
    return _words(fig.layout.title.text).replace("\n", " ")


def _named(drawn) -> bool:
    """Whether a trace or shape is in the legend: a trace is, unless it says no; a shape only if it says so."""
    return bool(drawn.name) and (drawn.showlegend or (drawn.showlegend is None and isinstance(drawn, go.Scatter)))


def _words(text: str | None) -> str:
    """Text without plotly's tags; the page escapes it."""
    return html.unescape(re.sub(r"</?b>|<extra></extra>", "", (text or "").replace("<br>", "\n")))


def _axis(side: str, given: dict, traces: list) -> dict[str, Any]:
    values = [value for trace in traces for value in trace[side]]
    found: dict[str, Any] = {
        "title": _words(given.get("title", {}).get("text")).replace("\n", " "),
        "kind": given.get("type", "linear"),
        "range": list(given["range"]) if "range" in given else None,
        "reversed": given.get("autorange") == "reversed",
        "format": given.get("hoverformat", ".5~g"),
        "zero": given.get("rangemode") == "tozero",
        "step": given.get("dtick"),
    }
    if found["kind"] == "category" or any(isinstance(value, str) for value in values):
        found |= {"kind": "category", "names": list(dict.fromkeys(map(_words, values)))}
    return found


def _mark(trace, axes: dict, arrays: Arrays, key: str) -> dict[str, Any]:
    """A line, points, or a band down to the line before it."""
    mark: dict[str, Any] = {
        "axis": trace.yaxis or "y",
        "key": trace.legendgroup or key,
        "name": _words(trace.name),
        "told": _words(trace.hovertemplate),
        "mute": trace.hoverinfo == "skip",
        "text": None if trace.text is None else [_words(text) for text in trace.text],
        "wide": trace.line.width if "lines" in trace.mode else 0,
        "dash": trace.line.dash,
        "held": trace.line.shape == "hv",
        "veil": trace.fill and style.ink(trace.fillcolor),
    }
    for side, axis in (("x", "x"), ("y", mark["axis"])):
        names = axes[axis]["kind"] == "category"
        mark[side] = list(map(_words, trace[side])) if names else arrays.add(np.array(trace[side], float))
        if (error := trace[f"error_{side}"]).array is not None:
            low = error.array if error.arrayminus is None else error.arrayminus
            mark |= {"across": side, "high": arrays.add(error.array), "low": arrays.add(low)}
    if "markers" in trace.mode:
        mark |= {"symbol": trace.marker.symbol or "circle", "size": trace.marker.size or 6}
    if mark["wide"] or mark.get("symbol"):
        mark["colour"] = style.ink(trace.line.color or trace.marker.color)
    return mark


def _shape(shape, key: str) -> dict[str, Any]:
    """A line or a band across a panel."""
    lying, line = shape.xref.endswith("domain"), shape.type == "line"
    return {
        "key": key,
        "name": _words(shape.name),
        "axis": shape.yref if lying else shape.xref,
        "ends": [float(end) for end in ((shape.y0, shape.y1) if lying else (shape.x0, shape.x1))],
        "line": line,
        "colour": style.ink(shape.line.color if line else shape.fillcolor),
        "edge": None if line else style.ink(shape.line.color),
        "wide": shape.line.width,
        "dash": shape.line.dash,
    }


def _entry(drawn: dict) -> dict[str, Any]:
    """The entry of a mark or shape in the legend."""
    entry = {name: drawn.get(name) for name in ("key", "name", "colour", "wide", "dash", "symbol", "size")}
    veil = drawn.get("veil") or (drawn.get("edge") and drawn["colour"])
    return entry | ({"box": True, "colour": veil, "wide": 0} if veil else {})


def _bare(value):
    """Without entries that are None, False or empty, which are defaults of `draw.js`; 0 is kept."""
    if isinstance(value, dict):
        return {k: _bare(v) for k, v in value.items() if v is not None and v is not False and v != ""}
    return [_bare(v) for v in value] if isinstance(value, list) else value
