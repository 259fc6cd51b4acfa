"""Common style of all figures: the palette, in which each colour has one meaning, and the labels.

The colours are Okabe and Ito's, which colour-blind readers can distinguish (jfly.uni-koeln.de/color).
"""

import re
from collections.abc import Iterable

import numpy as np
from plotly.colors import sample_colorscale

MEASURED = "#4d4d4d"
BEFORE = "#e08214"
AFTER = "#0072b2"
SET_POINT = "#8c8c8c"
FIT = "#111111"
FAINT = "#c4cad0"
LIGHT_BLUE = "#56b4e9"
NOISE = "rgba(77,77,77,0.14)"
VEIL = "rgba(0,114,178,0.16)"
BAND = "rgba(86,180,233,0.32)"
OTHERS = (AFTER, "#009e73", "#cc79a7", LIGHT_BLUE, "#882255", BEFORE)
"""Colours without a fixed meaning, in the order of use."""

SCHEME = {
    MEASURED: ("measured", "#c9d1d9"),
    BEFORE: ("before", "#f0a24d"),
    AFTER: ("after", "#4fb0ea"),
    SET_POINT: ("set-point", "#8f9aa6"),
    FIT: ("fit", "#f3f5f7"),
    FAINT: ("faint", "#4b5762"),
    LIGHT_BLUE: ("light-blue", "#a3d5f5"),
    NOISE: ("noise", "rgba(201,209,217,0.16)"),
    VEIL: ("veil", "rgba(79,176,234,0.22)"),
    BAND: ("band", "rgba(79,176,234,0.28)"),
    "#009e73": ("green", "#33c79d"),
    "#cc79a7": ("pink", "#e09cc4"),
    "#882255": ("wine", "#d8689f"),
}
"""Every colour of the figures, by its value on white: its name in the page's style, and its value on dark."""

_SEQUENCE = "Viridis", (0.25, 0.85)
"""Colours of an ordered sequence, and the part of them that is visible on white and on dark."""

ROLES = {
    "measured": MEASURED,
    "rig": MEASURED,
    "before": BEFORE,
    "start": BEFORE,
    "after": AFTER,
    "fitted": AFTER,
}
"""Words in a line's name that determine its colour."""

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
    "power": "power [W]",
}
"""Axis labels of the columns of a record."""

FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif'


def ink(colour: str) -> str:
    """A figure's colour in the page's style, light or dark; those of an ordered sequence are the same in both."""
    if colour.startswith("rgb("):
        return colour
    if colour not in SCHEME:
        raise ValueError(f"{colour} is in no scheme: it may be invisible on dark")
    return f"var(--{SCHEME[colour][0]})"


def shades(count: int) -> list[str]:
    """`count` ordered colours, from low to high."""
    name, (low, high) = _SEQUENCE
    return sample_colorscale(name, np.linspace(low, high, count).tolist())


def label(name: str) -> str:
    """The axis label "quantity [unit]" of a record's column; any other name must include its unit."""
    return LABELS.get(name, name)


def colours(names: Iterable[str]) -> dict[str, str]:
    """A colour for each name: by its first word with a fixed meaning (ROLES); if none or taken, the next free one."""
    given = {}
    for name in names:
        role = next((ROLES[word] for word in re.findall("[a-z]+", name.lower()) if word in ROLES), None)
        given[name] = None if role in given.values() else role
    free = [colour for colour in OTHERS if colour not in given.values()] or list(OTHERS)
    unnamed = [name for name, colour in given.items() if colour is None]
    return given | {name: free[k % len(free)] for k, name in enumerate(unnamed)}
