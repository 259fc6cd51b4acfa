"""A record: commands and measurements over time. Read, checked, written as CSV."""

import csv
import gzip
import io
import math
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from vpp_fmu.errors import BadInput, RecordWarning, near
from vpp_fmu.files import OutputFolder, as_bytes
from vpp_fmu.frames import frame_table, library
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.signals import BETA, BETA_REF, OMEGA, OMEGA_REF, POWER, THRUST, TORQUE
from vpp_fmu.kernel.types import Signal
from vpp_fmu.notebook import table_html
from vpp_fmu.sensors import UNKNOWN, SpeedSensor
from vpp_fmu.table import Table, read_table

VOLTAGE = Signal("voltage", "V", "supply voltage", 0.0, 100.0, 25.0)
CURRENT = Signal("current", "A", "supply current", -500.0, 500.0, 10.0)
MEASURED = (OMEGA, THRUST, BETA, VOLTAGE, CURRENT, TORQUE, POWER)
QUANTITIES = {s.name: s for s in (OMEGA_REF, BETA_REF, *MEASURED, *CONTROLLER.inputs)}
"""Known columns beside `time`, by name, with unit and range."""

COMMANDS = ("time", "omega_ref", "beta_ref")

MOST_POINTS = 2_000_000
"""Communication points of a closed loop, 8000 s in steps of 4 ms: a run then takes about 1 GB of memory."""


class FixedInputs(dict):
    """Inputs of a simulation by name, (n,) each, and the `steps` of their rows, which nobody changes. `memo`: what models take
    of them, as one array each."""

    def __init__(self, columns: Mapping[str, np.ndarray], steps: np.ndarray):
        super().__init__(columns)
        self.steps = steps
        self.memo: dict = {}


