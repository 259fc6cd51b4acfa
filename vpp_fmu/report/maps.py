"""Figures of the static map: thrust over speed and pitch."""

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.digits import number
from vpp_fmu.report import style


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
