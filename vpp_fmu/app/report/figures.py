"""Figures of several pages, over time: measurement and prediction, closed loop, two records, panels of lines."""

from collections.abc import Mapping

import numpy as np

from identification.fit.uncertainty import NORMAL_95
from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import Figure, panels
from vpp_fmu.digits import number
from vpp_fmu.record import QUANTITIES, Record

COMMANDS = {"omega_ref": "omega", "beta_ref": "beta"}
"""Commands, and their measured quantities."""

Columns = Record | Mapping[str, np.ndarray]
"""Arrays (n,) by column name."""


def measured_against_predicted(
    record: Columns,
    predictions: Mapping[str, np.ndarray],
    title: str,
    noise: float | None = None,
    band: np.ndarray | None = None,
    reading: str = "thrust",
) -> Figure:
    """Measured and predicted thrust [N], their difference with a band of +-2 `noise`, and a record's commands with
    their measured quantities, over time [s].

    Predictions are (n,) by name; `noise`: standard deviation [N] of a reading. `band`: standard deviation (n,) of a reading
    about the first prediction; 1.96 of it are drawn around the prediction and in the residual. `reading`: a column in place of
    thrust, in its own unit.
    """
    unit, time = QUANTITIES[reading].unit, record["time"]
    labels = [style.label(reading), f"residual [{unit}]", *map(style.label, COMMANDS.values())]
    fig = panels(title, labels, [260, 160, 110, 110])
    measured = np.asarray(record[reading] if reading in record else np.full(len(time), np.nan), float)
    if band is not None:
        middle = np.asarray(next(iter(predictions.values())))
        for panel, centre in ((0, middle), (1, 0.0 * middle)):
            low, high = centre - NORMAL_95 * band, centre + NORMAL_95 * band
            fig.envelope(time, low, high, "95 % of readings expected", style.BAND, panel)
    fig.line(time, measured, "measured", style.MEASURED, 1)
    if noise is not None:
        fig.band(1, 2 * noise, f"± 2 noise ({number(2 * noise)} {unit})")
    colours = style.colours(predictions)
    for name, predicted in predictions.items():
        residual = measured - predicted
        seen = residual[np.isfinite(residual)]
        error = f"rmse {number(np.sqrt(np.mean(seen**2)))} {unit}" if len(seen) else "nothing measured beside it"
        fig.line(time, predicted, f"{name}, {error}", colours[name], 1.6)
        fig.line(time, residual, f"{name}, residual", colours[name], 1, 1, f"{name}, {error}")
    for panel, (name, output) in enumerate(COMMANDS.items(), start=2):
        if output in record:
            fig.line(time, record[output], output, style.MEASURED, 1, panel, "measured")
        fig.line(time, record[name], "commands", style.SET_POINT, 1.4, panel, held=True, dash="dash")
    return fig


def closed_loop(runs: Mapping[str, Columns], title: str, limits: Mapping[str, tuple[float, float]] | None = None) -> Figure:
    """Thrust with its set-point [N], speed [rpm] and pitch [deg] of each run over time [s]; commands dotted. `limits`: (least,
    greatest) of each command by its name, drawn if known.

    A run holds arrays (n,) by column name: time, thrust_set, thrust, omega_ref, omega, beta_ref, beta. Unmeasured ones may
    be missing. The set-point is drawn once if all runs share it.
    """
    fig = panels(title, [style.label(name) for name in ("thrust", "omega", "beta")], [260, 150, 150])
    colours = style.colours(runs)
    for run in {np.asarray(run["thrust_set"]).tobytes(): run for run in runs.values()}.values():
        fig.line(run["time"], run["thrust_set"], "set-point", style.SET_POINT, held=True, dash="dash")
    for name, run in runs.items():
        fig.line(run["time"], run["thrust"], name, colours[name], 1.5)
        for panel, (command, output) in enumerate(COMMANDS.items(), start=1):
            fig.line(run["time"], run[command], f"{name}, commands", colours[name], 1.2, panel, held=True, dash="dot")
            if output in run:
                fig.line(run["time"], run[output], name, colours[name], 1.5, panel)
    for panel, command in enumerate(COMMANDS, start=1):
        for end in dict.fromkeys((limits or {}).get(command, ())):
            fig.level(f"y{panel}", end, "limits")
    return fig


def two_records(
    first: tuple[str, np.ndarray, np.ndarray],
    second: tuple[str, np.ndarray, np.ndarray],
    title: str,
    quantity: str,
    unit: str,
) -> Figure:
    """Two records (name, time [s], values), values in `unit`, all (n,), and their difference.

    The difference, second less first, is at the common times of the first; the second is interpolated linearly.
    """
    fig = panels(title, [f"{quantity} [{unit}]", f"difference [{unit}]"], [260, 160])
    (name_a, time_a, a), (name_b, time_b, b) = first, second
    colours = style.colours((name_a, name_b))
    common = (time_a >= time_b[0]) & (time_a <= time_b[-1])
    difference = np.where(common, np.interp(time_a, time_b, b) - a, np.nan)
    # Equal records hide each other, so the first is a wide line under the second.
    fig.line(time_a, a, name_a, colours[name_a], 2.6)
    fig.line(time_b, b, name_b, colours[name_b], 1)
    fig.line(time_a, difference, f"{name_b} − {name_a}", style.MEASURED, 1, 1)
    return fig


def stacked(time: np.ndarray, rows: Mapping[str, Mapping[str, np.ndarray]], title: str) -> Figure:
    """A panel for each of the `rows`, named by its axis label with unit: lines (n,) by name over the time [s].

    Lines with "command" in their name are held and dotted, "measured" ones thin; one name has one colour in all panels.
    """
    fig = panels(title, list(rows), [180] * len(rows))
    names = dict.fromkeys(name for lines in rows.values() for name in lines)
    colours = style.colours(n for n in names if "command" not in n)
    for panel, lines in enumerate(rows.values()):
        for name, values in lines.items():
            held = {"dash": "dot", "held": True} if "command" in name else {}
            width = 1.0 if name == "measured" else 1.8
            fig.line(time, values, name, colours.get(name, style.SET_POINT), width, panel, **held)
    return fig