@dataclass(frozen=True, eq=False)
class Record:
    """Columns by name, each (n,), in the units of QUANTITIES, and the file they came from.

    Commands are zero-order holds: a row's value acts from that row's time on, or from a share `late` (0 to below 1) of the row
    later. Measured values are sampled at the row's time; NaN: no reading. `sensor`: the speed sensor.

    >>> record = vpp.read_campaign(vpp.example_campaign()).open_loop
    >>> record
    Record(22500 rows, 89.996 s every 4 ms: time, omega_ref, beta_ref, omega, thrust)
    >>> record["thrust"].shape
    (22500,)
    >>> vpp.Record({"time": [0.0, 0.5], "omega_ref": [4000.0, 4200.0], "beta_ref": [5.0, 5.0]}, "by hand").steps
    array([0.5])
    """

    columns: Mapping[str, np.ndarray]
    source: str
    late: float = 0.0
    sensor: SpeedSensor = UNKNOWN

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", {name: np.asarray(column) for name, column in self.columns.items()})
        if len({len(column) for column in self.columns.values()}) != 1:
            raise ValueError(f"columns of unequal length: { ({n: len(c) for n, c in self.columns.items()}) }")

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __len__(self) -> int:
        return len(self.time)

    @property
    def time(self) -> np.ndarray:
        """(n,) s."""
        return self.columns["time"]

    @cached_property
    def steps(self) -> np.ndarray:
        """(n - 1,) s from row to row, rounded to the nanosecond: a grid written as 0.004 s gives exactly 0.004 each time."""
        return np.round(np.diff(self.time), 9)

    @cached_property
    def run(self) -> tuple[Mapping[str, np.ndarray], np.ndarray, float]:
        """(columns, steps, late): the inputs of a simulation of these rows. Empty cells of the voltage are interpolated."""
        volts, inputs = self.columns.get(VOLTAGE.name), FixedInputs(self.columns, self.steps)
        if volts is not None and not (seen := np.isfinite(volts)).all() and seen.any():
            inputs[VOLTAGE.name] = np.interp(self.time, self.time[seen], volts[seen])
        return inputs, self.steps, self.late

    def commands_later(self, rows: float) -> "Record":
        """The record with commands that act `rows` rows later (negative: earlier), beside the same readings.

        The first command is extended backwards and the last one forwards.
        """
        whole = math.floor(self.late + rows)
        taken = np.clip(np.arange(len(self)) - whole, 0, len(self) - 1)
        moved = {name: self.columns[name][taken] for name in ("omega_ref", "beta_ref") if name in self}
        return replace(self.with_columns(**moved), late=self.late + rows - whole)

    @property
    def period(self) -> float:
        """Median time between rows [s]; NaN for a single row."""
        return float(np.median(self.steps)) if len(self) > 1 else math.nan

    def __repr__(self) -> str:
        period = f" every {1e3 * self.period:.4g} ms" if len(self) > 1 else ""
        return f"Record({len(self)} rows, {float(self.time[-1]):.6g} s{period}: {', '.join(self.columns)})"

    def _repr_html_(self) -> str:
        rows = []
        for name, column in self.columns.items():
            seen = column[np.isfinite(column)] if column.dtype.kind == "f" else column[:0]
            ends = (float(seen.min()), float(seen.max())) if len(seen) else (None, None)
            rows.append((name, self.units.get(name, ""), *ends, len(column) - len(seen) if column.dtype.kind == "f" else 0))
        return table_html(f"{self.source}: {len(self)} rows", ("column", "unit", "least", "greatest", "empty"), rows)

    @property
    def units(self) -> dict[str, str]:
        """Units of the known columns, by name."""
        known = {"time": "s"} | {name: signal.unit for name, signal in QUANTITIES.items()}
        return {name: known[name] for name in self.columns if name in known}

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the record as a CSV file, gzipped where the name ends in .gz; returns its path. BadInput."""
        path = Path(path)
        return write_record(OutputFolder(path.parent), path.name, self)

    def to_pandas(self) -> Any:
        """The columns as a pandas.DataFrame, (n,) rows numbered from 0. ExtraMissing where pandas is not installed."""
        return library("pandas").DataFrame(dict(self.columns))

    def to_polars(self) -> Any:
        """The columns as a polars.DataFrame. ExtraMissing where polars is not installed."""
        frame = library("polars").DataFrame
        return frame({name: column.tolist() if column.dtype == object else column for name, column in self.columns.items()})

    def to_xarray(self) -> Any:
        """The columns as an xarray.Dataset over `time`, units in the attribute `units`. ExtraMissing without xarray."""
        units = {name: {"units": unit} for name, unit in self.units.items()}
        arrays = {name: ("time", column, units.get(name, {})) for name, column in self.columns.items()}
        time = arrays.pop("time")
        return library("xarray").Dataset(arrays, {"time": time})

    @classmethod
    def from_frame(
        cls, frame: Any, source: str = "frame", need: Sequence[str] = COMMANDS, holes: Sequence[str] = ("thrust",)
    ) -> "Record":
        """A record from a frame of pandas or polars, an xarray.Dataset, or arrays by name; checked as a file is.

        Missing values of measured columns, and of those in `holes`, become NaN. BadInput names column and row.

        >>> vpp.Record.from_frame({"time": [0.0, 0.004], "omega_ref": [4000, 4000], "beta_ref": [5, 5], "thrust": [6.1, None]})
        Record(2 rows, 0.004 s every 4 ms: time, omega_ref, beta_ref, thrust)
        >>> vpp.Record.from_frame({"time": [0.0, 0.0], "omega_ref": [4000, 4000], "beta_ref": [5, 5]})
        Traceback (most recent call last):
            ...
        vpp_fmu.errors.BadInput: frame: time, row 1: found 0 after 0 (time stands still), expected a time after ...
        """
        table = frame_table(frame, source)
        columns = checked_columns(table, need, holes)
        check_time(table, columns["time"])
        return cls(columns, source)

    def part(self, rows: slice | np.ndarray) -> "Record":
        """The rows that a slice, mask or index array selects. Their times stay as they are."""
        return replace(self, columns={name: column[rows] for name, column in self.columns.items()})

    def with_columns(self, **arrays: np.ndarray) -> "Record":
        """This record with columns added or replaced; each (n,)."""
        return replace(self, columns={**self.columns, **{name: np.asarray(array) for name, array in arrays.items()}})


def read_record(path: str | os.PathLike[str], need: Sequence[str] = COMMANDS, holes: Sequence[str] = ()) -> Record:
    """Read a record that holds at least the columns `need`, `time` among them.

    Measured columns beyond these, and those in `holes`, may have empty cells, which become NaN. Unknown columns are kept, as
    float if every cell is a finite number, else as str; one RecordWarning names them. BadInput names other errors and their
    lines.
    """
    table = read_table(path)
    columns = checked_columns(table, need, holes)
    check_time(table, columns["time"])
    return Record(columns, table.source)


PROFILE = ("time", "thrust_set")
"""Columns of a profile."""


def read_profile(path: str | os.PathLike[str]) -> Record:
    """Read a profile: `time` [s] and the wanted thrust `thrust_set` [N], held from row to row. Errors as `read_record`."""
    return read_record(path, PROFILE)


def held(profile: Record, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """(time [s], wanted thrust [N]), each (points,), at the communication points of a profile, `dt` s from one to the next.
    BadInput where there are more than MOST_POINTS."""
    first, last = float(profile.time[0]), float(profile.time[-1])
    if (last - first) / dt > MOST_POINTS:
        raise BadInput(profile.source, "time", f"{last:g} s", f"at most {MOST_POINTS * dt:g} s in steps of {dt:g} s")
    time = np.arange(round((last - first) / dt) + 1) * dt
    rows = np.searchsorted(profile.time - first, time + 1e-9, side="right") - 1
    return time, np.ascontiguousarray(profile["thrust_set"][rows], float)


def digit_of(values: np.ndarray) -> float:
    """The resolution of a display: the smallest difference of two of its values (n,); 0 if all are equal."""
    different = np.unique(values)
    return float(np.diff(different).min()) if len(different) > 1 else 0.0


def checked_columns(table: Table, need: Sequence[str], holes: Sequence[str] = ()) -> dict[str, np.ndarray]:
    """The table's columns. Known and needed ones are numbers within their range. BadInput, RecordWarning."""
    for name in need:
        if name not in table.columns:
            allowed = f"a header with {', '.join(need)}, separated by commas"
            allowed += near(name, [other for other in table.columns if other not in need])
            hint = "vpp import csv, which makes a record of a log" if name in COMMANDS else ""
            if len(table.columns) == 1 and ";" in next(iter(table.columns)):
                if "omega_ref" not in need:
                    hint = "save the file with commas between cells and points in numbers"
                raise BadInput(table.source, "header", "cells separated by semicolons", "cells separated by commas", hint)
            raise BadInput(table.source, f"column {name}", f"only {', '.join(table.columns)}"[:200], allowed, hint)
    measured = {signal.name for signal in MEASURED}
    columns, unknown = {}, []
    for name, cells in table.columns.items():
        if name in need or name in QUANTITIES or name == "time":
            gaps = ("",) if name in holes else ("", "nan") if name in measured and name not in need else ()
            columns[name] = table.numbers(name, gaps)
            _check_range(table, name, columns[name])
        else:
            columns[name] = cells
            unknown.append(name)
    if unknown:
        text = f"{table.source}: columns that nothing here knows, kept as they are: {', '.join(unknown)}"
        warnings.warn(text, RecordWarning, stacklevel=3)
    return columns


