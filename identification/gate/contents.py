"""Contents of a campaign's files, and missing files and columns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from identification.gate.files import File
from vpp_fmu.campaign import NAMES, RAW, Campaign
from vpp_fmu.record import QUANTITIES
from vpp_fmu.rig import DECLARED, FILE

ROLES = {
    "static": "means at steady points: the thrust map",
    "steps": "one step a run: start values of the lags",
    "open_loop": "the record that the model is fitted to",
    "repeat": "the same commands again: the noise",
    "validation": "other commands: the hold-out record",
    RAW: "raw readings of steady points, in place of static.csv",
}
"""Role of each file."""

MISSING = {
    "static": "the map is estimated from the records and the settled ends of step responses; units and tare cannot be compared",
    "steps": "the search for the lags starts at the model's defaults",
    "open_loop": "only a repeat, or a record given by --record, can be fitted",
    "repeat": "noise and model error are distinguished less reliably",
    "validation": "there is no hold-out error, only errors of fitted data",
    FILE: "the rig's ranges and scales are inferred from the commands and readings",
}
"""Consequence of each missing file."""


@dataclass(frozen=True)
class FileContents:
    """Content of one file. `columns`: by name, minimum, maximum (None for text) and number of empty cells. `rate`: rows per
    second; `runs`: number of step runs."""

    name: str
    file: str
    role: str
    rows: int
    seconds: float | None
    rate: float | None
    columns: Mapping[str, tuple[float | None, float | None, int]] = field(default_factory=dict)
    runs: int | None = None

    def row(self) -> tuple[str, ...]:
        rows = f"{self.rows}" + (f" in {self.runs} runs" if self.runs else "")
        ranges = [self._range(name) for name in ("omega_ref", "beta_ref", "thrust")]
        others = [n for n in self.columns if n not in ("time", "omega_ref", "beta_ref", "thrust", "thrust_std", "samples")]
        seconds = "" if self.seconds is None else f"{self.seconds:.4g}"
        rate = "" if self.rate is None else f"{self.rate:.4g}"
        empty = ", ".join(f"{count} {name}" for name, (_, _, count) in self.columns.items() if count) or "none"
        return (self.file, self.role, rows, seconds, rate, *ranges, " ".join(others) or "none", empty)

    def _range(self, name: str) -> str:
        low, high, _ = self.columns.get(name, (None, None, 0))
        return "" if low is None else f"{low:.4g} to {high:.4g}"

    def summary(self) -> dict:
        """For check.json."""
        columns = {n: {"unit": _unit(n), "min": a, "max": b, "empty": k} for n, (a, b, k) in self.columns.items()}
        base = {"file": self.file, "is": self.role, "rows": self.rows, "runs": self.runs}
        return base | {"seconds": self.seconds, "rate": self.rate, "columns": columns}


COLUMNS = ("file", "is", "rows", "s", "Hz", "omega_ref [rpm]", "beta_ref [deg]", "thrust [N]", "further columns", "empty cells")


def contents(files: Sequence[File]) -> list[FileContents]:
    """Content of each file, in a campaign's order."""
    order = [*NAMES, RAW]
    return sorted(map(_content, files), key=lambda h: order.index(h.name) if h.name in order else len(order))


def _content(file: File) -> FileContents:
    role, short = ROLES.get(file.name, "a further record to fit"), file.where.rsplit("/", 1)[-1]
    if file.static is not None:
        names = ("omega_ref", "beta_ref", "omega", "thrust", "thrust_std", "samples")
        columns = {n: _span(getattr(file.static, n)) for n in names}
        return FileContents(file.name, short, role, len(file.static.thrust), None, None, columns)
    seconds = sum(float(r.time[-1]) for r in file.records)
    steps = np.concatenate([r.steps for r in file.records])
    rate = float(1.0 / np.median(steps)) if len(steps) else None
    columns = {n: _span(np.concatenate([r[n] for r in file.records])) for n in file.records[0].columns}
    rows, runs = sum(map(len, file.records)), len(file.records) if file.name == "steps" else None
    return FileContents(file.name, short, role, rows, seconds, rate, columns, runs)


def _span(values: np.ndarray) -> tuple[float | None, float | None, int]:
    if values.dtype.kind != "f":
        return None, None, int(np.sum(values == ""))
    seen = values[np.isfinite(values)]
    empty = len(values) - len(seen)
    return (float(seen.min()), float(seen.max()), empty) if len(seen) else (None, None, empty)


def _unit(name: str) -> str | None:
    known = {"time": "s", "samples": "1", "thrust_std": "N"}
    return QUANTITIES[name].unit if name in QUANTITIES else known.get(name)


def missing(campaign: Campaign, files: Sequence[File]) -> dict[str, str]:
    """Missing files and columns, with the consequence."""
    found = {f"{name}.csv": MISSING[name] for name in NAMES if f"{name}.csv" in campaign.missing}
    if campaign.static is None and campaign.static_raw is not None:
        del found["static.csv"]
    if DECLARED not in campaign.rig.origin.values():
        found[FILE] = MISSING[FILE]
    for file in files:
        if file.records and not any("omega" in r for r in file.records) and file.name != "steps":
            short = file.where.rsplit("/", 1)[-1]
            found[f"{short}, omega"] = "the speed's lags come from the thrust alone"
    return found
