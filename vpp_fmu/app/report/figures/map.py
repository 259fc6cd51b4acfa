"""Figures of static relations: the map of thrust, its uncertainty, and the curve of an effect."""

from collections.abc import Mapping

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.app.report import style
from vpp_fmu.digits import number
from vpp_fmu.digits import number as digits


def map_lines(
    speeds: np.ndarray, pitches: np.ndarray, thrust: np.ndarray, points: tuple[np.ndarray, np.ndarray, np.ndarray], title: str
) -> go.Figure:
    """The map over pitch, one line per speed: thrust (m, n) [N] over speeds (m,) [rpm] and pitches (n,) [deg].

    `points`, measured: (speed [rpm], pitch [deg], thrust [N]), each (k,), in the colour of the nearest speed.
    """
    fig = style.figure(title, 520)
    omega, beta, measured = points
    nearest = np.argmin(np.abs(np.asarray(omega)[:, None] - speeds), axis=1)
    for k, (speed, line, shade) in enumerate(zip(speeds, thrust, style.shades(len(speeds)), strict=True)):
        name, own = f"{number(speed)} rpm", nearest == k
        shared = {"legendgroup": name, "name": name, "hovertemplate": f"%{{y:{style.SHOWN}}} N at {name}, %{{x:.1f}} deg"}
        fig.add_scatter(x=pitches, y=line, mode="lines", line={"color": shade, "width": 1.6}, **shared)
        fig.add_scatter(
            x=beta[own], y=measured[own], mode="markers", marker={"color": shade, "size": 6}, showlegend=False, **shared
        )
    fig.update_xaxes(title_text="pitch [deg]")
    fig.update_yaxes(title_text="thrust [N]")
    return fig


