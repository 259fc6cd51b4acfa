"""Read logs of an RCbenchmark (Tyto Robotics) stand with fixed pitch, and remove cells that are not measurements.

Properties of the logger, from two logs of 80 to 120 rows a second (notes/identification.md):

- A third of the filled thrust cells repeat the last value to the last digit; other neighbours differ by 900 steps of the
  converter. Such a cell is one conversion read twice: it is emptied, so that it counts once.
- The logger stalls: most steps up have a gap of 80 to 97 ms. The row after a gap was measured before it (its current is still
  the motor's inrush). Its readings are emptied, except the voltage.
- Its clock decreases by some ms in four of 15 875 rows: these are corrected as in any log (clock.py), and counted.
- Rows further apart than SAMPLED are averages by its program: steady points, not samples.
- Speed and thrust are smoothed over rows: after a gap half of the remaining step is made per row, whatever the time between
  rows. They are emptied until less than 1 % of the step remains, for REMEMBERED rows.

Nothing is resampled: rows keep their uneven times.
"""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from identification.logs.clock import mended
from identification.logs.delimited import read_delimited
from identification.logs.raw_table import RawTable
from identification.logs.sampling import read_once
from identification.logs.speed_map import RANGES, SignalRange, SteadyPoints, steady_points
from vpp_fmu.errors import BadInput
from vpp_fmu.record import Record

STALL = 4.0
"""A gap longer than this many median intervals is a stall: stalls of the logs have 4.6 to 12, other gaps less than 3.2."""

REMEMBERED = 7
"""Rows after a stall in which speed and thrust still settle: 0.3, 0.12, 0.06, 0.03, 0.015, 0.007 of a step remains."""

SAMPLED = 0.04
"""Longest median interval [s] of samples: a stand samples every 8 to 12 ms; rows 125 ms apart are averages."""

POINTS = 1.0
"""Median interval [s] above which each row is a steady point."""

_GRAVITY = 9.80665
_TURN = 30.0 / np.pi
_US = ("us", "µs", "μs")

_UNITS = {
    "time": {"s": 1.0, "ms": 1e-3},
    "thrust": {"n": 1.0, "gf": _GRAVITY / 1e3, "g": _GRAVITY / 1e3, "kgf": _GRAVITY, "kg": _GRAVITY, "lbf": 4.4482216152605},
    "speed": {"rpm": 1.0, "rad/s": _TURN, "hz": 60.0, "rev/s": 60.0},
    "voltage": {"v": 1.0, "mv": 1e-3},
    "current": {"a": 1.0, "ma": 1e-3},
}
"""Factors to the units of a record, by quantity and unit in lower case."""

_SPEEDS = ("motor optical speed", "motor electrical speed")
"""By preference: the electrical speed needs the right number of poles, and is sometimes logged as zeros."""


