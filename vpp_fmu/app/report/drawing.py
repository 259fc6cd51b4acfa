"""Convert a plotly figure to the data that `draw.js` draws.

plotly's own script takes 4.8 MB in every page, 2.0 MB packed. The pages need only lines, markers, bars and heat maps over plain
axes: `draw.js` draws these in the colours of the page, light or dark, at any width. In Python they are plotly figures.
A property of a figure that `draw.js` does not support is refused here, not dropped silently.
"""

import base64
import html
import json
import re
from datetime import datetime
from importlib.resources import files
from typing import Any

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.app.report import style

SCRIPT = files(__package__).joinpath("draw.js").read_text(encoding="utf-8")

_KNOWN = {
    "scatter": """x y mode name text opacity fill fillcolor hoverinfo hovertemplate legendgroup legendrank showlegend type
        xaxis yaxis line.color line.dash line.shape line.width error_x.array error_x.arrayminus error_x.color error_x.thickness
        error_x.width error_y.array error_y.type marker.color marker.colorscale marker.colorbar.title.text marker.line.width
        marker.showscale marker.size marker.symbol""",
    "bar": """x y name width opacity marker.color hovertemplate showlegend type xaxis yaxis""",
    "heatmap": "x y z zmin zmax colorscale colorbar.title.text hovertemplate type",
    "shape": "type name fillcolor layer opacity showlegend line.color line.dash line.width x0 x1 xref y0 y1 yref",
    "annotation": "text font.size showarrow x y xref yref xanchor yanchor",
    "axis": """anchor autorange categoryarray categoryorder domain dtick hoverformat range rangemode scaleanchor scaleratio
        showgrid showticklabels tickfont.size tickformat ticktext tickvals title.text title.font.size title.standoff type
        zeroline""",
    "layout": """title height margin template legend hovermode hoversubplots showlegend bargap shapes
        annotations""",
}
"""Supported properties, by the kind of object."""

