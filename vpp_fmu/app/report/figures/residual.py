"""Figures of the residual: correlations and spectrum."""

from collections.abc import Mapping

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import add_band, add_line, figure, panels


def correlations(lags_s: np.ndarray, rows: Mapping[str, Mapping[str, np.ndarray]], band: float, title: str) -> go.Figure:
    """A panel for each of the `rows`, named by the signal that is correlated with the residual: lines (n,) by name over the lag
    [s]. Correlations within +-band are not significant."""
    fig = panels(title, [f"{name} [-]" for name in rows], [110] * len(rows))
    colours = style.colours(next(iter(rows.values())))
    for panel, (row, lines) in enumerate(rows.items()):
        for name, values in lines.items():
            shown, group = (f"{name}, {row}", name) if panel else (name, None)
            add_line(fig, lags_s, np.round(values, 4), shown, colours[name], 1.6, panel, group)
        add_band(fig, panel, band, f"± {band:.2g}: no evidence")
        fig.layout.shapes[panel].showlegend = panel == 0
    fig.update_xaxes(title_text="lag [s]", hoverformat=".2f")
    return fig


def residual_spectrum(frequency: np.ndarray, power: Mapping[str, np.ndarray], noise: np.ndarray, title: str) -> go.Figure:
    """Power density [N^2/Hz] of residuals by name and of the noise, all (n,), over the frequency [Hz]; NaN: no value."""
    fig = figure(title, 420, "frequency [Hz]", "power density [N²/Hz]")
    hover = {"hovertemplate": "%{y:.2e} N²/Hz at %{x:.2f} Hz"}
    add_line(fig, frequency, noise, "noise of one reading", style.MEASURED, 1.6, dash="dash", **hover)
    colours = style.colours(power)
    for name, values in power.items():
        add_line(fig, frequency, values, name, colours[name], mode="lines+markers", marker={"size": 6}, **hover)
    fig.update_layout(xaxis_type="log", yaxis_type="log")
    return fig