@dataclass(frozen=True, eq=False)
class Log:
    """A log as written, each array (n,): time [s] from 0, ESC signal (empty cells hold the last value), speed [rpm] or None,
    thrust [N] with its offset, voltage [V] (held too), current [A] or None; NaN for an empty cell.

    Masks (n,): `repeated` thrust cells; `late` rows right after a stall; `stalled` rows affected by one. `start`: the log's
    time [s] at 0. `names`: columns used, by quantity. `dropped`: numbers of skipped rows by reason. `mended`: number of
    decreases of the clock, and the largest [s].
    """

    source: str
    start: float
    time: np.ndarray
    signal: np.ndarray
    span: SignalRange
    speed: np.ndarray | None
    thrust: np.ndarray
    voltage: np.ndarray
    current: np.ndarray | None
    repeated: np.ndarray
    late: np.ndarray
    stalled: np.ndarray
    names: Mapping[str, str]
    dropped: Mapping[str, int] = field(default_factory=dict)
    mended: tuple[int, float] = (0, 0.0)

    @property
    def interval(self) -> float:
        """Median step, s."""
        return float(np.median(np.diff(self.time)))

    @property
    def averaged(self) -> bool:
        """Whether rows are averages, not samples."""
        return self.interval > SAMPLED

    @property
    def points(self) -> bool:
        """Whether each row is a steady point."""
        return self.interval > POINTS

    @property
    def loaded_voltage(self) -> float:
        """Median voltage with the motor turning, V; NaN if it never turns."""
        turning = np.zeros(len(self.time), bool) if self.speed is None else self.speed > 0.0
        return float(np.median(self.voltage[turning])) if turning.any() else float("nan")

    def steady_points(self) -> SteadyPoints:
        """Steady points with the motor turning; if rows are points, all of them."""
        if self.speed is None:
            return SteadyPoints(*np.empty((3, 0)), np.nan)
        if self.points and (turning := self.speed > 0.0).any():
            signal = self.signal[turning]
            return SteadyPoints(signal, self.voltage[turning], self.speed[turning], float(signal.min()))
        return steady_points(self.time, self.signal, self.speed, self.voltage, ~self.stalled, self.span.low)

    def filled_speed(self, wrong: np.ndarray) -> np.ndarray:
        """The measured speed (n,) as a command, rpm, interpolated over empty cells, stalled rows and `wrong` (n,). BadInput
        without one."""
        there = np.isfinite(self.speed) & ~self.stalled & ~wrong if self.speed is not None else np.zeros(0, bool)
        if not there.any():
            raise BadInput(
                self.source, "columns", "no speed", "the motor's optical or electrical speed for --speed-from measured"
            )
        return np.interp(self.time, self.time[there], self.speed[there])

    def record(self, omega_ref: np.ndarray, keep_stalls: bool = False) -> Record:
        """The record, with thrust as logged, and `beta_ref` 0 (fixed pitch).

        Repeated thrust is empty, and so are readings of stalled rows unless `keep_stalls`. The voltage has no gaps, because it
        is an effect's input: late rows hold the value from before the stall.
        """
        late, stalled = (np.zeros_like(rows) if keep_stalls else rows for rows in (self.late, self.stalled))
        columns = {"time": self.time, "omega_ref": omega_ref, "beta_ref": np.zeros(len(self.time))}
        if self.speed is not None:
            columns["omega"] = np.where(stalled, np.nan, self.speed)
        columns["thrust"] = np.where(stalled | self.repeated, np.nan, self.thrust)
        columns["voltage"] = _held(np.where(late, np.nan, self.voltage))
        if self.current is not None:
            columns["current"] = np.where(late, np.nan, self.current)
        return Record(columns, self.source)


def read_log(path: str | os.PathLike) -> Log:
    """Read a log. BadInput: a column is missing, a unit is unknown, a cell is not a number, or time decreases."""
    table = read_delimited(path, {})
    headers = {_split(name)[0]: name for name in table.columns}
    needed = {"time": "Time", "signal": "ESC signal", "thrust": "Thrust", "voltage": "Voltage"}
    names = {quantity: _find(table, headers, name) for quantity, name in needed.items()}
    rows, dropped = _rows(table, names)
    table = replace(table, columns={name: column[rows] for name, column in table.columns.items()}, lines=table.lines[rows])
    names |= {"current": headers["current"]} if "current" in headers else {}
    values = {quantity: _converted(table, name, quantity) for quantity, name in names.items() if quantity != "signal"}
    speed = _speed(table, headers)
    names |= {"speed": speed} if speed else {}
    signal = _held(table.numbers(names["signal"]))
    time, *mending = mended(values["time"] - values["time"][0])
    late, stalled = _stalls(time)
    once, _ = read_once(Record({"time": time, "thrust": values["thrust"]}, table.source))
    for quantity in ("thrust", "voltage"):
        if not np.isfinite(values[quantity]).any():
            raise BadInput(path, f"column {names[quantity]}", "empty cells only", f"measured {quantity}")
    return Log(
        source=str(path),
        start=float(values["time"][0]),
        time=time,
        signal=signal,
        span=_span(table, names["signal"], signal),
        speed=_converted(table, speed, "speed") if speed else None,
        thrust=values["thrust"],
        voltage=_held(values["voltage"]),
        current=values.get("current"),
        repeated=np.isfinite(values["thrust"]) & ~np.isfinite(once["thrust"]),
        late=late,
        stalled=stalled,
        names=names,
        dropped={**table.left_out, **dropped},
        mended=tuple(mending),
    )


def _split(header: str) -> tuple[str, str]:
    """Name and unit of a header such as "Thrust (gf)", both in lower case."""
    name, unit = re.fullmatch(r"(.*?)\s*(?:\(([^()]*)\))?", header).groups()
    return name.lower(), (unit or "").strip().lower()


