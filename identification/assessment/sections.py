"""Sections of a record in which only the speed command, only the pitch command, or both change."""

import numpy as np

from vpp_fmu.record import Record

STILL = 5.0
"""A command constant for this long [s] counts as still: the channel has settled and its lags have no influence."""

SHORTEST = 1.0
"""Minimum duration of a section, s."""

NAMES = ("speed only", "pitch only", "both", "steady")


def sections(record: Record) -> dict[str, np.ndarray]:
    """Mask (rows,) of each section of the record, by its name in NAMES."""
    speed, pitch = (_still(record.time, record[name]) for name in ("omega_ref", "beta_ref"))
    masks = (pitch & ~speed, speed & ~pitch, ~speed & ~pitch, speed & pitch)
    row = (record.time[-1] - record.time[0]) / max(1, len(record) - 1)
    return {name: mask for name, mask in zip(NAMES, masks, strict=True) if mask.sum() * row >= SHORTEST}


def _still(time: np.ndarray, command: np.ndarray) -> np.ndarray:
    """Rows in holds of the command of at least STILL seconds, or of the whole record."""
    starts = np.flatnonzero(np.append(True, command[1:] != command[:-1]))
    ends = np.append(starts[1:], len(command) - 1)
    still = np.zeros(len(command), bool)
    for start, end in zip(starts, ends, strict=True):
        if time[end] - time[start] >= min(STILL, time[-1] - time[0]):
            still[start : end + 1] = True
    return still
