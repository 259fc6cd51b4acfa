"""Figures of the residual: correlations, spectrum, error by section, and means after moves of the commands."""

from collections.abc import Mapping, Sequence

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import add_band, add_line, panels
from vpp_fmu.digits import number


def residual_by_section(
    labels: Sequence[str], before: np.ndarray, after: np.ndarray, noise: float | None, title: str
) -> go.Figure:
    """The rmse [N] of each section before and after, both (n,), with a line for the noise alone."""
    sections = [style.escaped(label) for label in labels]
    fig = style.figure(title, 380)
    for name, values, colour in (("before", before, style.BEFORE), ("after", after, style.AFTER)):
        fig.add_bar(
            x=sections,
            y=values,
            name=name,
            marker_color=colour,
            texttemplate="%{y:.3r}",
            textposition="outside",
            cliponaxis=False,
            hovertemplate=f"%{{y:{style.SHOWN}}} N",
        )
    if noise is not None:
        fig.add_hline(
            y=noise,
            line={"color": style.MEASURED, "width": 1.6, "dash": "dash"},
            name=f"noise alone, {number(noise)} N",
            showlegend=True,
        )
    fig.update_xaxes(title_text="section [-]", type="category")
    fig.update_yaxes(title_text="rmse [N]", rangemode="tozero")
    fig.update_layout(barmode="group", bargap=0.3, bargroupgap=0.06, hovermode="x unified")
    return fig


def residual_histogram(
    residual: np.ndarray, noise_std: float, title: str, quantity: str = "residual", unit: str = "N"
) -> go.Figure:
    """The density of the residual (n,) against the Gaussian of the noise floor, both in `unit`."""
    residual = np.asarray(residual, float)
    residual = residual[np.isfinite(residual)]
    largest = max(float(np.abs(residual).max()), 4 * noise_std)
    # Bins of a quarter of the noise show its shape; a screen resolves a few hundred of them.
    bins = min(2 * int(np.ceil(4 * largest / noise_std)), 300)
    density, edges = np.histogram(residual, bins=bins, range=(-largest, largest), density=True)
    centres, width = (edges[1:] + edges[:-1]) / 2, edges[1] - edges[0]
    fig = style.figure(title, 360)
    fig.add_bar(
        x=centres,
        y=density,
        width=width,
        name=f"residual, std {number(residual.std())} {unit}",
        marker_color=style.AFTER,
        opacity=0.75,
    )
    x = np.linspace(-largest, largest, 401)
    bell = np.exp(-((x / noise_std) ** 2) / 2) / (noise_std * np.sqrt(2 * np.pi))
    fig.add_scatter(
        x=x,
        y=bell,
        mode="lines",
        name=f"noise alone, std {number(noise_std)} {unit}",
        line={"color": style.MEASURED, "width": 2},
    )
    fig.update_xaxes(title_text=f"{quantity} [{unit}]")
    fig.update_yaxes(title_text=f"density [1/{unit}]", rangemode="tozero")
    fig.update_layout(bargap=0)
    return fig


def autocorrelation(lags_s: np.ndarray, values: np.ndarray, band: float, title: str) -> go.Figure:
    """The residual's autocorrelation (n,) over the lag [s]; within +-band it is consistent with white noise."""
    fig = _correlation({"residual": values}, lags_s, band, title, "autocorrelation [-]")
    fig.update_traces(fill="tozeroy", fillcolor=style.VEIL, selector={"name": "residual"})
    return fig


def cross_correlation(lags_s: np.ndarray, inputs: Mapping[str, np.ndarray], band: float, title: str) -> go.Figure:
    """The residual's correlation with each input (n,) over the lag [s]; a peak beyond +-band shows a missing effect."""
    return _correlation(inputs, lags_s, band, title, "cross-correlation [-]")


