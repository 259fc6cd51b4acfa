"""Figures of static relations: the map of thrust, its uncertainty, and the curve of an effect."""

from collections.abc import Mapping

import numpy as np
from plotly import graph_objects as go

from identification.fit.uncertainty import NORMAL_95
from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import CELLS, add_envelope, add_line, add_points, figure, heatmap
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


def map_residuals(omega: np.ndarray, beta: np.ndarray, residual: np.ndarray, title: str) -> go.Figure:
    """Measured - map [N] at the points of a grid: arrays (k,) with omega [rpm] and beta [deg] as commanded.

    Points that the campaign does not have are empty.
    """
    speeds, column = np.unique(omega, return_inverse=True)
    pitches, row = np.unique(beta, return_inverse=True)
    grid = np.full((len(pitches), len(speeds)), np.nan)
    grid[row, column] = residual
    largest = float(np.nanmax(np.abs(grid))) or 1.0
    decimals = max(0, 1 - int(np.floor(np.log10(largest))))
    return heatmap(
        *(title, 520, speeds, pitches, grid, (-largest, largest), style.DIVERGING, (*_COMMANDS, "residual [N]")),
        texttemplate=f"%{{z:+.{decimals}f}}" if len(speeds) <= 16 else None,
        hovertemplate=f"%{{z:+{style.SHOWN}}} N<br>%{{x:.0f}} rpm, %{{y:.1f}} deg<extra></extra>",
        **CELLS,
    )


def map_uncertainty(omega: np.ndarray, beta: np.ndarray, std_grid: np.ndarray, title: str) -> go.Figure:
    """Standard deviation of the map, std_grid (n, m) [N] over beta (n,) [deg] and omega (m,) [rpm]."""
    ends = 0.0, float(np.max(std_grid))
    hover = f"%{{z:{style.SHOWN}}} N<br>%{{x:.0f}} rpm, %{{y:.1f}} deg<extra></extra>"
    labels = *_COMMANDS, "standard deviation [N]"
    return heatmap(title, 460, omega, beta, std_grid, ends, style.sequence(), labels, hovertemplate=hover)


def thrust_coefficients(
    speeds: np.ndarray, pitches: np.ndarray, ct: np.ndarray, title: str, label: str = "C_T [-]"
) -> go.Figure:
    """A thrust coefficient over pitch, one line per speed: ct (m, k) over speeds (m,) [rpm] and pitches (k,) [deg].

    NaN where not measured. Colours go from slow to fast. `label`: of its axis.
    """
    fig = figure(title, 460, "blade pitch [deg]", label)
    for speed, line, shade in zip(speeds, ct, style.shades(len(speeds)), strict=True):
        hover = f"%{{y:{style.SHOWN}}} at {speed:.0f} rpm, %{{x:.1f}} deg<extra></extra>"
        more = {"mode": "lines+markers", "marker": {"size": 5}, "hovertemplate": hover}
        add_line(fig, pitches, line, f"{speed:.0f} rpm", shade, **more)
    return fig


def mean_convergence(
    m: np.ndarray, std: np.ndarray, white: np.ndarray, title: str, wanted: tuple[int, float] | None = None
) -> go.Figure:
    """Standard deviation [N] of the mean of m readings: measured, and for independent readings; all (k,), log-log.

    `wanted`: a marked point (readings, standard deviation [N]); beyond the measured line it is extrapolated.
    """
    fig = figure(title, 400, "readings in the mean [-]", "standard deviation of the mean [N]")
    hover = {"hovertemplate": "%{y:.2~g} N for %{x} readings<extra></extra>"}
    add_line(fig, m, std, "measured", style.MEASURED, 2, mode="lines+markers", marker={"size": 4}, **hover)
    add_line(fig, m, white, "independent readings", style.AFTER, 1.6, dash="dash", **hover)
    if wanted is not None:
        count, good = wanted
        x, y = ([m[-1], count], [std[-1], good]) if count > m[-1] else ([count], [good])
        add_line(fig, x, y, "", style.MEASURED, 1.2, dash="dot", showlegend=False, hoverinfo="skip")
        add_points(fig, [count], [good], f"{number(good, 2)} N at {count} readings", style.BEFORE, 10, "diamond", **hover)
    fig.update_xaxes(type="log", dtick="D2")
    fig.update_yaxes(type="log", dtick="D2", tickformat="~g")
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