def map_section(
    at: np.ndarray,
    thrust: np.ndarray,
    points: tuple[np.ndarray, np.ndarray],
    title: str,
    label: str,
    std: np.ndarray,
) -> go.Figure:
    """The map along one command `at` (n,), whose axis is named `label`: thrust (n,) [N], with 1.96 `std` (n,) [N] as a band.

    `points`: (command, thrust [N]) as measured, each (k,).
    """
    fig = style.figure(title, 440)
    for side, more in ((-1.0, {}), (1.0, {"fill": "tonexty", "fillcolor": style.NOISE, "name": "95 % interval of the map"})):
        shared = {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip", "showlegend": bool(more)}
        fig.add_scatter(x=at, y=thrust + side * 1.96 * std, **shared, **more)
    fig.add_scatter(x=at, y=thrust, mode="lines", name="fitted", line={"color": style.AFTER, "width": 1.8})
    marker = {"size": 7, "color": style.MEASURED}
    hover = f"%{{y:{style.SHOWN}}} N at %{{x:{style.SHOWN}}}<extra></extra>"
    fig.add_scatter(x=points[0], y=points[1], mode="markers", name="measured", marker=marker, hovertemplate=hover)
    fig.update_xaxes(title_text=label)
    fig.update_yaxes(title_text="thrust [N]")
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
    fig = style.figure(title, 520, legend=False)
    fig.add_heatmap(
        x=speeds,
        y=pitches,
        z=grid,
        zmin=-largest,
        zmax=largest,
        colorscale=style.DIVERGING,
        colorbar={"title": {"text": "residual [N]"}},
        texttemplate=f"%{{z:+.{decimals}f}}" if len(speeds) <= 16 else None,
        textfont={"size": 11},
        xgap=1,
        ygap=1,
        hovertemplate=f"%{{z:+{style.SHOWN}}} N<br>%{{x:.0f}} rpm, %{{y:.1f}} deg<extra></extra>",
    )
    fig.update_xaxes(title_text="speed [rpm]", showgrid=False)
    fig.update_yaxes(title_text="pitch [deg]", showgrid=False)
    return fig


def thrust_coefficients(
    speeds: np.ndarray, pitches: np.ndarray, ct: np.ndarray, title: str, label: str = "C_T [-]"
) -> go.Figure:
    """A thrust coefficient over pitch, one line per speed: ct (m, k) over speeds (m,) [rpm] and pitches (k,) [deg].

    NaN where not measured. Colours go from slow to fast. `label`: of its axis.
    """
    fig = style.figure(title, 460)
    for speed, line, shade in zip(speeds, ct, style.shades(len(speeds)), strict=True):
        fig.add_scatter(
            x=pitches,
            y=line,
            mode="lines+markers",
            name=f"{speed:.0f} rpm",
            line={"color": shade, "width": 1.8},
            marker={"size": 5},
            hovertemplate=f"%{{y:{style.SHOWN}}} at {speed:.0f} rpm, %{{x:.1f}} deg<extra></extra>",
        )
    fig.update_xaxes(title_text="blade pitch [deg]")
    fig.update_yaxes(title_text=label)
    return fig


def mean_convergence(
    m: np.ndarray, std: np.ndarray, white: np.ndarray, title: str, wanted: tuple[int, float] | None = None
) -> go.Figure:
    """Standard deviation [N] of the mean of m readings: measured, and for independent readings; all (k,), log-log.

    `wanted`: a marked point (readings, standard deviation [N]); beyond the measured line it is extrapolated.
    """
    fig = style.figure(title, 400)
    hover = {"hovertemplate": "%{y:.2~g} N for %{x} readings<extra></extra>"}
    measured = {"color": style.MEASURED, "width": 2}
    fig.add_scatter(x=m, y=std, mode="lines+markers", name="measured", line=measured, marker={"size": 4}, **hover)
    line = {"color": style.AFTER, "width": 1.6, "dash": "dash"}
    fig.add_scatter(x=m, y=white, mode="lines", name="independent readings", line=line, **hover)
    if wanted is not None:
        number, good = wanted
        name, dotted = f"{digits(good, 2)} N at {number} readings", {"color": style.MEASURED, "width": 1.2, "dash": "dot"}
        far = number > m[-1]
        line = {"mode": "lines", "line": dotted, "showlegend": False, "hoverinfo": "skip"}
        fig.add_scatter(x=[m[-1], number] if far else [number], y=[std[-1], good] if far else [good], **line)
        marker = {"size": 10, "color": style.BEFORE, "symbol": "diamond"}
        fig.add_scatter(x=[number], y=[good], mode="markers", name=name, marker=marker, **hover)
    fig.update_xaxes(title_text="readings in the mean [-]", type="log", dtick="D2")
    fig.update_yaxes(title_text="standard deviation of the mean [N]", type="log", dtick="D2", tickformat="~g")
    return fig


def map_uncertainty(omega: np.ndarray, beta: np.ndarray, std_grid: np.ndarray, title: str) -> go.Figure:
    """Standard deviation of the map, std_grid (n, m) [N] over beta (n,) [deg] and omega (m,) [rpm]."""
    fig = style.figure(title, 460, legend=False)
    fig.add_heatmap(
        x=omega,
        y=beta,
        z=std_grid,
        zmin=0.0,
        zmax=float(np.max(std_grid)),  # plotly heeds the one with the other only
        colorscale=style.sequence(),
        colorbar={"title": {"text": "standard deviation [N]"}},
        hovertemplate=f"%{{z:{style.SHOWN}}} N<br>%{{x:.0f}} rpm, %{{y:.1f}} deg<extra></extra>",
    )
    fig.update_xaxes(title_text="speed [rpm]", showgrid=False)
    fig.update_yaxes(title_text="pitch [deg]", showgrid=False)
    return fig


def reached_against_commanded(
    commanded: np.ndarray, reached: Mapping[str, np.ndarray], title: str, quantity: str, unit: str
) -> go.Figure:
    """Static response, lines (n,) by name in the order of the sweep, over the command (n,)."""
    fig = style.figure(title, 440)
    colours = style.colours(reached)
    ends = [float(np.min(commanded)), float(np.max(commanded))]
    line = {"color": style.SET_POINT, "width": 1.4, "dash": "dot"}
    fig.add_scatter(x=ends, y=ends, mode="lines", name="as commanded", line=line, hoverinfo="skip")
    for name, values in reached.items():
        line = {"color": colours[name], "width": 1.8}
        fig.add_scatter(x=commanded, y=values, mode="lines", name=style.escaped(name), line=line)
    fig.update_xaxes(title_text=f"{quantity} commanded [{unit}]")
    fig.update_yaxes(title_text=f"{quantity} reached [{unit}]")
    return fig


def behind_against_before(before: np.ndarray, change: np.ndarray, time: np.ndarray, title: str) -> go.Figure:
    """Change of the thrust by an effect [N] over the thrust without it [N], coloured by the time [s]; all (n,)."""
    fig = style.figure(title, 440, legend=False)
    fig.add_scatter(
        x=before,
        y=change,
        mode="markers",
        marker={
            "size": 4,
            "color": time,
            "colorscale": style.sequence(),
            "showscale": True,
            "colorbar": {"title": {"text": "time [s]"}},
        },
        hovertemplate=f"%{{y:+{style.SHOWN}}} N at %{{x:{style.SHOWN}}} N<extra></extra>",
    )
    fig.update_xaxes(title_text="thrust without the effect [N]")
    fig.update_yaxes(title_text="change by the effect [N]", zeroline=True)
    return fig
