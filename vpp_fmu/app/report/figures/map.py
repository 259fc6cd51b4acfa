"""Figures of static relations: the map of thrust, the curve of an effect, and the power."""

from collections.abc import Mapping

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import add_envelope, add_line, add_points, figure
from vpp_fmu.digits import number


def map_lines(
    at: np.ndarray,
    lines: Mapping[float, np.ndarray],
    points: tuple[np.ndarray, np.ndarray, np.ndarray],
    title: str,
    label: str,
    unit: str,
) -> go.Figure:
    """The map along one command `at` (n,), whose axis is named `label`: thrust (n,) [N] by the value of the other command, in
    `unit`.

    `points`, measured: (the one command, the other, thrust [N]), each (k,), in the colour of the nearest line.
    """
    fig = figure(title, 520, label, "thrust [N]")
    along, beside, measured = points
    levels = np.array(list(lines))
    nearest = np.argmin(np.abs(np.asarray(beside)[:, None] - levels), axis=1)
    for k, (level, shade) in enumerate(zip(levels, style.shades(len(levels)), strict=True)):
        name, own = f"{number(float(level))} {unit}", nearest == k
        shared = {"legendgroup": name, "hovertemplate": f"%{{y:{style.SHOWN}}} N at {name}, %{{x:{style.SHOWN}}}"}
        add_line(fig, at, lines[level], name, shade, 1.6, **shared)
        add_points(fig, along[own], measured[own], name, shade, showlegend=False, **shared)
    return fig


def reached_against_commanded(
    commanded: np.ndarray, reached: Mapping[str, np.ndarray], title: str, quantity: str, unit: str
) -> go.Figure:
    """Static response, lines (n,) by name in the order of the sweep, over the command (n,)."""
    fig = figure(title, 440, f"{quantity} commanded [{unit}]", f"{quantity} reached [{unit}]")
    colours = style.colours(reached)
    ends = [float(np.min(commanded)), float(np.max(commanded))]
    add_line(fig, ends, ends, "as commanded", style.SET_POINT, 1.4, dash="dot", hoverinfo="skip")
    for name, values in reached.items():
        add_line(fig, commanded, values, name, colours[name])
    return fig


def least_power(
    thrust: np.ndarray, power: np.ndarray, half: np.ndarray, others: Mapping[str, np.ndarray], title: str
) -> go.Figure:
    """Least power (n,) [W] over thrust (n,) [N] with a band of +-`half` (n,) [W]; `others` (n,) [W] by name, NaN where none."""
    fig = figure(title, 440, "thrust [N]", "power [W]")
    hover = {"hovertemplate": f"%{{y:{style.SHOWN}}} W at %{{x:{style.SHOWN}}} N<extra></extra>"}
    add_envelope(fig, thrust, power - half, power + half, "95 % interval", style.NOISE)
    for name, values in others.items():
        add_line(fig, thrust, values, name, style.BEFORE, 1.6, dash="dash", **hover)
    add_line(fig, thrust, power, "best pairs", style.AFTER, 2.2, **hover)
    return fig


def best_pairs(
    speeds: np.ndarray,
    pitches: np.ndarray,
    equal: Mapping[str, tuple[np.ndarray, np.ndarray, str]],
    pairs: tuple[np.ndarray, np.ndarray],
    title: str,
) -> go.Figure:
    """Lines of equal values over speed (m,) [rpm] and pitch (k,) [deg], and the best `pairs`, (speed, pitch), each (n,).

    `equal`: by name (values (k, m), levels, unit); the values increase with the speed.
    """
    fig = figure(title, 520, "speed [rpm]", "pitch [deg]")
    colours = dict(zip(equal, (style.MEASURED, style.LIGHT_BLUE), strict=True))
    for name, (values, levels, unit) in equal.items():
        for k, level in enumerate(levels):
            omega = [np.interp(level, row, speeds, left=np.nan, right=np.nan) for row in np.maximum.accumulate(values, axis=1)]
            told = {"hovertemplate": f"{name} {number(float(level), 3)} {unit}"}
            add_line(fig, omega, pitches, f"equal {name}", colours[name], 1.2, group=f"equal {name}" if k else None, **told)
    add_line(fig, *pairs, "best pairs", style.BEFORE, 3.0, hovertemplate="%{x:.0f} rpm, %{y:.1f} deg<extra></extra>")
    return fig
