"""Figures of the static map: thrust over speed and pitch."""

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.report import style


def map_surface(
    omega: np.ndarray, beta: np.ndarray, thrust_grid: np.ndarray, points: tuple[np.ndarray, np.ndarray, np.ndarray], title: str
) -> go.Figure:
    """The map as a surface, thrust_grid (n, m) [N] over beta (n,) [deg] and omega (m,) [rpm], and the measured points on it.

    `points` are (omega [rpm], beta [deg], thrust [N]), each (k,).
    """
    fig = style.figure(title, 620)
    fig.add_surface(
        x=omega,
        y=beta,
        z=thrust_grid,
        colorscale="Viridis",
        opacity=0.85,
        colorbar={"title": {"text": "thrust [N]"}, "len": 0.7},
        contours={"z": {"show": True, "color": "rgba(255,255,255,0.6)", "width": 1}},
        hovertemplate=f"model %{{z:{style.SHOWN}}} N<br>%{{x:.0f}} rpm, %{{y:.1f}} deg<extra></extra>",
    )
    x, y, z = points
    fig.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode="markers",
        marker={"size": 3.5, "color": "#111111"},
        hovertemplate=f"measured %{{z:{style.SHOWN}}} N<br>%{{x:.0f}} rpm, %{{y:.1f}} deg<extra></extra>",
        name="measured",
        showlegend=True,
    )
    axes = {"xaxis": "speed [rpm]", "yaxis": "pitch [deg]", "zaxis": "thrust [N]"}
    scene = {axis: {"title": {"text": text}} for axis, text in axes.items()}
    camera = {"eye": {"x": -1.4, "y": -1.4, "z": 0.8}, "center": {"x": 0, "y": 0, "z": -0.2}}
    fig.update_layout(scene=scene | {"camera": camera, "aspectratio": {"x": 1.2, "y": 1.2, "z": 0.8}})
    fig.update_layout(margin={"l": 0, "r": 0, "b": 0})
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

    Points that the campaign left out stay empty.
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
