"""Figures of the static characterisation: thrust coefficient, convergence of means, uncertainty of the map."""

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.digits import number as digits
from vpp_fmu.report import style


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
