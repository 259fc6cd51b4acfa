"""Figures of the closed loop: stability margins, costs of many plants, and the twin."""

from collections.abc import Mapping, Sequence

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import add_envelope, add_line, add_points, axis, figure, panels, places
from vpp_fmu.app.report.sentences import words

REACH = 2.5
"""Half-width of the Nyquist plot, which must show the region around -1."""

ADAPTED, STD = "adapted.", "std."


def nyquist(loops: Mapping[str, np.ndarray], sensitivity: float, title: str) -> go.Figure:
    """Open loops (n,), complex, by name; the unit circle, and the circle around -1 where the sensitivity is `sensitivity`."""
    fig = figure(title, 560, "real part [-]", "imaginary part [-]")
    turn = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 181))
    circles = ("unit circle", 0.0, 1.0, "dot"), (f"sensitivity {sensitivity:g}", -1.0, 1.0 / sensitivity, "dash")
    for name, centre, radius, dash in circles:
        x, y = centre + radius * turn.real, radius * turn.imag
        add_line(fig, x, y, name, style.SET_POINT, 1.2, dash=dash, hoverinfo="skip")
    colours = style.colours(loops)
    for name, loop in loops.items():
        near = loop[np.abs(loop) < 2.0 * REACH]
        add_line(fig, near.real, near.imag, name, colours[name], 1.6)
    add_points(fig, [-1.0], [0.0], "-1", style.MEASURED, 9, "x", showlegend=False, hoverinfo="skip")
    fig.update_xaxes(range=[-REACH, 1.0])
    fig.update_yaxes(range=[-REACH, 1.0], scaleanchor="x", scaleratio=1.0)
    return fig


def margins_over_thrust(
    thrust: Mapping[str, np.ndarray],
    quantities: Mapping[str, Mapping[str, np.ndarray]],
    limits: Mapping[str, float],
    title: str,
) -> go.Figure:
    """Panels, one for each of the `quantities` (its label -> values by name), over the operating point's thrust [N] by name.

    `limits`: a line in the panel of that label.
    """
    fig = panels(title, list(quantities), [130] * len(quantities))
    colours = style.colours(thrust)
    for panel, (label, values) in enumerate(quantities.items()):
        for name, own in values.items():
            shown, group = (f"{name}, {label}", name) if panel else (name, None)
            add_line(fig, thrust[name], own, shown, colours[name], 1.6, panel, group)
        if label in limits:
            at, line = limits[label], {"color": style.SET_POINT, "width": 1.2, "dash": "dash"}
            fig.add_shape(type="line", xref="x domain", yref=axis("y", panel), x0=0, x1=1, y0=at, y1=at, line=line)
    fig.update_traces(mode="lines+markers", marker={"size": 6})
    fig.update_xaxes(title_text="thrust at the operating point [N]", hoverformat=".3~g")
    return fig


def cost_ranks(costs: Mapping[str, Sequence[float]], title: str) -> go.Figure:
    """Costs of many plants by name, each sorted."""
    fig = figure(title, 340, "share of the plants with no more [%]", "cost [-]")
    colours = style.colours(costs)
    for name, values in costs.items():
        add_line(fig, 100.0 * np.arange(1, len(values) + 1) / len(values), np.sort(values), name, colours[name])
    return fig


def residual_in_band(time: np.ndarray, twin: Mapping[str, np.ndarray]) -> go.Figure:
    """Measured thrust less the twin's [N] over time [s], with the 95 % band; (n,) by the twin's outputs."""
    kept = places([twin["residual"], twin["band"], twin["alarm"]])
    alarms = time[np.diff(twin["alarm"], prepend=0.0) > 0.5]
    said = f"alarm at {', '.join(f'{at:.1f}' for at in alarms[:5])} s" if len(alarms) else "no alarm"
    fig = panels(f"Twin: {said}, {twin['changes'][-1]:.0f} changes followed", ["residual [N]"], [240])
    half = twin["band"][kept]
    add_envelope(fig, time[kept], -half, half, "95 % of readings expected", style.BAND, 0)
    add_line(fig, time[kept], twin["residual"][kept], "rig − twin", style.MEASURED, 1, 0)
    for at in alarms:
        fig.add_vline(x=float(at), line={"color": style.BEFORE, "width": 1.6, "dash": "dash"})
    return fig


def adapted_parameters(time: np.ndarray, twin: Mapping[str, np.ndarray], units: Mapping[str, str]) -> go.Figure:
    """Each adapted parameter over time [s] with +-2 standard deviations; `units` by its name."""
    names = [name.removeprefix(ADAPTED) for name in twin if name.startswith(ADAPTED)]
    kept = places([twin[part + name] for name in names for part in (ADAPTED, STD)])
    fig = panels("Adapted parameters", [f"{words(name)} [{units[name]}]" for name in names], [150] * len(names))
    for panel, name in enumerate(names):
        value, std = twin[ADAPTED + name][kept], twin[STD + name][kept]
        band = value - 2.0 * std, value + 2.0 * std
        add_envelope(fig, time[kept], *band, "± 2 standard deviations", style.BAND, panel)
        add_line(fig, time[kept], value, words(name), style.AFTER, 1.6, panel, "adapted")
    return fig
