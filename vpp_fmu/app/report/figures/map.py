"""Figures of static relations: the map of thrust, the curve of an effect, and the power."""

from collections.abc import Mapping

import numpy as np
from plotly import graph_objects as go

from identification.fit.uncertainty import NORMAL_95
from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import add_envelope, add_line, add_points, figure, heatmap
from vpp_fmu.digits import number

_COMMANDS = "speed [rpm]", "pitch [deg]"


def map_lines(
    speeds: np.ndarray, pitches: np.ndarray, thrust: np.ndarray, points: tuple[np.ndarray, np.ndarray, np.ndarray], title: str
) -> go.Figure:
    """The map over pitch, one line per speed: thrust (m, n) [N] over speeds (m,) [rpm] and pitches (n,) [deg].

    `points`, measured: (speed [rpm], pitch [deg], thrust [N]), each (k,), in the colour of the nearest speed.
    """
    fig = figure(title, 520, "pitch [deg]", "thrust [N]")
    omega, beta, measured = points
    nearest = np.argmin(np.abs(np.asarray(omega)[:, None] - speeds), axis=1)
    for k, (speed, line, shade) in enumerate(zip(speeds, thrust, style.shades(len(speeds)), strict=True)):
        name, own = f"{number(speed)} rpm", nearest == k
        shared = {"legendgroup": name, "hovertemplate": f"%{{y:{style.SHOWN}}} N at {name}, %{{x:.1f}} deg"}
        add_line(fig, pitches, line, name, shade, 1.6, **shared)
        add_points(fig, beta[own], measured[own], name, shade, showlegend=False, **shared)
    return fig


def map_section(
    at: np.ndarray, thrust: np.ndarray, points: tuple[np.ndarray, np.ndarray], title: str, label: str, std: np.ndarray
) -> go.Figure:
    """The map along one command `at` (n,), whose axis is named `label`: thrust (n,) [N], with 1.96 `std` (n,) [N] as a band.

    `points`: (command, thrust [N]) as measured, each (k,).
    """
    fig = figure(title, 440, label, "thrust [N]")
    add_envelope(fig, at, thrust - NORMAL_95 * std, thrust + NORMAL_95 * std, "95 % interval of the map", style.NOISE)
    add_line(fig, at, thrust, "fitted", style.AFTER)
    hover = f"%{{y:{style.SHOWN}}} N at %{{x:{style.SHOWN}}}<extra></extra>"
    add_points(fig, *points, "measured", style.MEASURED, 7, hovertemplate=hover)
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


def behind_against_before(before: np.ndarray, change: np.ndarray, time: np.ndarray, title: str) -> go.Figure:
    """Change of the thrust by an effect [N] over the thrust without it [N], coloured by the time [s]; all (n,)."""
    fig = figure(title, 440, "thrust without the effect [N]", "change by the effect [N]", legend=False)
    scale = {"colorscale": style.sequence(), "showscale": True, "colorbar": {"title": {"text": "time [s]"}}}
    hover = f"%{{y:+{style.SHOWN}}} N at %{{x:{style.SHOWN}}} N<extra></extra>"
    fig.add_scatter(x=before, y=change, mode="markers", marker={"size": 4, "color": time, **scale}, hovertemplate=hover)
    fig.update_yaxes(zeroline=True)
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
    power: np.ndarray,
    thrust: np.ndarray,
    lines: np.ndarray,
    pairs: tuple[np.ndarray, np.ndarray],
    title: str,
) -> go.Figure:
    """Power (k, m) [W] over speeds (m,) [rpm] and pitches (k,) [deg], contours of the `thrust` (k, m) at the levels `lines`
    [N], and the best `pairs`, (speed, pitch), each (n,)."""
    ends = float(power.min()), float(power.max())
    hover = f"%{{z:{style.SHOWN}}} W<br>%{{x:.0f}} rpm, %{{y:.1f}} deg<extra></extra>"
    fig = heatmap(title, 520, speeds, pitches, power, ends, style.sequence(), (*_COMMANDS, "power [W]"), hovertemplate=hover)
    for level in lines:
        omega = [np.interp(level, row, speeds, left=np.nan, right=np.nan) for row in np.maximum.accumulate(thrust, axis=1)]
        add_line(fig, omega, pitches, f"{number(level, 3)} N", style.FIT, 1.0, hoverinfo="name")
    add_line(fig, *pairs, "best pairs", style.BEFORE, 3.0, hovertemplate="%{x:.0f} rpm, %{y:.1f} deg<extra></extra>")
    return fig
