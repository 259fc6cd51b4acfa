"""Figures of two models' residuals, before and after: correlations, spectrum, and means after moves of commands."""

from collections.abc import Mapping, Sequence

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.digits import number
from vpp_fmu.report import style
from vpp_fmu.report.panels import add_band, add_line, panels


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


def overlap_heatmap(names: Sequence[str], matrix: np.ndarray, title: str, least: float = 0.5) -> go.Figure:
    """Squared cosines (n, n) between the sensitivities of n effects, 0 to 1; each pair once, numbers from `least` on."""
    labels = [style.escaped(name) for name in names]
    shown = np.where(np.tril(np.ones_like(matrix), -1) > 0, matrix, np.nan)[1:, :-1]
    texts = np.where(shown >= least, np.char.mod("%.2f", np.nan_to_num(shown)), "")
    fig = style.figure(title, 190 + max(30 * len(labels), 120), legend=False)
    fig.add_heatmap(
        x=labels[:-1],
        y=labels[1:],
        z=shown,
        zmin=0,
        zmax=1,
        colorscale=((0.0, style.ZERO), (1.0, style.BEFORE)),
        colorbar={"title": {"text": "squared cosine [-]"}},
        text=texts,
        texttemplate="%{text}",
        textfont={"size": 11},
        xgap=1,
        ygap=1,
        hovertemplate="%{y}, %{x}: %{z:.2f}<extra></extra>",
    )
    fig.update_xaxes(title_text="effect [-]", type="category", showgrid=False)
    fig.update_yaxes(title_text="effect [-]", type="category", showgrid=False, autorange="reversed")
    return fig
