"""A campaign: a folder of measured files of one rig."""

import os
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import numpy as np

from vpp_fmu.errors import BadInput, RecordWarning
from vpp_fmu.files import OutputFolder, reason
from vpp_fmu.notebook import table_html
from vpp_fmu.record import COMMANDS, Record, check_time, checked_columns, read_record, write_record
from vpp_fmu.rig import FILE, Rig, infer_rig, read_rig
from vpp_fmu.structured import read_object
from vpp_fmu.table import Table, read_table

NAMES = ("static", "steps", "open_loop", "repeat", "validation")
_FILES = ", ".join(f"{name}.csv" for name in NAMES)
RAW = "static_raw"
"""A record of steady holds: the raw samples of `static`, instead of it or beside it."""

NEED = (*COMMANDS, "thrust")
GRID = ("omega_ref", "beta_ref", "omega", "thrust", "thrust_std", "samples")
POWER = ("torque", "voltage", "current", "power")
"""Optional columns of the static map: N.m, V, A, W."""


@dataclass(frozen=True, eq=False)
class StaticMap:
    """Steady points, one per row, each (n,): commands and means of `samples` readings, in rpm, deg, N.

    `thrust_std` [N] is the standard deviation of the single readings, not of their mean. `further`: measured columns of POWER.
    """

    omega_ref: np.ndarray
    beta_ref: np.ndarray
    omega: np.ndarray
    thrust: np.ndarray
    thrust_std: np.ndarray
    samples: np.ndarray
    source: str
    further: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Campaign:
    """The content of a campaign's folder; None, or no steps, for a missing file. Every record has `thrust`.

    `rig`: from its rig.json; missing entries are inferred from the files.

    >>> campaign = vpp.read_campaign(vpp.example_campaign())
    >>> campaign
    Campaign(example: static (100 points), steps (40 runs), open_loop (89.996 s), ...
    >>> campaign.missing
    ()
    """

    folder: Path
    static: StaticMap | None
    steps: tuple[Record, ...]
    open_loop: Record | None
    repeat: Record | None
    validation: Record | None
    static_raw: Record | None = None
    rig: Rig = field(default_factory=Rig)

    def __repr__(self) -> str:
        return f"Campaign({self.folder.name}: {', '.join(f'{name} ({size})' for name, size in self._sizes())})"

    def _repr_html_(self) -> str:
        return table_html(f"Campaign {self.folder.name}", ("file", "holds"), self._sizes())

    def _sizes(self) -> list[tuple[str, str]]:
        """(name, size in words) of each file that exists."""
        found = [] if self.static is None else [("static", f"{len(self.static.thrust)} points")]
        found += [("steps", f"{len(self.steps)} runs")] if self.steps else []
        records = ((name, getattr(self, name)) for name in ("open_loop", "repeat", "validation", RAW))
        return found + [(name, f"{record.time[-1]:.6g} s") for name, record in records if record is not None]

    @property
    def label(self) -> str:
        """Name and date of the campaign, for the head of a report."""
        date = measured_on(self.folder)[:10]
        return f"campaign {self.folder.resolve().name}, {f'measured on {date}' if date else 'no date of measurement'}"

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of the missing files."""
        return tuple(f"{name}.csv" for name in NAMES if getattr(self, name) in (None, ()))


def read_campaign(folder: str | os.PathLike) -> Campaign:
    """Read a campaign; each file may be .csv or .csv.gz, any may be missing.

    BadInput: no folder, none of the files, an invalid file, or a repeat with other commands than the open loop.
    """
    folder = Path(folder)
    there = _listed(folder)
    paths = _paths(folder, there)
    records = {n: _measured(paths[n]) if n in paths else None for n in ("open_loop", "repeat", "validation", RAW)}
    if records["open_loop"] is not None and records["repeat"] is not None:
        check_repeat(records["open_loop"], records["repeat"])
    static = read_static(paths["static"]) if "static" in paths else None
    steps = read_steps(paths["steps"]) if "steps" in paths else ()
    declared = read_rig(folder / FILE) if FILE in there else {}
    return Campaign(folder, static, steps, **records, rig=_rig(records, static, steps, declared))


def _rig(records: Mapping[str, Record | None], static: StaticMap | None, steps: Sequence[Record], declared: Mapping) -> Rig:
    """The rig by all fitted files, or by the validation record if there are no others."""
    fitted = [r for n, r in records.items() if r is not None and n != "validation"] + list(steps)
    if not fitted and static is None:
        fitted = [r for r in records.values() if r is not None]
    grid = None if static is None else {name: getattr(static, name) for name in ("omega_ref", "beta_ref", "thrust")}
    return infer_rig(fitted, grid, declared)


def _measured(path: Path) -> Record:
    """A record that has thrust; single cells may be empty. Other columns without any value are dropped."""
    record = read_record(path, NEED, holes=("thrust",))
    if np.isfinite(record["thrust"]).sum() < 2:
        raise BadInput(path, "thrust", "fewer than two numbers", "a column of numbers, in which some cells may be empty")
    empty = [n for n, c in record.columns.items() if c.dtype.kind == "f" and not np.isfinite(c).any()]
    if empty:
        warnings.warn(f"{path}: columns without a single value, left out: {', '.join(empty)}", RecordWarning, stacklevel=2)
    return Record({n: c for n, c in record.columns.items() if n not in empty}, record.source)


def _listed(folder: Path) -> set[str]:
    allowed = f"a folder with any of {_FILES}"
    try:
        return set(os.listdir(folder))
    except FileNotFoundError as error:
        raise BadInput(folder, "campaign folder", "no such folder", allowed) from error
    except NotADirectoryError as error:
        if not folder.exists():
            raise BadInput(folder, "campaign folder", "no such folder", allowed) from error
        own = folder.name.removesuffix(".gz") in _FILES.split(", ")
        hint = f"its folder, {folder.parent}" if own else f"vpp import csv {folder} -o mine, which makes one of a log"
        raise BadInput(folder, "campaign folder", "a file", allowed, hint) from error
    except OSError as error:
        raise BadInput(folder, "campaign folder", f"not readable ({reason(error)})", allowed) from error


def _paths(folder: Path, there: set[str]) -> dict[str, Path]:
    paths: dict[str, Path] = {}
    for name in (*NAMES, RAW):
        found = [file for file in (f"{name}.csv", f"{name}.csv.gz") if file in there]
        if len(found) > 1:
            raise BadInput(folder, f"{name}.csv", f"{found[0]} and {found[1]}", "only one of them")
        paths.update((name, folder / file) for file in found)
    if not paths:
        raise BadInput(
            folder, "campaign folder", "none of a campaign's files", f"any of {_FILES} (or .csv.gz)", "vpp import csv for a log"
        )
    return paths


def measured_on(folder: Path) -> str:
    """Date of a campaign, ISO 8601: from its hil.json, else from its folder's name, else ""."""
    try:
        said = read_object(folder / "hil.json")["begun"]
        return datetime.fromisoformat(said).isoformat()
    except (BadInput, ValueError, KeyError, TypeError):
        pass
    for year, month, day in re.findall(r"(?<!\d)(20\d\d)[-_.]?(\d\d)[-_.]?(\d\d)(?!\d)", folder.resolve().name):
        try:
            return datetime(int(year), int(month), int(day)).date().isoformat()
        except ValueError:
            continue
    return ""


