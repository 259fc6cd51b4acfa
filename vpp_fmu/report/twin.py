"""Figures of an adaptive twin over time: its residual with its band, and its parameters with their uncertainty."""

from collections.abc import Mapping

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.report import style
from vpp_fmu.report.panels import add_envelope, add_line, panels
from vpp_fmu.report.thinning import places

ADAPTED, STD = "adapted.", "std."


def residual_in_band(time: np.ndarray, twin: Mapping[str, np.ndarray]) -> go.Figure:
    """Measured thrust less the twin's [N] over time [s], with the 95 % band; (n,) by the twin's outputs."""
    kept = places([twin["residual"], twin["band"], twin["alarm"]])
    alarms = np.flatnonzero(np.diff(twin["alarm"], prepend=0.0) > 0.5)
    said = f"alarm at {', '.join(f'{at:.1f}' for at in time[alarms[:5]])} s" if len(alarms) else "no alarm"
    fig = panels(f"Adaptive twin: {said}, {twin['changes'][-1]:.0f} changes followed", ["residual [N]"], [240])
    half = twin["band"][kept]
    add_envelope(fig, 0, time[kept], -half, half, "95 % of readings expected", style.BAND)
    add_line(fig, 0, time[kept], twin["residual"][kept], "rig − twin", {"color": style.MEASURED, "width": 1})
    for at in time[alarms]:
        fig.add_vline(x=float(at), line={"color": style.BEFORE, "width": 1.6, "dash": "dash"})
    return fig


def adapted_parameters(time: np.ndarray, twin: Mapping[str, np.ndarray], units: Mapping[str, str]) -> go.Figure:
    """Each adapted parameter over time [s] with +-2 standard deviations; `units` by its name."""
    names = [name.removeprefix(ADAPTED) for name in twin if name.startswith(ADAPTED)]
    kept = places([twin[part + name] for name in names for part in (ADAPTED, STD)])
    fig = panels("Adapted parameters", [f"{name} [{units[name]}]" for name in names], [150] * len(names))
    for panel, name in enumerate(names):
        value, std = twin[ADAPTED + name][kept], twin[STD + name][kept]
        add_envelope(fig, panel, time[kept], value - 2.0 * std, value + 2.0 * std, "± 2 standard deviations", style.BAND)
        add_line(fig, panel, time[kept], value, name, {"color": style.AFTER, "width": 1.6}, group="adapted")
    return fig