def _correlation(lines: Mapping[str, np.ndarray], lags_s: np.ndarray, band: float, title: str, label: str) -> go.Figure:
    """Correlations over the lag [s], with their band."""
    fig = style.figure(title, 340)
    fig.add_hrect(
        -band, band, fillcolor=style.NOISE, line_width=0, layer="below", name=f"± {band:.2g}: no evidence", showlegend=True
    )
    colours = style.colours(lines)
    for name, values in lines.items():
        fig.add_scatter(x=lags_s, y=values, mode="lines", name=style.label(name), line={"color": colours[name], "width": 1.6})
    fig.update_xaxes(title_text="lag [s]", zeroline=True)
    fig.update_yaxes(title_text=label, zeroline=True)
    fig.update_layout(hovermode="x unified")
    return fig


def correlations(lags_s: np.ndarray, rows: Mapping[str, Mapping[str, np.ndarray]], band: float, title: str) -> go.Figure:
    """A panel for each of the `rows`, named by the signal that is correlated with the residual: lines (n,) by name over the lag
    [s].

    Correlations within +-band are not significant.
    """
    fig = panels(title, [f"{name} [-]" for name in rows], [110] * len(rows))
    colours = style.colours(next(iter(rows.values())))
    for panel, (row, lines) in enumerate(rows.items()):
        for name, values in lines.items():
            group = name if panel else None
            line = {"color": colours[name], "width": 1.6}
            add_line(fig, panel, lags_s, np.round(values, 4), name if panel == 0 else f"{name}, {row}", line, group)
        add_band(fig, panel, band, f"± {band:.2g}: no evidence")
        fig.layout.shapes[panel].showlegend = panel == 0
    fig.update_xaxes(title_text="lag [s]", hoverformat=".2f")
    return fig


def residual_spectrum(frequency: np.ndarray, power: Mapping[str, np.ndarray], noise: np.ndarray, title: str) -> go.Figure:
    """Power density [N^2/Hz] of residuals by name and of the noise, all (n,), over the frequency [Hz]; NaN: no value."""
    fig = style.figure(title, 420)
    hover = {"hovertemplate": "%{y:.2e} N²/Hz at %{x:.2f} Hz"}
    line = {"color": style.MEASURED, "width": 1.6, "dash": "dash"}
    fig.add_scatter(x=frequency, y=noise, mode="lines", name="noise of one reading", line=line, **hover)
    colours = style.colours(power)
    for name, values in power.items():
        line = {"color": colours[name], "width": 1.8}
        marker = {"size": 6}
        fig.add_scatter(
            x=frequency, y=values, mode="lines+markers", name=style.escaped(name), line=line, marker=marker, **hover
        )
    fig.update_xaxes(title_text="frequency [Hz]", type="log", dtick="D2")
    fig.update_yaxes(title_text="power density [N²/Hz]", type="log", dtick=1, tickformat=".0e")
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
    fig = style.figure(title, 400)
    colours = style.colours(residuals)
    turned = np.asarray(reversed_before, bool)
    for name, values in residuals.items():
        for kind, chosen, symbol in (("onwards", ~turned, "circle"), ("reversed", turned, "diamond-open")):
            fig.add_scatter(
                x=np.asarray(size)[chosen],
                y=np.asarray(values)[chosen],
                mode="markers",
                name=f"{style.escaped(name)}, {kind}",
                marker={"color": colours[name], "symbol": symbol, "size": 7, "line": {"width": 1.4}},
                opacity=0.8,
                hovertemplate=f"%{{y:+{style.SHOWN}}} N after a move of %{{x:+{style.SHOWN}}}",
            )
    if noise is not None:
        shape = {"fillcolor": style.NOISE, "line_width": 0, "layer": "below", "showlegend": True}
        fig.add_hrect(-2 * noise, 2 * noise, name=f"± 2 noise ({number(2 * noise)} N)", **shape)
    fig.update_xaxes(title_text=label, zeroline=True)
    fig.update_yaxes(title_text="mean residual after it [N]", zeroline=True)
    fig.update_layout(hovermode="closest")
    return fig
