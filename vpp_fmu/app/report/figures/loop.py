"""Figures of the closed loop: stability margins, costs of many plants, and the twin."""

from collections.abc import Mapping, Sequence

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import add_envelope, add_level, add_line, figure, panels, places
from vpp_fmu.app.report.sentences import words

ADAPTED, STD = "adapted.", "std."


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
            add_level(fig, panel, limits[label])
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
