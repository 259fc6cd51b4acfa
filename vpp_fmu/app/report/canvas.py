"""Figures: lines, points and bands in panels over one x axis, which `draw.js` draws on a page, in its colours and at its width.

plotly's own script takes 4.8 MB in every page, 2.0 MB packed. In a notebook the same figures are plotly's.
"""

import base64
import html
import json
import textwrap
from collections.abc import Iterable, Sequence
from importlib.resources import files
from typing import Any

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.app.report import style

SCRIPT = files(__package__).joinpath("draw.js").read_text(encoding="utf-8")

MOST = 4000
"""Maximum points per line. On a slow machine seven SVG lines of 22 500 points take 60 to 120 ms per zoom and 40 ms per hover;
lines of 4000 points take 30 and 18 ms, and a fifth of the bytes."""

_WIDEST = 80
"""Maximum letters in a line of a title in a notebook; the page breaks it itself."""

_GAP, _AROUND = 22, 118
"""Pixels between two panels, and above and below them in a notebook."""


class Figure:
    """A figure with its message as the `title`, and panels from top to bottom, each (label, height in pixels).

    `x`: label of the x axis. `unified`: the values of all lines at the pointer are shown, else those of the nearest point.
    `axes`: properties by name, "x", "y0", "y1", ...: title, kind (linear, log), range, reversed, step (least distance
    of ticks), and format (d3's) of a value under the pointer. Axes of texts are categories.
    """

    def __init__(self, title: str, panels: Sequence[tuple[str, int]], x: str, unified: bool = False):
        self.title, self.unified = title, unified
        labels = {"x": x, **{f"y{k}": label for k, (label, _) in enumerate(panels)}}
        self.axes: dict[str, dict[str, Any]] = {name: {"title": label, "kind": "linear"} for name, label in labels.items()}
        self.heights = [height for _, height in panels]
        self.marks: list[dict[str, Any]] = []
        self.shapes: list[dict[str, Any]] = []

    def line(self, x, y, name: str, colour: str, width: float = 1.8, panel: int = 0, group: str = "", **more) -> None:
        """A line in a panel, from 0. Lines of one name, or of a `group`, have one legend entry. `more`:
        `dash` (dot, dash, dashdot), `held` (until the next value), `size` of a marker at each value, `mute` (no value is
        shown at the pointer)."""
        shown = bool(name) and not group and all(mark["key"] != name for mark in self.marks)
        own = {"name": name, "key": group or name, "shown": shown, "colour": colour, "wide": width, **more}
        self.marks.append({"axis": f"y{panel}", "x": x, "y": y, **own})

    def points(self, x, y, name: str, colour: str, size: float = 6, panel: int = 0, group: str = "", **more) -> None:
        """Points without a line. `more`: as of a line, `bar` (a vertical stroke in place of a dot), and error bars of half
        width `error` (n,) along the axis `across`, "x" or "y"."""
        self.line(x, y, name, colour, 0, panel, group, size=size, **more)

    def envelope(self, x, low, high, name: str, colour: str, panel: int = 0) -> None:
        """A coloured band from `low` to `high`, all (n,); only the first of a name is in the legend."""
        first = all(mark["key"] != name for mark in self.marks)
        self.line(x, low, "", colour, 0, panel, name, mute=True)
        self.line(x, high, name, colour, 0, panel, name, mute=True, fill=colour)
        self.marks[-1]["shown"] = first

    def band(self, panel: int, half_width: float, name: str) -> None:
        """A band around zero under the lines of a panel. Its dotted edges are above them: a dense residual hides the rest."""
        edge = {"colour": style.MEASURED, "wide": 1, "dash": "dot"}
        self._across(f"y{panel}", [-half_width, half_width], name, fill=style.NOISE, **edge)

    def level(self, axis: str, at: float, name: str, colour: str = style.SET_POINT) -> None:
        """A line across the panels at a value of an axis."""
        self._across(axis, [float(at)], name, colour=colour, wide=1.2, dash="dashdot")

    def _across(self, axis: str, ends: list[float], name: str, **more) -> None:
        shown = all(shape["key"] != name for shape in self.shapes)
        self.shapes.append({"axis": axis, "ends": ends, "name": name, "key": name, "shown": shown, **more})

    @property
    def samples(self) -> int:
        """Samples of the longest line."""
        return max(len(mark["x"]) for mark in self.marks)

    def _thinned(self) -> list[dict[str, Any]]:
        """The marks with at most MOST samples. Lines over the same x keep the same ones, as the pointer reads one time."""
        keys = [np.asarray(mark["x"], float).tobytes() if len(mark["x"]) > MOST else b"" for mark in self.marks]
        same = {key: [mark["y"] for mark, own in zip(self.marks, keys, strict=True) if own == key] for key in {*keys} - {b""}}
        kept = {key: places(lines) for key, lines in same.items()}
        return [
            mark | {side: np.asarray(mark[side], float)[kept[key]] for side in "xy"} if key else mark
            for mark, key in zip(self.marks, keys, strict=True)
        ]

    def drawing(self, arrays: dict[str, int]) -> str:
        """JSON for `draw`. `arrays`: places of the page's arrays, each stored once, since figures share times; those of this
        figure are added. ValueError for a colour that may be invisible on dark."""
        panels, top, known = [], 8, len(arrays)
        for k, tall in enumerate(self.heights):
            panels.append({"y": f"y{k}", "y0": top, "tall": tall})
            top += tall + _GAP
        spec = {
            "panels": panels,
            "axes": {name: axis | self._names(name) for name, axis in self.axes.items()},
            "marks": [_encoded(mark, arrays) for mark in self._thinned()],
            "shapes": [_encoded(shape, arrays) for shape in self.shapes],
            "unified": self.unified,
            "arrays": list(arrays)[known:],
        }
        # "</script>" in a label would end the script.
        return json.dumps(spec, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")

    def _names(self, axis: str) -> dict[str, Any]:
        """Kind and names of an axis of texts; empty for others."""
        own = [value for mark in self.marks if axis in ("x", mark["axis"]) for value in mark[axis[0]]]
        return {"kind": "category", "names": list(dict.fromkeys(own))} if any(isinstance(value, str) for value in own) else {}

    def plotly(self) -> go.Figure:
        """The same figure for a notebook."""
        total = sum(self.heights)
        title = "<br>".join(map(_escaped, textwrap.wrap(self.title, _WIDEST)))
        fig = go.Figure(layout={"template": "plotly_white", "height": total + _AROUND})
        fig.update_layout(title={"text": title, "x": 0.0}, legend={"orientation": "h", "y": 1.0, "yanchor": "bottom"})
        fig.update_layout(hovermode="x unified" if self.unified else "closest")
        for name, axis in self.axes.items():
            kind = (axis | self._names(name))["kind"]
            given = {"title": {"text": _escaped(axis["title"])}, "type": kind, "range": axis.get("range")}
            if name != "x":
                below = sum(self.heights[int(name[1:]) + 1 :])
                given["domain"] = [below / total, (below + 0.9 * self.heights[int(name[1:])]) / total]
            fig.layout[_plotlys(name, "axis")] = given | ({"autorange": "reversed"} if axis.get("reversed") else {})
        fig.layout.xaxis.anchor = _plotlys(list(self.axes)[-1])
        for mark in self._thinned():
            values = {side: [_escaped(v) if isinstance(v, str) else v for v in mark[side]] for side in "xy"}
            kinds = ["markers"] * ("size" in mark) + ["lines"] * bool(mark["wide"] or "size" not in mark)
            line = {"color": mark["colour"], "width": mark["wide"], "dash": mark.get("dash")}
            line |= {"shape": "hv"} if mark.get("held") else {}
            fig.add_scatter(
                **values,
                **({f"error_{mark['across']}": {"array": mark["error"]}} if "across" in mark else {}),
                **({"fill": "tonexty", "fillcolor": mark["fill"]} if "fill" in mark else {}),
                name=_escaped(mark["name"]),
                mode="+".join(kinds),
                line=line,
                marker={"color": mark["colour"], "size": mark.get("size")},
                yaxis=_plotlys(mark["axis"]),
                legendgroup=mark["key"],
                showlegend=mark["shown"],
                hoverinfo="skip" if mark.get("mute") else None,
            )
        for shape in self.shapes:
            low, high = shape["ends"][0], shape["ends"][-1]
            line = {"color": shape["colour"], "width": shape["wide"], "dash": shape["dash"]}
            if shape["axis"] == "x":
                fig.add_vline(x=low, line=line)
            else:
                across = {"xref": "paper", "x0": 0, "x1": 1, "yref": _plotlys(shape["axis"]), "y0": low, "y1": high}
                fig.add_shape(type="rect", **across, line=line, fillcolor=shape.get("fill"))
        return fig


def _encoded(mark: dict[str, Any], arrays: dict[str, int]) -> dict[str, Any]:
    """A mark or shape for `draw`: colours of the page, and places of its arrays."""
    inked = {key: style.ink(mark[key]) for key in ("colour", "fill") if key in mark}
    return mark | inked | {key: _placed(mark[key], arrays) for key in ("x", "y", "error") if key in mark}


def _placed(values, arrays: dict[str, int]) -> list[str] | int:
    """Texts, or the place of numbers: base64 of 32-bit floats, seven digits."""
    if any(isinstance(value, str) for value in values):
        return list(values)
    return arrays.setdefault(base64.b64encode(np.array(values, np.float32).tobytes()).decode(), len(arrays))


def _plotlys(axis: str, kind: str = "") -> str:
    """plotly's name of an axis: y2 for y1, or yaxis2."""
    return f"{axis[0]}{kind}{int(axis[1:]) + 1 if axis[1:] not in ('', '0') else ''}"


def _escaped(text: str) -> str:
    """Text for plotly, which would interpret tags."""
    return html.escape(text, quote=False).replace("\n", "<br>")


def figure(title: str, height: int, x: str, y: str = "") -> Figure:
    """A figure of one panel with axis labels."""
    return Figure(title, [(y, height)], x)


def panels(title: str, labels: Iterable[str], heights: Iterable[int], x: str = style.LABELS["time"]) -> Figure:
    """A figure of panels from top to bottom with these labels and heights. Zoom and pointer act on all of them."""
    fig = Figure(title, list(zip(labels, heights, strict=True)), x, unified=True)
    fig.axes["x"]["format"] = ".3f"
    return fig


def places(lines: Iterable[np.ndarray]) -> np.ndarray:
    """Indices (k,) of at most MOST samples to draw of longer lines over one time axis, each (n,).

    The record is cut into equal bins, as short as the number allows; each gives its lowest and highest sample of every line.
    """
    lines = [np.asarray(line, float) for line in lines]
    n = len(lines[0])
    bounds = [np.where(np.isnan(line), np.inf, sign * line) for line in lines for sign in (1, -1)]
    size = 2 * n // MOST
    while len(kept := _lowest(bounds, size)) > MOST and size < n:
        size += 1 + size // 8
    return kept


def _lowest(lines: list[np.ndarray], size: int) -> np.ndarray:
    """Indices of the first sample, the last, and each line's lowest in every bin of `size` samples."""
    n = len(lines[0])
    starts = np.arange(0, n, size)
    padding = (0, len(starts) * size - n)
    kept = [starts + np.pad(line, padding, constant_values=np.inf).reshape(-1, size).argmin(axis=1) for line in lines]
    return np.unique(np.concatenate([[0, n - 1], *kept]))
