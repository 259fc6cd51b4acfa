"""Figures of several pages, over time: measurement and prediction, closed loop, two records, panels of lines."""

from collections.abc import Mapping

import numpy as np

from identification.fit.uncertainty import NORMAL_95
from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import Figure, panels, places
from vpp_fmu.digits import number
from vpp_fmu.record import QUANTITIES, Record

COMMANDS = {"omega_ref": "omega", "beta_ref": "beta"}
"""Commands, and their measured quantities."""

Columns = Record | Mapping[str, np.ndarray]
"""Arrays (n,) by column name."""


_LOOP = ("thrust_set", "thrust", "omega_ref", "omega", "beta_ref", "beta")


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
    unit = QUANTITIES[reading].unit
    labels = [style.label(reading), f"residual [{unit}]", *map(style.label, COMMANDS.values())]
    fig = panels(title, labels, [260, 160, 110, 110])
    time = np.asarray(record["time"])
    measured = np.asarray(record[reading] if reading in record else np.full(len(time), np.nan), float)
    residuals = {name: measured - values for name, values in predictions.items()}
    beside = [record[name] for both in COMMANDS.items() for name in both if name in record]
    kept = places([measured, *predictions.values(), *residuals.values(), *beside])
    time = time[kept]
    if band is not None:
        reach, middle = NORMAL_95 * np.asarray(band)[kept], np.asarray(next(iter(predictions.values())))[kept]
        for panel, centre in ((0, middle), (1, 0.0 * middle)):
            fig.envelope(time, centre - reach, centre + reach, "95 % of readings expected", style.BAND, panel)
    fig.line(time, measured[kept], "measured", style.MEASURED, 1, 0)
    if noise is not None:
        fig.band(1, 2 * noise, f"± 2 noise ({number(2 * noise)} {unit})")
    colours = style.colours(predictions)
    for name, residual in residuals.items():
        seen = residual[np.isfinite(residual)]
        error = f"rmse {number(np.sqrt(np.mean(seen**2)))} {unit}" if len(seen) else "nothing measured beside it"
        fig.line(time, np.asarray(predictions[name])[kept], f"{name}, {error}", colours[name], 1.6, 0)
        fig.line(time, residual[kept], f"{name}, residual", colours[name], 1, 1, f"{name}, {error}")
    for panel, (name, output) in enumerate(COMMANDS.items(), start=2):
        if output in record:
            fig.line(time, np.asarray(record[output])[kept], output, style.MEASURED, 1, panel, "measured")
        group = None if panel == 2 else "commands"
        fig.line(time, np.asarray(record[name])[kept], "commands", style.SET_POINT, 1.4, panel, group, held=True, dash="dash")
    return fig


def closed_loop(runs: Mapping[str, Columns], title: str, limits: Mapping[str, tuple[float, float]] | None = None) -> Figure:
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
            group = "set-point" if drawn else None
            held = {"dash": "dash", "held": True}
            fig.line(columns["time"], columns["thrust_set"], "set-point", style.SET_POINT, 1.8, 0, group, **held)
            drawn.append(run)
        _add_run(fig, name, columns, colours[name])
    first = next(iter(runs.values()))["time"]
    ends = np.array([first[0], first[-1]], float)
    for panel, column in ((1, "omega_ref"), (2, "beta_ref")):
        for k, end in enumerate(dict.fromkeys((limits or {}).get(column, ()))):
            group = None if panel == 1 and k == 0 else "limits"
            fig.line(ends, np.full(2, end), "limits", style.SET_POINT, 1, panel, group, dash="dashdot")
    return fig


def _add_run(fig: Figure, name: str, run: Mapping[str, np.ndarray], colour: str) -> None:
    """The lines of one run in the panels thrust, speed, pitch."""
    dotted = {"dash": "dot", "held": True}
    time, commands = run["time"], f"{name}, commands"
    fig.line(time, run["thrust"], name, colour, 1.5, 0)
    fig.line(time, run["omega_ref"], commands, colour, 1.2, 1, **dotted)
    fig.line(time, run["beta_ref"], f"{name}, pitch command", colour, 1.2, 2, commands, **dotted)
    for panel, column, word in ((1, "omega", "speed"), (2, "beta", "pitch")):
        if column in run:
            fig.line(time, run[column], f"{name}, {word}", colour, 1.5, panel, name)


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
    (name_a, *a), (name_b, *b) = first, second
    (time_a, a), (time_b, b) = ([np.asarray(values, float) for values in each] for each in (a, b))
    colours = style.colours((name_a, name_b))
    common = (time_a >= time_b[0]) & (time_a <= time_b[-1])
    difference = np.where(common, np.interp(time_a, time_b, b) - a, np.nan)
    kept_a, kept_b = places([a, difference]), places([b])
    if np.array_equal(time_a, time_b):
        kept_a = kept_b = places([a, b, difference])
    # Equal records hide each other, so the first is a wide line under the second.
    fig.line(time_a[kept_a], a[kept_a], name_a, colours[name_a], 2.6, 0)
    fig.line(time_b[kept_b], b[kept_b], name_b, colours[name_b], 1, 0)
    fig.line(time_a[kept_a], difference[kept_a], f"{name_b} − {name_a}", style.MEASURED, 1, 1)
    return fig


def stacked(time: np.ndarray, rows: Mapping[str, Mapping[str, np.ndarray]], title: str) -> Figure:
    """A panel for each of the `rows`, named by its axis label with unit: lines (n,) by name over the time [s], thinned.

    Lines with "command" in their name are held and dotted, "measured" ones thin; one name has one colour in all panels.
    """
    fig = panels(title, list(rows), [180] * len(rows))
    kept = places([values for lines in rows.values() for values in lines.values()])
    names = dict.fromkeys(name for lines in rows.values() for name in lines)
    colours, shown = style.colours(n for n in names if "command" not in n), set()
    for panel, lines in enumerate(rows.values()):
        for name, values in lines.items():
            colour, width = colours.get(name, style.SET_POINT), 1.0 if name == "measured" else 1.8
            held = {"dash": "dot", "held": True} if "command" in name else {}
            fig.line(time[kept], values[kept], name, colour, width, panel, name if name in shown else None, **held)
            shown.add(name)
    return fig
