"""Figures over time: measured against predicted, closed loop, one record against another."""

from collections.abc import Mapping

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.report import style
from vpp_fmu.report.panels import add_band, add_line, panels

_HELD = "hv"
"""Commands are held until the next one."""


def measured_against_predicted(
    time: np.ndarray,
    measured: np.ndarray,
    predictions: Mapping[str, np.ndarray],
    title: str,
    quantity: str = "thrust",
    unit: str = "N",
    commands: Mapping[str, np.ndarray] | None = None,
    noise: float | None = None,
) -> go.Figure:
    """Measured and predicted values, measured - predicted with a band of +-2 `noise`, and a panel a command; over time [s].

    All arrays are (n,), values and `noise` (standard deviation) in `unit`. Commands go by their column's name.
    """
    commands = commands or {}
    labels = [f"{quantity} [{unit}]", f"residual [{unit}]", *map(style.label, commands)]
    fig = panels(title, labels, [260, 160] + [80] * len(commands))
    measured = np.asarray(measured, float)
    add_line(fig, 0, time, measured, "measured", {"color": style.MEASURED, "width": 1})
    if noise is not None:
        add_band(fig, 1, 2 * noise, f"± 2 noise ({2 * noise:.2g} {unit})")
    colours = style.colours(predictions)
    for name, values in predictions.items():
        residual = measured - values
        shown = f"{name}, rmse {np.sqrt(np.nanmean(residual**2)):.3g} {unit}"
        add_line(fig, 0, time, values, shown, {"color": colours[name], "width": 1.6})
        add_line(fig, 1, time, residual, shown, {"color": colours[name], "width": 1}, legend=False)
    for k, (name, values) in enumerate(commands.items(), start=2):
        line = {"color": style.SET_POINT, "width": 1.4, "shape": _HELD}
        add_line(fig, k, time, values, style.label(name), line, legend=False)
    return fig


def closed_loop(runs: Mapping[str, Mapping[str, np.ndarray]], title: str) -> go.Figure:
    """Thrust with its set-point [N], speed [rpm] and pitch [deg] of each run over time [s]; commands dashed and lighter.

    A run holds arrays (n,) by column name: time, thrust_set, thrust, omega_ref, omega, beta_ref, beta. What a rig doesn't
    measure may be missing. The set-point is drawn once if all runs share it.
    """
    fig = panels(title, [style.label(name) for name in ("thrust", "omega", "beta")], [260, 150, 150])
    colours = style.colours(runs)
    drawn = []
    for run in runs.values():
        points = (run["time"], run["thrust_set"])
        if not any(np.array_equal(points, other) for other in drawn):
            line = {"color": style.SET_POINT, "width": 1.6, "dash": "dash", "shape": _HELD}
            add_line(fig, 0, *points, "set-point", line, legend=not drawn)
            drawn.append(points)
    for name, run in runs.items():
        add_line(fig, 0, run["time"], run["thrust"], name, {"color": colours[name], "width": 1.5})
        for panel, quantity in ((1, "omega"), (2, "beta")):
            command, value = f"{quantity}_ref", quantity
            if command in run:
                line = {"color": _lighter(colours[name]), "width": 1.2, "dash": "dot", "shape": _HELD}
                add_line(fig, panel, run["time"], run[command], f"{name}, command", line, legend=panel == 1)
            if value in run:
                add_line(fig, panel, run["time"], run[value], name, {"color": colours[name], "width": 1.5}, legend=False)
    return fig


def two_records(
    time_a: np.ndarray,
    a: np.ndarray,
    time_b: np.ndarray,
    b: np.ndarray,
    name_a: str,
    name_b: str,
    title: str,
    quantity: str,
    unit: str,
) -> go.Figure:
    """Two records over time [s], values in `unit`, and b - a at the times of a that both cover, b joined by straight lines."""
    fig = panels(title, [f"{quantity} [{unit}]", f"difference [{unit}]"], [260, 160])
    time_a, a = np.asarray(time_a, float), np.asarray(a, float)
    colours = style.colours((name_a, name_b))
    add_line(fig, 0, time_a, a, name_a, {"color": colours[name_a], "width": 1.5})
    add_line(fig, 0, time_b, b, name_b, {"color": colours[name_b], "width": 1.2})
    common = (time_a >= time_b[0]) & (time_a <= time_b[-1])
    difference = np.interp(time_a[common], time_b, b) - a[common]
    add_line(fig, 1, time_a[common], difference, f"{name_b} − {name_a}", {"color": style.MEASURED, "width": 1})
    return fig


def _lighter(colour: str) -> str:
    """The colour (#rrggbb) half way to white."""
    return "#" + "".join(f"{(int(colour[k : k + 2], 16) + 255) // 2:02x}" for k in (1, 3, 5))
