"""Figures of the closed loop: stability margins, responses of many plants, and the adaptive twin."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import add_envelope, add_line, panels, places, to_the_eye

REACH = 2.5
"""Half-width of the Nyquist plot, which must show the region around -1."""

_THIN = 0.7

_GREY = {"color": style.SET_POINT, "width": 1.2, "dash": "dot"}


def nyquist(loops: Mapping[str, np.ndarray], sensitivity: float, title: str) -> go.Figure:
    """Open loops (n,), complex, by name; the unit circle, and the circle around -1 where the sensitivity is `sensitivity`."""
    fig = style.figure(title, 560)
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    for name, centre, radius in (("unit circle", 0.0, 1.0), (f"sensitivity {sensitivity:g}", -1.0, 1.0 / sensitivity)):
        line = {**_GREY, "dash": "dot" if centre == 0.0 else "dash"}
        x, y = centre + radius * np.cos(turn), radius * np.sin(turn)
        fig.add_scatter(x=x, y=y, mode="lines", name=name, line=line, hoverinfo="skip")
    colours = style.colours(loops)
    for name, loop in loops.items():
        near = np.abs(loop) < 2.0 * REACH
        line = {"color": colours[name], "width": 1.6}
        fig.add_scatter(x=loop.real[near], y=loop.imag[near], mode="lines", name=style.escaped(name), line=line)
    marker = {"symbol": "x", "size": 9, "color": style.MEASURED}
    fig.add_scatter(x=[-1.0], y=[0.0], mode="markers", name="-1", marker=marker, showlegend=False, hoverinfo="skip")
    fig.update_xaxes(title_text="real part [-]", range=[-REACH, 1.0])
    fig.update_yaxes(title_text="imaginary part [-]", range=[-REACH, 1.0], scaleanchor="x", scaleratio=1.0)
    return fig


def bode(omega: np.ndarray, loops: Mapping[str, np.ndarray], title: str) -> go.Figure:
    """Magnitude [dB] and phase [deg] of open loops (n,), complex, by name, over `omega` (n,) [rad/s]."""
    fig = panels(title, ["magnitude [dB]", "phase [deg]"], [220, 200])
    colours = style.colours(loops)
    for name, loop in loops.items():
        line = {"color": colours[name], "width": 1.6}
        phase = np.degrees(np.unwrap(np.angle(loop)))
        add_line(fig, 0, omega, 20.0 * np.log10(np.abs(loop)), name, line)
        add_line(fig, 1, omega, phase - 360.0 * np.round((phase[0] + 90.0) / 360.0), f"{name}, phase", line, group=name)
    fig.add_hline(y=0.0, line=_GREY, yref="y")
    fig.add_shape(type="line", xref="x domain", yref="y2", x0=0, x1=1, y0=-180.0, y1=-180.0, line=_GREY)
    fig.update_xaxes(type="log", title_text="frequency [rad/s]", hoverformat=".3~g")
    fig.update_layout(yaxis={"range": [-40.0, 60.0]}, yaxis2={"range": [-270.0, -45.0], "dtick": 45})
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
            line = {"color": colours[name], "width": 1.6}
            add_line(fig, panel, thrust[name], own, name if panel == 0 else f"{name}, {label}", line, name if panel else None)
        if label in limits:
            axis = "y" if panel == 0 else f"y{panel + 1}"
            edge = {"y0": limits[label], "y1": limits[label], "line": {**_GREY, "dash": "dash"}}
            fig.add_shape(type="line", xref="x domain", yref=axis, x0=0, x1=1, **edge)
    fig.update_traces(mode="lines+markers", marker={"size": 6})
    fig.update_xaxes(title_text="thrust at the operating point [N]", hoverformat=".3~g")
    return fig


@dataclass(frozen=True, eq=False)
class Cloud:
    """Responses of many plants to one step: `thrust` (plants, n) and set-point `wanted` (n,), N; `gains` name the colour."""

    step: str
    gains: str
    wanted: np.ndarray
    thrust: np.ndarray


def response_clouds(time: np.ndarray, clouds: Sequence[Cloud], title: str, shown: int = 40) -> go.Figure:
    """A panel per set of plants over the time from the step (n,) s: the first `shown` plants, and lines of the 90 % range."""
    fig = panels(title, [f"{cloud.step}: thrust [N]" for cloud in clouds], [170] * len(clouds))
    colours = style.colours(dict.fromkeys(cloud.gains for cloud in clouds))
    named: set[str] = set()

    def add(panel, values, name, line):
        add_line(fig, panel, time, to_the_eye(values), name, line, name if name in named else None)
        named.add(name)

    for panel, cloud in enumerate(clouds):
        for own in cloud.thrust[:shown]:
            add(panel, own, f"{cloud.gains}: a plant each", {"color": colours[cloud.gains], "width": _THIN})
        for edge in np.percentile(cloud.thrust, [5.0, 95.0], axis=0):
            add(panel, edge, "5 % and 95 %", {"color": style.MEASURED, "width": 1.6})
        add(panel, cloud.wanted, "set-point", {"color": style.SET_POINT, "width": 1.8, "dash": "dash", "shape": "hv"})
    fig.update_traces(opacity=0.4, selector=lambda trace: trace.line.width == _THIN)
    fig.update_layout(hovermode="closest")
    fig.update_xaxes(title_text="time from the step [s]")
    return fig


def cost_ranks(costs: Mapping[str, Sequence[float]], title: str) -> go.Figure:
    """Costs of many plants by name, each sorted."""
    fig = style.figure(title, 340)
    colours = style.colours(costs)
    for name, values in costs.items():
        ranks = 100.0 * np.arange(1, len(values) + 1) / len(values)
        line = {"color": colours[name], "width": 1.8}
        fig.add_scatter(x=ranks, y=np.sort(values), mode="lines", name=style.escaped(name), line=line)
    fig.update_xaxes(title_text="share of the plants with no more [%]")
    fig.update_yaxes(title_text="cost [-]")
    return fig


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
