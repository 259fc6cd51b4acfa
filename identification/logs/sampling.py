"""Cells of a log that are no measurements: readings that repeat, rows behind stalls of the logger."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from identification.gate.files import files_of, said_of_size
from identification.gate.gate import look
from identification.gate.sensors import runs_of_equals
from vpp_fmu.campaign import Campaign
from vpp_fmu.record import Record, digit_of
from vpp_fmu.rig import infer_rig

REPEATED, BY_CHANCE = 0.2, 4.0
"""Minimum share of readings that equal the one before, in half of a record's PARTS, for repeats; and its minimum ratio to the
share by chance, 1 / (2 sqrt(pi) s) for noise with a standard deviation of s digits."""

PARTS = 20
"""Parts of a record: a rotor at rest has equal readings, too, but not everywhere."""

LONGEST = 3.0
"""Ratio of the longest run of repeats to the usual one."""

FEWEST_REPEATS = 100
"""Minimum number of new readings to detect repeats: a coarse sensor without noise changes with the command only."""

REMEMBERED = 7
"""Rows after a stall in which speed and thrust still settle: 0.3, 0.12, 0.06, 0.03, 0.015, 0.007 of a step remains."""

GAP = 4.0
"""A step longer than this many median steps is a stall."""

SAMPLED = 0.04
"""Longest median interval [s] of a stand's samples, which it takes every 8 to 12 ms; rows 125 ms apart are averages."""


@dataclass(frozen=True, eq=False)
class Stalls:
    """Cells of a stand's log that are no measurements, masks (n,): `late` rows, right after a stall of the logger; `stalled`
    rows, whose readings it affects; `repeated` cells of thrust. `said`: a message on repeats, if any."""

    late: np.ndarray
    stalled: np.ndarray
    repeated: np.ndarray
    said: tuple[str, ...]

    @classmethod
    def of(cls, time: np.ndarray, thrust: np.ndarray) -> "Stalls":
        """Those of a log, each (n,)."""
        step = np.diff(time)
        late = np.append(False, step > GAP * np.median(step)) & (np.median(step) < SAMPLED)
        stalled = np.convolve(late, np.ones(REMEMBERED, bool))[: len(time)] > 0
        once, said = read_once(Record({"time": time, "thrust": thrust}, ""))
        return cls(late, stalled, np.isfinite(thrust) & ~np.isfinite(once["thrust"]), tuple(said))

    def emptied(self, columns: Mapping[str, np.ndarray], keep: bool = False) -> dict[str, np.ndarray]:
        """Columns (n,) without these cells; `keep`: only without repeats. A late voltage is that of the row before."""
        late, stalled = (np.zeros_like(rows) if keep else rows for rows in (self.late, self.stalled))
        empty = {"thrust": stalled | self.repeated, "omega": stalled, "torque": stalled, "current": late, "power": late}
        kept = {name: np.where(empty[name], np.nan, c) if name in empty else c for name, c in columns.items()}
        if "voltage" in kept:
            before = np.maximum.accumulate(np.where(late, 0, np.arange(len(late))))
            kept["voltage"] = kept["voltage"][before]
        return kept


def read_once(record: Record) -> tuple[Record, list[str]]:
    """(the record with repeated thrust readings emptied, a message if there are any).

    An amplifier that is slower than the rows is read several times per conversion. A reading counts once, at the row in which
    it is new. Runs longer than LONGEST usual ones stay as they are: the sensor is frozen or clipped.
    """
    seen = np.flatnonzero(np.isfinite(record["thrust"]))
    thrust = record["thrust"][seen]
    first, length = runs_of_equals(thrust)
    if len(first) < FEWEST_REPEATS:
        return record, []
    change = np.abs(np.diff(thrust[first]))
    equal = float(np.median([np.mean(part) for part in np.array_split(np.diff(thrust) == 0.0, PARTS)]))
    if equal < REPEATED:
        return record, []
    by_chance = digit_of(thrust) / (np.sqrt(2.0 * np.pi) * 1.4826 * float(np.median(change)))
    if equal < BY_CHANCE * by_chance:
        return record, []
    usual = float(np.median(length))
    again = np.ones(len(seen), bool)
    again[first] = False
    again &= np.repeat(length <= LONGEST * usual, length)
    emptied = record["thrust"].copy()
    emptied[seen[again]] = np.nan
    every = record.period * len(seen) / max(1, len(seen) - int(again.sum()))
    count = f"{int(again.sum())} of {len(seen)} cells repeat the reading before, a new one comes every {1e3 * every:.3g} ms"
    return record.with_columns(thrust=emptied), [f"thrust: {count}: repeats are emptied"]


def screened(record: Record) -> list[str]:
    """The findings of the quality gate on a record, and the size of its rotor, in words."""
    found = look(Campaign(Path("."), None, (), record, None, None, rig=infer_rig([record], None, {})))
    return [*(f.text for f in found.findings), *said_of_size(files_of(found.campaign, {}))]