def _check_range(table: Table, name: str, values: np.ndarray) -> None:
    """BadInput if a value of a known quantity is outside its range."""
    signal = QUANTITIES.get(name)
    if signal is None:
        return
    outside = (values < signal.minimum) | (values > signal.maximum)
    if outside.any():
        row = int(np.argmax(outside))
        allowed = f"{signal.minimum:g} to {signal.maximum:g} {signal.unit}"
        raise table.wrong(name, row, f"{values[row]:.9g}", allowed)


def check_time(table: Table, time: np.ndarray, first: int = 0, what: str = "record") -> None:
    """BadInput if `time`, the table's rows from `first` on, does not start at 0 or does not increase by a nanosecond."""
    if time[0] != 0.0:
        raise table.wrong("time", first, f"{time[0]:.12g}", f"0 in the first row of a {what}")
    later = np.round(np.diff(time), 9) > 0.0  # as Record.steps: no step may vanish
    if not later.all():
        row = int(np.argmin(later)) + 1
        now, before = float(time[row]), float(time[row - 1])
        move = "goes back" if now < before else "stands still"
        found = f"{now:.12g} after {before:.12g} (time {move})"
        raise table.wrong("time", first + row, found, "a time after that of the row before")


def write_record(folder: OutputFolder, name: str, record: Record) -> Path:
    """Write a record as CSV, gzipped if `name` ends in .gz; the same record gives the same bytes.

    Values have at most 9 significant digits, NaN is an empty cell; time is exact to the nanosecond.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(record.columns)
    writer.writerows(zip(*(_cells(n, column) for n, column in record.columns.items()), strict=True))
    data = as_bytes(text.getvalue())
    return folder.write(name, _gzipped(data) if name.endswith(".gz") else data)


def _cells(name: str, column: np.ndarray) -> list[str]:
    if name == "time":
        return [repr(t) for t in np.round(column.astype(float), 9).tolist()]
    if column.dtype.kind == "f":
        return ["" if math.isnan(value) else f"{value:.9g}" for value in column.tolist()]
    return [str(value) for value in column.tolist()]


def _gzipped(data: bytes) -> bytes:
    """gzip.compress is not used: its header differs between systems and versions."""
    packed = io.BytesIO()
    with gzip.GzipFile(filename="", mode="wb", fileobj=packed, mtime=0) as file:
        file.write(data)
    return packed.getvalue()