def check_repeat(record: Record, repeat: Record) -> None:
    """BadInput if `repeat` has other times or commands than `record`."""
    n = min(len(record), len(repeat))
    for name in COMMANDS:
        wanted, found = record[name][:n], repeat[name][:n]
        same = np.round(wanted, 9) == np.round(found, 9) if name == "time" else wanted == found
        if not same.all():
            row = int(np.argmin(same))
            allowed = f"{wanted[row]:.12g} as in {record.source}"
            raise BadInput(repeat.source, f"{name}, row {row + 1} of the data", f"{found[row]:.12g}", allowed)
    if len(record) != len(repeat):
        allowed = f"{len(record)} rows as in {record.source}"
        raise BadInput(repeat.source, f"row {n + 1} of the data", f"{len(repeat)} rows in all", allowed)


def read_static(path: str | os.PathLike) -> StaticMap:
    """Read steady points. Columns beyond GRID and POWER are not used; one RecordWarning names them. BadInput names line and
    cell."""
    table = read_table(path)
    own = (*GRID, *(name for name in POWER if name in table.columns))
    extra = [name for name in table.columns if name not in own]
    if extra:
        warnings.warn(f"{path}: columns of a static map that are not used: {', '.join(extra)}", RecordWarning, stacklevel=2)
    known = {name: column for name, column in table.columns.items() if name in own}
    columns = checked_columns(Table(table.source, known, table.lines), own)
    _check_rows(table, "thrust_std", columns, columns["thrust_std"] >= 0.0, "0 N or more")
    samples = columns["samples"]
    _check_rows(table, "samples", columns, (samples >= 1.0) & (samples == np.round(samples)), "a whole number from 1")
    further = {name: columns.pop(name) for name in own if name in POWER}
    return StaticMap(**columns, source=table.source, further=further)


def write_static(folder: OutputFolder, static: StaticMap) -> Path:
    """Write steady points as static.csv, values to at most 9 significant digits."""
    columns = {name: getattr(static, name) for name in GRID} | dict(static.further)
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return folder.write(
        "static.csv", "\n".join([",".join(columns), *(",".join(f"{v:.9g}" for v in row) for row in rows)]) + "\n"
    )


def write_steps(folder: OutputFolder, runs: Sequence[Record]) -> Path:
    """Write runs of the same columns as steps.csv, numbered from 0."""
    numbered = [r.with_columns(run=np.full(len(r), float(k))) for k, r in enumerate(runs)]
    columns = {n: np.concatenate([r[n] for r in numbered]) for n in ("run", *runs[0].columns)}
    return write_record(folder, "steps.csv", Record(columns, "steps"))


def read_steps(path: str | os.PathLike) -> tuple[Record, ...]:
    """Read step responses: records in one file, numbered by the column `run`, each with its own time from 0.

    The records come without `run`; their source names it. BadInput as for a record, and if a run's rows are not contiguous.
    """
    table = read_table(path)
    columns = checked_columns(table, ("run", *NEED))
    run = columns["run"]
    _check_rows(table, "run", columns, run == np.round(run), "a whole number")
    starts = np.flatnonzero(np.append(True, run[1:] != run[:-1]))
    records, seen = [], set()
    del columns["run"]
    for first, end in zip(starts, [*starts[1:], len(run)], strict=True):
        number = int(run[first])
        if number in seen:
            raise table.wrong("run", int(first), f"run {number} a second time", "the rows of a run one after another")
        seen.add(number)
        part = {name: column[first:end] for name, column in columns.items()}
        check_time(table, part["time"], int(first), "run")
        records.append(Record(part, f"{path}, run {number}"))
    return tuple(records)


def _check_rows(table: Table, name: str, columns: dict[str, np.ndarray], good: np.ndarray, allowed: str) -> None:
    if not good.all():
        row = int(np.argmin(good))
        raise table.wrong(name, row, f"{columns[name][row]:.9g}", allowed)
