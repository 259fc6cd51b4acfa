"""Logs of an RCbenchmark (Tyto Robotics) stand with fixed pitch: tables whose header is known and whose logger stalls.

Properties of the logger, from two logs of 80 to 120 rows a second (notes/identification.md):

- A third of the filled thrust cells repeat the last value to the last digit; other neighbours differ by 900 steps of the
  converter. Such a cell is one conversion read twice: it is emptied, so that it counts once.
- The logger stalls: most steps up have a gap of 80 to 97 ms. The row after a gap was measured before it (its current is still
  the motor's inrush). Its readings are emptied, except the voltage.
- Rows further apart than SAMPLED are averages by its program: steady points, not samples.
- Speed and thrust are smoothed over rows: after a gap half of the remaining step is made per row, whatever the time between
  rows. They are emptied until less than 1 % of the step remains, for REMEMBERED rows.

Nothing is resampled: rows keep their uneven times.
"""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from identification.gate.sensors import multiples
from identification.gate.zero import Rest, tare
from identification.logs.clock import mended
from identification.logs.intake import Taken, signal_range, take_in, values_of
from identification.logs.mapping import Plan
from identification.logs.raw_table import RawTable, split_unit
from identification.logs.sampling import SAMPLED
from vpp_fmu.errors import BadInput

SHOWN = ("time", "signal", "thrust", "voltage", "current", "omega", "torque", "power")
"""Quantities of import.json, in its order."""

NEEDED = {"time": "Time", "signal": "ESC signal", "thrust": "Thrust", "voltage": "Voltage"}
"""Names in the header of each log, by quantity."""

PWM_FROM = 900.0
"""Smallest signal of a log without its unit, from which it is PWM in us and not DShot."""


def preset(table: RawTable, words: Iterable[str], backwards: bool) -> list[str]:
    """The columns that each log has, as further words of --map beside a user's. The kind of a signal without a unit is that of
    its values; `backwards`: thrust has the opposite sign. BadInput for another header than that of the stand's program."""
    header = {split_unit(name)[0].lower(): name for name in table.columns}
    if missing := [name for name in NEEDED.values() if name.lower() not in header]:
        found = f"only {', '.join(table.columns)}"[:200]
        raise BadInput(table.source, f"column {missing[0]}", found, "a log of RCbenchmark with its own header")
    columns = {quantity: header[name.lower()] for quantity, name in NEEDED.items()}
    signal, thrust = columns["signal"], columns["thrust"]
    if not table.unit(signal) and np.nanmin(table.numbers(signal), initial=np.inf) >= PWM_FROM:
        columns["signal"] = f"{signal}:us"
    if backwards and (unit := table.unit(thrust)):
        columns["thrust"] = f"{thrust}:-1 {unit}"
    own = {word.partition("=")[0] for word in words}
    return [*words, *(f"{quantity}={column}" for quantity, column in columns.items() if quantity not in own)]


def averaged(step: float) -> bool:
    """Whether rows that are `step` s apart are averages, not samples."""
    return step > SAMPLED


def by_measured_speed(table: RawTable, plan: Plan, kind: str, **options) -> Taken:
    """A log with the measured speed as its command, interpolated over time where the speed is missing, late or a multiple.
    `options`: as of `take_in`."""
    try:
        taken = take_in(table, plan, kind, **options)
        wrong = multiples(taken.record())[0]
    except BadInput:  # no map of the signal to compare with
        columns = {**plan.columns, "omega_ref": plan.columns["omega"]}
        taken = take_in(table, replace(plan, columns={q: c for q, c in columns.items() if q != "signal"}), kind, **options)
        wrong = np.zeros(len(taken.columns["time"]), bool)
    time, speed = taken.columns["time"], taken.columns["omega"]
    there = np.isfinite(speed) & ~taken.stalls.stalled & ~wrong
    columns = {**taken.columns, "omega_ref": np.interp(time, time[there], speed[there])}
    said = (*taken.said, "omega_ref: the measured speed, interpolated where it is missing, late or a multiple")
    return replace(taken, columns=columns, said=said, speed_map=None)


def tared(taken: Taken) -> tuple[Taken, Rest | None]:
    """(the log with the thrust less its mean at rest, that rest); None without a rest."""
    if (zero := tare(taken.record())) is None:
        return taken, None
    return replace(taken, columns={**taken.columns, "thrust": taken.columns["thrust"] - zero.mean}), zero


def figures(table: RawTable, plan: Plan, taken: Taken, zero: Rest | None, keep_stalls: bool) -> dict:
    """The content of import.json: the log, and its corrections."""
    time, signal = (values_of(table, q, plan.columns[q]) for q in ("time", "signal"))
    timed, begun = np.isfinite(time), np.maximum.accumulate(np.isfinite(signal))
    time, signal = time[taken.clock.rows], signal[taken.clock.rows]
    back, furthest = mended(time - time[0])[1:]
    left_out = table.left_out | {
        "no time": int((~timed).sum()),
        "before the first ESC signal": int((timed & ~begun).sum()),
        "at the time of the next row": int((timed & begun).sum()) - len(time),
    }
    stalls, speed_map, names = taken.stalls, taken.speed_map, {q: c.name for q, c in plan.columns.items()}
    behind = stalls.stalled & ~stalls.repeated
    kept = stalls.filled & ~stalls.repeated & ~(behind & (not keep_stalls))
    gaps = np.diff(taken.columns["time"])[stalls.late[1:]]
    return {
        "format": "vpp-import/1",
        "log": Path(taken.source).name,
        "columns": {("speed" if q == "omega" else q): names[q] for q in SHOWN if q in names},
        "start": float(time[0]),
        "seconds": float(taken.columns["time"][-1]),
        "interval": taken.clock.step,
        "rows": len(time),
        "clock_back": {"rows": back, "seconds": furthest},
        "left_out": {reason: number for reason, number in left_out.items() if number},
        "thrust": {
            "filled": int(stalls.filled.sum()),
            "repeated": int(stalls.repeated.sum()),
            "behind_stalls": int((stalls.filled & behind).sum()),
            "kept": int(kept.sum()),
        },
        "stalls": {
            "number": len(gaps),
            "seconds": [float(gaps.min()), float(gaps.max())] if len(gaps) else None,
            "rows_behind": int(stalls.stalled.sum()),
            "emptied": not keep_stalls,
        },
        "tare": {name: getattr(zero, name) for name in ("mean", "spread", "readings")} if zero else None,
        "signal": {"kind": signal_range(plan).kind, "minimum": float(np.nanmin(signal)), "maximum": float(np.nanmax(signal))},
        "speed_map": speed_map
        and {
            "source": speed_map.source,
            "nominal_voltage": speed_map.nominal_voltage,
            "rms": speed_map.rms,
            "turns_from": speed_map.turns_from,
            "here": taken.here,
            "rows_beyond": int(np.sum(signal > speed_map.fitted_to)),
        },
    }