def _find(table: RawTable, headers: Mapping[str, str], name: str) -> str:
    same = [header for header in table.columns if _split(re.sub(r"\.\d+$", "", header))[0] == name.lower()]
    if len(same) == 1:
        return same[0]
    found = f"{len(same)} of it: {', '.join(same)}" if same else f"only {', '.join(table.columns)}"[:200]
    raise BadInput(table.source, f"column {name}", found, "a log of RCbenchmark with its own header")


def _speed(table: RawTable, headers: Mapping[str, str]) -> str | None:
    """The header of the preferred speed that is not always 0; else of the preferred speed with any reading."""
    readings = {headers[name]: table.numbers(headers[name]) for name in _SPEEDS if name in headers}
    there = [name for name, column in readings.items() if np.isfinite(column).any()]
    moving = [name for name in there if np.nanmax(np.abs(readings[name])) > 0.0]
    return next(iter(moving or there), None)


def _converted(table: RawTable, header: str, quantity: str) -> np.ndarray:
    """A column (n,) in the record's unit, NaN for an empty cell."""
    units = _UNITS[quantity]
    unit = _split(header)[1]
    if unit not in units:
        raise BadInput(table.source, f"column {header}, unit", repr(unit), f"one of {', '.join(units)}")
    return table.numbers(header) * units[unit]


def _rows(table: RawTable, names: Mapping[str, str]) -> tuple[np.ndarray, dict[str, int]]:
    """(rows to keep, numbers of skipped rows by reason). BadInput if time decreases by a row or more."""
    time, signal = table.numbers(names["time"]), table.numbers(names["signal"])
    timed = np.isfinite(time)
    if not np.isfinite(signal).any():
        way = "vpp import csv takes the measured speed in its place (omega_ref=COLUMN:UNIT)"
        raise BadInput(table.source, f"column {names['signal']}", "empty cells only", f"the signal that drove the motor; {way}")
    begun = np.maximum.accumulate(np.isfinite(signal))
    rows = np.flatnonzero(timed & begun)
    if len(rows) < 2:
        raise BadInput(table.source, "rows", f"{len(rows)} with time and ESC signal", "at least two")
    moved = np.round(np.diff(time[rows]), 9)
    if (far := moved < -np.median(moved)).any():
        row = int(np.argmax(far))
        found = f"{time[rows[row + 1]]:.9g} after {time[rows[row]]:.9g}"
        raise table.wrong(names["time"], rows[row + 1], found, "time that doesn't go back by a row or more")
    kept = rows[np.append(moved != 0.0, True)]  # of rows at equal time the last, whose cells are the most recent
    if len(kept) < 2:
        raise BadInput(table.source, names["time"], f"one and the same in {len(rows)} rows", "a time that increases")
    early = int((timed & ~begun).sum())
    return kept, {
        "no time": int((~timed).sum()),
        "before the first ESC signal": early,
        "at the time of the next row": len(rows) - len(kept),
    }


def _held(column: np.ndarray) -> np.ndarray:
    """The column with empty cells filled by the last value, at its start by the first."""
    filled = np.isfinite(column)
    last = np.maximum.accumulate(np.where(filled, np.arange(len(column)), -1))
    return column[np.where(last < 0, np.argmax(filled), last)]


def _stalls(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Masks (n,): rows right after a stall; all rows affected by a stall."""
    step = np.diff(time)
    late = np.append(False, step > STALL * np.median(step))
    late &= np.median(step) < SAMPLED
    stalled = np.convolve(late, np.ones(REMEMBERED, bool))[: len(time)] > 0
    return late, stalled


def _span(table: RawTable, header: str, signal: np.ndarray) -> SignalRange:
    """DShot or PWM, from the header's unit, else from the values: PWM is at least 900 us."""
    unit = _split(header)[1]
    if unit not in ("", *_US):
        raise BadInput(table.source, f"column {header}, unit", repr(unit), "µs, or none for DShot")
    span = RANGES["PWM" if unit in _US or signal.min() >= 900.0 else "DShot"]
    low, high = (700.0, 2300.0) if span.kind == "PWM" else (span.low, span.high)
    outside = (signal < low) | (signal > high)
    if outside.any():
        row = int(np.argmax(outside))
        raise table.wrong(header, row, f"{signal[row]:.9g}", f"{low:g} to {high:g} for {span.kind}")
    return span
