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
NOISE = "#cfd8dc"
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
    "title": {"standoff": 8},
    "hoverformat": ".5~g",
}

TEMPLATE = go.layout.Template(
    layout={
        "font": {"family": FONT, "size": 13, "color": _INK},
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "colorway": OTHERS,
        "xaxis": _AXIS,
        "yaxis": _AXIS,
        "hoverlabel": {"bgcolor": "rgba(255,255,255,0.94)", "bordercolor": "#9aa5b1", "font": {"size": 12}},
        "modebar": {"bgcolor": "rgba(255,255,255,0.9)", "color": "#9aa5b1", "activecolor": AFTER},
    }
)


def label(name: str) -> str:
    """The axis label "quantity [unit]" of a record's column; any other name must bring its unit itself."""
    return LABELS.get(name, escaped(name))


def escaped(text: str) -> str:
    """`text` as plotly shows it to the letter: it would read tags, links among them, in any label."""
    return html.escape(str(text), quote=False)


def colours(names: Iterable[str]) -> dict[str, str]:
    """A colour a name: by its first word with a fixed meaning (ROLES), otherwise the next one still free."""
    given = {}
    for name in names:
        words = re.findall("[a-z]+", name.lower())
        given[name] = next((ROLES[word] for word in words if word in ROLES), None)
    free = [colour for colour in OTHERS if colour not in given.values()] or list(OTHERS)
    unnamed = [name for name, colour in given.items() if colour is None]
    return given | {name: free[k % len(free)] for k, name in enumerate(unnamed)}


def figure(title: str, height: int, legend: bool = True) -> go.Figure:
    """An empty figure `height` px high, as wide as its place; the title wraps, the legend's row stands below it."""
    lines = textwrap.wrap(title, 100) or [""]
    below_title = 14 + 21 * len(lines)
    return go.Figure(
        layout={
            "template": TEMPLATE,
            "height": height,
            "title": {
                "text": "<br>".join(f"<b>{escaped(line)}</b>" for line in lines),
                "font": {"size": 15},
                "x": 0.0,
                "xref": "container",
                "xanchor": "left",
                "y": 1.0,
                "yref": "container",
                "yanchor": "top",
                "pad": {"t": 8},
            },
            "showlegend": legend,
            "legend": {
                "orientation": "h",
                "x": 0.0,
                "xref": "container",
                "y": 1.0 - below_title / height,
                "yref": "container",
                "yanchor": "top",
                "bgcolor": "rgba(0,0,0,0)",
            },
            "margin": {"l": 64, "r": 16, "t": below_title + (34 if legend else 10), "b": 48},
        }
    )
