"""What of a record can be trusted: refuse what is unusable, leave out what is wrong in parts, and say so."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from vpp_fmu.errors import BadInput
from vpp_fmu.record import Record

FEWEST_ROWS = 200
SHORTEST = 2.0
"""A record needs this many rows and seconds: less than that shows no lag of the rig."""

GAP = 0.25
"""Rows further apart than this, s, are a gap: what was commanded meanwhile is not known."""

AFTER_GAP = 2.0
"""Seconds after a gap that are left out: until then what happened in it has died away."""

CLIPPED = 8
"""Neighbouring rows at exactly the record's extreme that count as clipped, where the noise would move the last digit."""

APART = 6.0
"""Robust standard deviations by which a single reading may stand off the median of its neighbours: of a million readings of
normal noise none does."""

RADIANS = (0.08, 0.13)
"""Ratio of measured to commanded speed from which the column is rad/s: one rpm is 0.105 rad/s."""


@dataclass(frozen=True)
class Screened:
    """A record with empty cells where it can't be trusted, and in words what was left out."""

    record: Record
    notes: tuple[str, ...]


def screen(record: Record) -> Screened:
    """Check a measured record for a fit. BadInput, one line, where nothing can be learnt from it."""
    _refuse(record)
    notes: list[str] = []
    thrust, columns = record["thrust"].copy(), {}
    for name, low, high in _clipped(record.time, thrust):
        notes.append(f"{name}: {high - low} rows from {record.time[low]:.2f} s on stand at the sensor's limit, left out")
        thrust[low:high] = np.nan
    if len(spikes := _spikes(thrust)):
        notes.append(
            f"thrust: {len(spikes)} single readings stand off their neighbours, the first at {record.time[spikes[0]]:.2f} s"
        )
        thrust[spikes] = np.nan
    gaps = np.flatnonzero(record.steps > GAP)
    blind = np.zeros(len(record), bool)
    for row in gaps:
        begin, end = record.time[row], record.time[row + 1]
        blind |= (record.time > begin) & (record.time < end + AFTER_GAP)
        notes.append(f"a gap of {end - begin:.2f} s after {begin:.2f} s: the {AFTER_GAP:g} s behind it are left out")
    thrust[blind] = np.nan
    columns["thrust"] = thrust
    if "omega" in record:
        omega = np.where(blind, np.nan, record["omega"])
        if _dead(record, omega):
            notes.append("omega: the speed sensor does not follow the command, left out")
            omega = np.full(len(record), np.nan)
        columns["omega"] = omega
    screened = record.with_columns(**columns)
    if "omega" in record and not np.isfinite(columns["omega"]).any():
        screened = Record({n: c for n, c in screened.columns.items() if n != "omega"}, record.source)
    return Screened(screened, tuple(notes))


def _refuse(record: Record) -> None:
    seconds = float(record.time[-1])
    if len(record) < FEWEST_ROWS or seconds < SHORTEST:
        found = f"{len(record)} rows over {seconds:g} s"
        raise BadInput(record.source, "rows", found, f"at least {FEWEST_ROWS} rows over {SHORTEST:g} s")
    thrust = record["thrust"][np.isfinite(record["thrust"])]
    if len(thrust) < FEWEST_ROWS // 2:
        raise BadInput(record.source, "thrust", f"{len(thrust)} readings", f"at least {FEWEST_ROWS // 2} readings")
    if np.ptp(thrust) == 0.0:
        raise BadInput(record.source, "thrust", f"{thrust[0]:g} N in all rows", "a sensor that is alive")
    if np.ptp(record["omega_ref"]) == 0.0 and np.ptp(record["beta_ref"]) == 0.0:
        raise BadInput(record.source, "omega_ref and beta_ref", "constant in all rows", "at least one command that moves")
    if "omega" in record:
        moving = (record["omega_ref"] > 0) & np.isfinite(record["omega"])
        ratio = float(np.median(record["omega"][moving] / record["omega_ref"][moving])) if moving.any() else 1.0
        if RADIANS[0] < ratio < RADIANS[1]:
            raise BadInput(record.source, "omega", f"{ratio:.3f} of omega_ref, as rad/s would be", "rpm, as omega_ref")


def _clipped(time: np.ndarray, thrust: np.ndarray):
    """(column, first row, row behind) of stretches at the extremes."""
    moves = np.diff(thrust)
    spread = np.std(moves[np.isfinite(moves)]) if np.isfinite(moves).any() else 0.0
    for extreme in (np.nanmax(thrust), np.nanmin(thrust)):
        at = np.concatenate([[False], thrust == extreme, [False]])
        for low, high in zip(np.flatnonzero(at[1:] & ~at[:-1]), np.flatnonzero(at[:-1] & ~at[1:]), strict=True):
            if high - low >= CLIPPED and spread > 0:
                yield "thrust", int(low), int(high)


def _spikes(thrust: np.ndarray) -> np.ndarray:
    """Rows whose reading stands off the median of five by more than noise does. A rise or a fall is its own median."""
    seen = np.flatnonzero(np.isfinite(thrust))
    if len(seen) < FEWEST_ROWS // 2:
        return seen[:0]
    off = thrust[seen] - median_filter(thrust[seen], 5, mode="nearest")
    moved = np.abs(off[off != 0.0])  # of five readings one is the median itself
    spread = 1.4826 * float(np.median(moved)) if len(moved) else 0.0
    return seen[np.abs(off) > APART * spread] if spread > 0.0 else seen[:0]


def _dead(record: Record, omega: np.ndarray) -> bool:
    """Whether the speed stands still, or is 0, while its command moves."""
    seen = omega[np.isfinite(omega)]
    return len(seen) == 0 or (np.ptp(seen) == 0.0 and np.ptp(record["omega_ref"]) > 0.0) or float(np.max(seen)) <= 0.0