_LOWEST = 84
"""Minimum height of a plot, in pixels, for the title of its axis."""


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
    """The figure as JSON for `draw`, with those of its `arrays` that are not yet in the page.

    ValueError names an unsupported property.
    """
    for trace in fig.data:
        if trace.type not in ("scatter", "bar", "heatmap"):
            raise ValueError(f"a {trace.type} can't be drawn")
        _check(trace.type, trace.to_plotly_json())
    layout = fig.to_plotly_json()["layout"]
    for key, value in layout.items():
        if re.fullmatch(r"[xy]axis\d*", key):
            _check("axis", value)
        elif key not in _KNOWN["layout"].split():
            raise ValueError(f"layout.{key} can't be drawn")
    axes = {_short(key): _axis(_short(key), fig, layout[key]) for key in sorted(layout) if re.fullmatch(r"[xy]axis\d*", key)}
    for trace in fig.data:
        for side in "xy":
            name = trace[f"{side}axis"] or side
            axes.setdefault(name, _axis(name, fig, {}))
    legend, margin = fig.layout.showlegend is not False, fig.layout.margin
    marks, entries = [], []
    for k, trace in enumerate(fig.data):
        mark = _mark(trace, fig, axes, arrays, f"mark {k}")
        marks.append(mark)
        if legend and trace.showlegend is not False and trace.name and trace.type != "heatmap":
            entries.append(((trace.type == "scatter" and trace.legendrank) or 1000, _entry(mark)))
    shapes = [_shape(shape, f"shape {k}") for k, shape in enumerate(fig.layout.shapes)]
    entries += [
        (1000, _shape_entry(shape, drawn)) for shape, drawn in zip(fig.layout.shapes, shapes, strict=True) if shape.showlegend
    ]
    spec = {
        "height": max(fig.layout.height - margin.t - margin.b, _LOWEST),
        "panels": _panels(fig),
        "axes": axes,
        "marks": marks,
        "shapes": shapes,
        "legend": [entry for _, entry in sorted(entries, key=lambda entry: entry[0])],
        "hover": "x" if fig.layout.hovermode == "x unified" else "closest",
        "equal": fig.layout.yaxis.scaleanchor is not None,
        "scale": next((mark["scale"] for mark in marks if "scale" in mark), None),
        "arrays": arrays.new(),
    }
    # "</script>" in a label would end the script.
    return json.dumps(_bare(spec), ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def heading(fig: go.Figure) -> str:
    """The figure's title as text, which the page breaks into lines itself."""
    return _words(fig.layout.title.text).replace("\n", " ")


def _check(kind: str, asked: dict, within: str = "") -> None:
    """ValueError for properties that `draw.js` does not support."""
    known = _KNOWN[kind].split()
    for key, value in asked.items():
        name = within + key
        if name in known:
            continue
        if not isinstance(value, dict) or not any(k.startswith(f"{name}.") for k in known):
            raise ValueError(f"{kind}.{name} can't be drawn")
        _check(kind, value, f"{name}.")


def _short(key: str) -> str:
    """Name of an axis in traces: x2 for xaxis2."""
    return key[0] + key[5:]


def _words(text: str | None) -> str:
    """Text without plotly's tags; the page escapes it."""
    return html.unescape(re.sub(r"</?b>|<extra></extra>", "", (text or "").replace("<br>", "\n")))


def _axis(name: str, fig: go.Figure, given: dict) -> dict[str, Any]:
    found: dict[str, Any] = {
        "title": _words(given.get("title", {}).get("text")).replace("\n", " "),
        "kind": given.get("type", "linear"),
        "range": list(given["range"]) if "range" in given else None,
        "reversed": given.get("autorange") == "reversed",
        "format": given.get("hoverformat", ".5~g"),
        "zero": given.get("rangemode") == "tozero",
        "zeroline": bool(given.get("zeroline")),
        "bare": given.get("showgrid") is False,
        "step": given.get("dtick") if isinstance(given.get("dtick"), int | float) and given.get("type") != "log" else None,
    }
    if "tickvals" in given:
        found["tickvals"] = [float(value) for value in given["tickvals"]]
        found["ticktext"] = list(given["ticktext"]) if "ticktext" in given else None
    values = [
        trace[name[0]] for trace in fig.data if (trace[f"{name[0]}axis"] or name[0]) == name and trace[name[0]] is not None
    ]
    if found["kind"] == "date":
        found["step"] = 1
        found["format"] = ".0f"
    elif found["kind"] == "category" or any(isinstance(value, str) for own in values for value in own):
        found["kind"] = "category"
        names = given.get("categoryarray")
        names = dict.fromkeys(_words(n) for own in values for n in own) if names is None else map(_words, names)
        found["names"] = list(names)
    return found


def _coordinates(values, kind: str, arrays: Arrays):
    if kind == "category":
        return [_words(value) for value in values]
    if kind == "date":
        values = [
            (datetime.fromisoformat(value).replace(tzinfo=None) - datetime(1970, 1, 1)).total_seconds() / 86400
            for value in values
        ]
    return arrays.add(np.array([np.nan if value is None else value for value in values], float))


def _mark(trace, fig: go.Figure, axes: dict, arrays: Arrays, key: str) -> dict[str, Any]:
    names = {side: trace[f"{side}axis"] or side for side in "xy"}
    common = {
        "axes": names,
        "key": trace.legendgroup or key if trace.type == "scatter" else key,
        "name": _words(trace.name),
        "told": _words(trace.hovertemplate),
        "opacity": trace.opacity,
        "mute": trace.hoverinfo == "skip",
        **{side: _coordinates(trace[side], axes[names[side]]["kind"], arrays) for side in "xy"},
    }
    return common | {"scatter": _line, "bar": _bar, "heatmap": _heatmap}[trace.type](trace, fig, arrays)


def _line(trace, fig: go.Figure, arrays: Arrays) -> dict[str, Any]:
    mode = trace.mode or "lines+markers"
    width = (2.0 if trace.line.width is None else trace.line.width) if "lines" in mode else 0
    given = trace.line.color or (None if isinstance(trace.marker.color, np.ndarray) else trace.marker.color)
    if given is None and (width or "markers" in mode) and trace.marker.color is None:
        raise ValueError(f"{trace.name} has no colour of its own")
    mark: dict[str, Any] = {
        "kind": "line",
        "colour": given and style.ink(given),
        "wide": width,
        "dash": trace.line.dash,
        "held": trace.line.shape == "hv",
        "text": None if trace.text is None else [_words(text) for text in trace.text],
    }
    if "markers" in mode:
        mark |= {"symbol": trace.marker.symbol or "circle", "size": trace.marker.size or 6}
    if trace.fill:
        mark |= {
            "fill": {"tonexty": "previous", "tozeroy": "zero", "toself": "self"}[trace.fill],
            "veil": style.ink(trace.fillcolor),
        }
    if isinstance(trace.marker.color, np.ndarray):
        seen = trace.marker.color[np.isfinite(trace.marker.color)]
        scale = _scale(trace.marker.colorscale, float(seen.min()), float(seen.max()), trace.marker.colorbar.title.text)
        mark |= {"tint": arrays.add(trace.marker.color), "scale": scale, **scale}
    for side in "xy":
        error = trace[f"error_{side}"]
        if error.array is not None:
            low = error.array if error.arrayminus is None else error.arrayminus
            mark |= {"across": side, "high": arrays.add(error.array), "low": arrays.add(low)}
    return mark


def _bar(trace, fig: go.Figure, _: Arrays) -> dict[str, Any]:
    return {
        "kind": "bar",
        "colour": style.ink(trace.marker.color),
        "gap": 0.2 if fig.layout.bargap is None else fig.layout.bargap,
        "width": None if trace.width is None else float(trace.width),
    }


def _heatmap(trace, _: go.Figure, arrays: Arrays) -> dict[str, Any]:
    scale = _scale(trace.colorscale, float(trace.zmin), float(trace.zmax), trace.colorbar.title.text)
    return {
        "kind": "heatmap",
        "z": arrays.add(np.asarray(trace.z, float).ravel()),
        "scale": scale,
        **scale,
    }


def _scale(colours, least: float, most: float, title: str | None) -> dict[str, Any]:
    stops = [[float(at), style.ink(colour)] for at, colour in colours]
    return {"stops": stops, "least": least, "most": most, "title": title}


def _shape(shape, key: str) -> dict[str, Any]:
    """A line or a band across a panel."""
    _check("shape", shape.to_plotly_json())
    xref, yref = shape.xref or "x", shape.yref or "y"
    lying = xref.endswith("domain")
    if lying == yref.endswith("domain") or shape.type not in {"line", "rect"}:
        raise ValueError("a shape that isn't a line or a band across a panel can't be drawn")
    return {
        "key": key,
        "axis": yref if lying else xref,
        "other": None if not lying or xref == "x domain" else xref.split()[0],
        "ends": [float(end) for end in ((shape.y0, shape.y1) if lying else (shape.x0, shape.x1))],
        "line": shape.type == "line",
        "colour": style.ink(shape.line.color if shape.type == "line" else shape.fillcolor),
        "edge": style.ink(shape.line.color) if shape.type == "rect" and shape.line.width else None,
        "wide": shape.line.width,
        "dash": shape.line.dash,
        "opacity": shape.opacity,
    }


def _entry(mark: dict) -> dict[str, Any]:
    entry = {name: mark.get(name) for name in ("key", "name", "colour", "wide", "dash", "symbol", "size", "opacity")}
    if mark["kind"] == "bar":
        return entry | {"box": True}
    if mark.get("fill") in {"previous", "self"}:
        return entry | {"box": True, "colour": mark["veil"], "wide": 0}
    return entry


def _shape_entry(shape, drawn: dict) -> dict[str, Any]:
    entry = {name: drawn[name] for name in ("key", "colour", "dash", "opacity")}
    return entry | {"name": _words(shape.name), "wide": drawn["wide"] if drawn["line"] else 0, "box": not drawn["line"]}


def _panels(fig: go.Figure) -> list[dict[str, Any]]:
    """Each pair of axes that a trace uses, with its position from the top left, in shares of the plot."""
    pairs = list(dict.fromkeys((trace.xaxis or "x", trace.yaxis or "y") for trace in fig.data))
    found = []
    for x, y in pairs:
        across = fig.layout[f"xaxis{x[1:]}"].domain or (0.0, 1.0)
        down = fig.layout[f"yaxis{y[1:]}"].domain or (0.0, 1.0)
        found.append(
            {"x": x, "y": y, "left": across[0], "top": 1.0 - down[1], "tall": down[1] - down[0], "heading": _heading(fig, x)}
        )
    return sorted(found, key=lambda panel: (round(panel["top"], 3), panel["left"]))


def _heading(fig: go.Figure, x: str) -> str | None:
    """The annotation above the panel of this x axis."""
    for note in fig.layout.annotations:
        _check("annotation", note.to_plotly_json())
        if note.xref == f"{x} domain":
            return _words(note.text)
    return None


def _bare(value):
    """Without entries that are None, False or empty, which are defaults of `draw.js`; 0 is kept."""
    if isinstance(value, dict):
        return {k: _bare(v) for k, v in value.items() if v is not None and v is not False and v != ""}
    return [_bare(v) for v in value] if isinstance(value, list) else value
