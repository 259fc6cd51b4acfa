"""Figures over time: measurement and prediction, closed loop, two records."""

from collections.abc import Mapping

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.digits import number
from vpp_fmu.report import style
from vpp_fmu.report.panels import add_band, add_envelope, add_line, panels
from vpp_fmu.report.thinning import places

_NORMAL_95 = 1.959963984540054

_HELD = "hv"
"""Line shape of commands, which are held until the next one."""

_LOOP = ("thrust_set", "thrust", "omega_ref", "omega", "beta_ref", "beta")


def measured_against_predicted(
    time: np.ndarray,
    measured: np.ndarray,
    predictions: Mapping[str, np.ndarray],
    title: str,
    quantity: str = "thrust",
    unit: str = "N",
    commands: Mapping[str, np.ndarray] | None = None,
    noise: float | None = None,
    band: np.ndarray | None = None,
) -> go.Figure:
    """Measured and predicted values, their difference with a band of +-2 `noise`, and a panel per command; over time [s].

    All arrays are (n,), values and `noise` (standard deviation) in `unit`. Commands are by column name. `band`: standard
    deviation of a reading about the first prediction; 1.96 of it are drawn around the prediction and in the residual.
    """
    commands = commands or {}
    labels = [f"{quantity} [{unit}]", f"residual [{unit}]", *map(style.label, commands)]
    fig = panels(title, labels, [260, 160] + [110] * len(commands))
    measured = np.asarray(measured, float)
    residuals = {name: measured - values for name, values in predictions.items()}
    kept = places([measured, *predictions.values(), *residuals.values(), *commands.values()])
    time = np.asarray(time)[kept]
    if band is not None:
        reach, middle = _NORMAL_95 * np.asarray(band)[kept], np.asarray(next(iter(predictions.values())))[kept]
        for panel, centre in ((0, middle), (1, 0.0 * middle)):
            add_envelope(fig, panel, time, centre - reach, centre + reach, "95 % of readings expected", style.BAND)
    add_line(fig, 0, time, measured[kept], "measured", {"color": style.MEASURED, "width": 1})
    if noise is not None:
        add_band(fig, 1, 2 * noise, f"± 2 noise ({number(2 * noise)} {unit})")
    colours = style.colours(predictions)
    for name, residual in residuals.items():
        seen = residual[np.isfinite(residual)]
        shown = (
            f"{name}, rmse {number(np.sqrt(np.mean(seen**2)))} {unit}" if len(seen) else f"{name}, nothing measured beside it"
        )
        add_line(fig, 0, time, np.asarray(predictions[name])[kept], shown, {"color": colours[name], "width": 1.6})
        add_line(fig, 1, time, residual[kept], f"{name}, residual", {"color": colours[name], "width": 1}, group=shown)
    for k, (name, values) in enumerate(commands.items(), start=2):
        line = {"color": style.SET_POINT, "width": 1.4, "shape": _HELD}
        add_line(fig, k, time, np.asarray(values)[kept], name, line, group="commands")
    return fig


def closed_loop(
    runs: Mapping[str, Mapping[str, np.ndarray]], title: str, limits: Mapping[str, tuple[float, float]] | None = None
) -> go.Figure:
    """Thrust with its set-point [N], speed [rpm] and pitch [deg] of each run over time [s]; commands dotted. `limits`: (least,
    greatest) of each command by its name, drawn if known.

    A run holds arrays (n,) by column name: time, thrust_set, thrust, omega_ref, omega, beta_ref, beta. Unmeasured ones may
    be missing. The set-point is drawn once if all runs share it.
    """
    fig = panels(title, [style.label(name) for name in ("thrust", "omega", "beta")], [260, 150, 150])
    colours = style.colours(runs)
    drawn = []
    for name, run in runs.items():
        kept = places([run[column] for column in _LOOP if column in run])
        columns = {column: np.asarray(run[column])[kept] for column in ("time", *_LOOP) if column in run}
        if not any(all(np.array_equal(run[column], other[column]) for column in ("time", "thrust_set")) for other in drawn):
            line = {"color": style.SET_POINT, "width": 1.8, "dash": "dash", "shape": _HELD}
            group = "set-point" if drawn else None
            add_line(fig, 0, columns["time"], columns["thrust_set"], "set-point", line, group)
            drawn.append(run)
        _add_run(fig, name, columns, colours[name])
    first = next(iter(runs.values()))["time"]
    ends = np.array([first[0], first[-1]], float)
    for panel, column in ((1, "omega_ref"), (2, "beta_ref")):
        for k, end in enumerate(dict.fromkeys((limits or {}).get(column, ()))):
            line = {"color": style.FAINT, "width": 1, "dash": "dashdot"}
            add_line(fig, panel, ends, np.full(2, end), "limits", line, None if panel == 1 and k == 0 else "limits")
    return fig


def _add_run(fig: go.Figure, name: str, run: Mapping[str, np.ndarray], colour: str) -> None:
    """The lines of one run in the panels thrust, speed, pitch."""
    solid = {"color": colour, "width": 1.5}
    dotted = {"color": colour, "width": 1.2, "dash": "dot", "shape": _HELD}
    time, commands = run["time"], f"{name}, commands"
    add_line(fig, 0, time, run["thrust"], name, solid)
    add_line(fig, 1, time, run["omega_ref"], commands, dotted)
    add_line(fig, 2, time, run["beta_ref"], f"{name}, pitch command", dotted, group=commands)
    for panel, column, word in ((1, "omega", "speed"), (2, "beta", "pitch")):
        if column in run:
            add_line(fig, panel, time, run[column], f"{name}, {word}", solid, group=name)


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
    """Two records over time [s], values in `unit`, and b - a at the common times of a, with b interpolated linearly."""
    fig = panels(title, [f"{quantity} [{unit}]", f"difference [{unit}]"], [260, 160])
    time_a, a, time_b, b = (np.asarray(values, float) for values in (time_a, a, time_b, b))
    colours = style.colours((name_a, name_b))
    common = (time_a >= time_b[0]) & (time_a <= time_b[-1])
    difference = np.where(common, np.interp(time_a, time_b, b) - a, np.nan)
    kept_a, kept_b = places([a, difference]), places([b])
    if np.array_equal(time_a, time_b):
        kept_a = kept_b = places([a, b, difference])
    # Equal records hide each other, so the first is a wide line under the second.
    add_line(fig, 0, time_a[kept_a], a[kept_a], name_a, {"color": colours[name_a], "width": 2.6})
    add_line(fig, 0, time_b[kept_b], b[kept_b], name_b, {"color": colours[name_b], "width": 1})
    line = {"color": style.MEASURED, "width": 1}
    add_line(fig, 1, time_a[kept_a], difference[kept_a], f"{name_b} − {name_a}", line)
    return fig
