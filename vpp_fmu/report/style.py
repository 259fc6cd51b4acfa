"""What every figure shares: the palette, where each colour has one meaning, the plotly template, and the labels.

The colours are Okabe and Ito's, told apart by colour-blind readers (jfly.uni-koeln.de/color).
"""

import html
import re
import textwrap
from collections.abc import Iterable

from plotly import graph_objects as go

MEASURED = "#4d4d4d"
BEFORE = "#e08214"
AFTER = "#0072b2"
SET_POINT = "#8c8c8c"
NOISE = "rgba(77,77,77,0.14)"
OTHERS = (AFTER, "#009e73", "#cc79a7", "#56b4e9", "#882255", BEFORE)
"""Colours of what has no fixed meaning, in the order they are given out."""

DIVERGING = ((0.0, AFTER), (0.25, "#8fc1dd"), (0.5, "#fbfbfb"), (0.75, "#f0c08c"), (1.0, "#b35806"))
"""Negative to positive, white at zero."""

ROLES = {
    "measured": MEASURED,
    "rig": MEASURED,
    "before": BEFORE,
    "initial": BEFORE,
    "start": BEFORE,
    "base": BEFORE,
    "after": AFTER,
    "final": AFTER,
    "fitted": AFTER,
    "augmented": AFTER,
}
"""Words in the name of a line that fix its colour."""

LABELS = {
    "time": "time [s]",
    "thrust": "thrust [N]",
    "thrust_set": "set-point [N]",
    "omega": "speed [rpm]",
    "omega_ref": "speed command [rpm]",
    "beta": "pitch [deg]",
    "beta_ref": "pitch command [deg]",
    "voltage": "voltage [V]",
    "current": "current [A]",
}
"""Axis labels of the columns of a record."""

FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif'
_INK = "#1f2933"
_GRID = "#e8ecef"
_AXIS = {
    "showline": True,
    "linecolor": "#9aa5b1",
    "gridcolor": _GRID,
    "zeroline": False,
    "ticks": "outside",
    "ticklen": 4,
    "tickcolor": "#9aa5b1",
    "automargin": True,
    "title": {"standoff": 8, "font": {"size": 13}},
    "hoverformat": ".5~g",
    "exponentformat": "none",  # else 20000 rpm are "20k", and a tenth of a millinewton "100μ"
}

SHOWN = ".4~r"
"""How d3 writes a measured quantity under the pointer: four significant digits, whatever the rig's size."""

_WIDEST = 80
"""Letters in a line of a title: what A4 holds at its size."""

_SPATIAL_AXIS = {
    "title": {"font": {"size": 13}},
    "tickfont": {"size": 11},
    "backgroundcolor": "white",
    "gridcolor": "#dde3e8",
    "exponentformat": "none",
}
_COLOUR_BAR = {"thickness": 14, "exponentformat": "none", "title": {"font": {"size": 13}}}

TEMPLATE = go.layout.Template(
    layout={
        "font": {"family": FONT, "size": 13, "color": _INK},
        "separators": ".",  # a point before decimals, nothing between thousands: as in the text around
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "colorway": OTHERS,
        "xaxis": _AXIS,
        "yaxis": _AXIS,
        "hoverlabel": {"bgcolor": "rgba(255,255,255,0.94)", "bordercolor": "#9aa5b1", "font": {"size": 12}, "namelength": -1},
        "scene": dict.fromkeys(("xaxis", "yaxis", "zaxis"), _SPATIAL_AXIS),
        "modebar": {"bgcolor": "rgba(255,255,255,0.9)", "color": "#9aa5b1", "activecolor": AFTER},
    },
    data={kind: [{"colorbar": _COLOUR_BAR}] for kind in ("heatmap", "surface")},
)


def label(name: str) -> str:
    """The axis label "quantity [unit]" of a record's column; any other name must bring its unit itself."""
    return LABELS.get(name, escaped(name))


def escaped(text: str) -> str:
    """`text` as plotly shows it to the letter: it would read tags, links among them, in any label."""
    return html.escape(str(text), quote=False)


def colours(names: Iterable[str]) -> dict[str, str]:
    """A colour a name: by its first word with a fixed meaning (ROLES), if none or taken the next one still free."""
    given = {}
    for name in names:
        role = next((ROLES[word] for word in re.findall("[a-z]+", name.lower()) if word in ROLES), None)
        given[name] = None if role in given.values() else role
    free = [colour for colour in OTHERS if colour not in given.values()] or list(OTHERS)
    unnamed = [name for name, colour in given.items() if colour is None]
    return given | {name: free[k % len(free)] for k, name in enumerate(unnamed)}


def figure(title: str, height: int, legend: bool = True) -> go.Figure:
    """An empty figure `height` px high, as wide as its place; the title wraps, the legend's row stands below it."""
    lines = _lines(title)
    below_title = 14 + 21 * len(lines)
    corner = {"x": 0.0, "xref": "container", "xanchor": "left", "yref": "container", "yanchor": "top"}
    return go.Figure(
        layout={
            "template": TEMPLATE,
            "height": height,
            "title": {
                "text": "<br>".join(f"<b>{escaped(line)}</b>" for line in lines),
                "font": {"size": 15},
                "y": 1.0,
                # plotly forgets to lower a title of several lines by the height of a capital.
                "pad": {"t": 8 if len(lines) < 2 else 19},
                **corner,
            },
            "showlegend": legend,
            "legend": {"orientation": "h", "y": 1.0 - below_title / height, "bgcolor": "rgba(0,0,0,0)", **corner},
            "margin": {"l": 64, "r": 24, "t": below_title + (34 if legend else 10), "b": 48},
        }
    )


def _lines(title: str) -> list[str]:
    """The title in as few lines as a page of A4 takes, of much the same length."""
    fewest = len(textwrap.wrap(title, _WIDEST))
    return next(
        (lines for width in range(24, _WIDEST) if len(lines := textwrap.wrap(title, width)) == fewest),
        textwrap.wrap(title, _WIDEST),
    )
