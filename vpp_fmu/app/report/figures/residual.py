"""Figures of the residual: correlations, spectrum, error by section, and means after moves of the commands."""

from collections.abc import Mapping, Sequence

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import add_band, add_ground, add_level, add_line, add_points, figure, panels
from vpp_fmu.digits import number


def residual_by_section(
    labels: Sequence[str], before: np.ndarray, after: np.ndarray, noise: float | None, title: str
) -> go.Figure:
    """The rmse [N] of each section before and after, both (n,), with a line for the noise alone."""
    sections = [style.escaped(label) for label in labels]
    fig = figure(title, 380, y="rmse [N]")
    shown = {"texttemplate": "%{y:.3r}", "textposition": "outside", "cliponaxis": False}
    for name, values, colour in (("before", before, style.BEFORE), ("after", after, style.AFTER)):
        hover = f"%{{y:{style.SHOWN}}} N"
        fig.add_bar(x=sections, y=values, name=name, marker_color=colour, hovertemplate=hover, **shown)
    if noise is not None:
        add_level(fig, noise, f"noise alone, {number(noise)} N")
    fig.update_xaxes(type="category")
    fig.update_yaxes(rangemode="tozero")
    fig.update_layout(barmode="group", bargap=0.3, bargroupgap=0.06, hovermode="x unified")
    return fig


def autocorrelation(lags_s: np.ndarray, values: np.ndarray, band: float, title: str) -> go.Figure:
    """The residual's autocorrelation (n,) over the lag [s]; within +-band it is consistent with white noise."""
    fig = _correlation({"residual": values}, lags_s, band, title, "autocorrelation [-]")
    fig.update_traces(fill="tozeroy", fillcolor=style.VEIL)
    return fig


def cross_correlation(lags_s: np.ndarray, inputs: Mapping[str, np.ndarray], band: float, title: str) -> go.Figure:
    """The residual's correlation with each input (n,) over the lag [s]; a peak beyond +-band shows a missing effect."""
    return _correlation(inputs, lags_s, band, title, "cross-correlation [-]")


def _correlation(lines: Mapping[str, np.ndarray], lags_s: np.ndarray, band: float, title: str, label: str) -> go.Figure:
    fig = figure(title, 340, "lag [s]", label)
    add_ground(fig, band, _no_evidence(band))
    colours = style.colours(lines)
    for name, values in lines.items():
        add_line(fig, lags_s, values, style.label(name).partition(" [")[0], colours[name], 1.6)
    fig.update_xaxes(zeroline=True)
    fig.update_yaxes(zeroline=True)
    fig.update_layout(hovermode="x unified")
    return fig


def correlations(lags_s: np.ndarray, rows: Mapping[str, Mapping[str, np.ndarray]], band: float, title: str) -> go.Figure:
    """A panel for each of the `rows`, named by the signal that is correlated with the residual: lines (n,) by name over the lag
    [s]. Correlations within +-band are not significant."""
    fig = panels(title, [f"{name} [-]" for name in rows], [110] * len(rows))
    colours = style.colours(next(iter(rows.values())))
    for panel, (row, lines) in enumerate(rows.items()):
        for name, values in lines.items():
            shown, group = (f"{name}, {row}", name) if panel else (name, None)
            add_line(fig, lags_s, np.round(values, 4), shown, colours[name], 1.6, panel, group)
        add_band(fig, panel, band, _no_evidence(band))
        fig.layout.shapes[panel].showlegend = panel == 0
    fig.update_xaxes(title_text="lag [s]", hoverformat=".2f")
    return fig


def _no_evidence(band: float) -> str:
    return f"± {band:.2g}: no evidence"


def residual_spectrum(frequency: np.ndarray, power: Mapping[str, np.ndarray], noise: np.ndarray, title: str) -> go.Figure:
    """Power density [N^2/Hz] of residuals by name and of the noise, all (n,), over the frequency [Hz]; NaN: no value."""
    fig = figure(title, 420, "frequency [Hz]", "power density [N²/Hz]")
    hover = {"hovertemplate": "%{y:.2e} N²/Hz at %{x:.2f} Hz"}
    add_line(fig, frequency, noise, "noise of one reading", style.MEASURED, 1.6, dash="dash", **hover)
    colours = style.colours(power)
    for name, values in power.items():
        add_line(fig, frequency, values, name, colours[name], mode="lines+markers", marker={"size": 6}, **hover)
    fig.update_xaxes(type="log", dtick="D2")
    fig.update_yaxes(type="log", dtick=1, tickformat=".0e")
    return fig


def residual_by_move(
    size: np.ndarray,
    reversed_before: np.ndarray,
    residuals: Mapping[str, np.ndarray],
    title: str,
    label: str,
    noise: float | None = None,
) -> go.Figure:
    """Mean residual [N] after each move of a command, by name, over the move's size; all (n,).

    `label` is the axis label of the size with its unit. `reversed_before`: whether the move is opposite to the one before; such
    moves are open diamonds. `noise`: standard deviation [N] of such a mean from noise alone.
    """
    fig = figure(title, 400, label, "mean residual after it [N]")
    colours = style.colours(residuals)
    turned = np.asarray(reversed_before, bool)
    hover = f"%{{y:+{style.SHOWN}}} N after a move of %{{x:+{style.SHOWN}}}"
    for name, values in residuals.items():
        for kind, chosen, symbol in (("onwards", ~turned, "circle"), ("reversed", turned, "diamond-open")):
            x, y = np.asarray(size)[chosen], np.asarray(values)[chosen]
            add_points(fig, x, y, f"{name}, {kind}", colours[name], 7, symbol, opacity=0.8, hovertemplate=hover)
    if noise is not None:
        add_ground(fig, 2 * noise, f"± 2 noise ({number(2 * noise)} N)")
    fig.update_traces(marker_line_width=1.4)
    fig.update_xaxes(zeroline=True)
    fig.update_yaxes(zeroline=True)
    fig.update_layout(hovermode="closest")
    return fig
