"""The colour of the thrust noise: what a model can't be blamed for.

Neighbouring readings share part of their noise. Taken as independent they count too often, and any flexible candidate then
finds "evidence"; so residuals are whitened before they are judged. Rows are averaged to about 16 ms first, far above
anything the rig's actuators do, and an autoregressive model of order 6 holds the rest of the colour.
"""

from dataclasses import dataclass

import numpy as np

from vpp_fmu.record import Record

ORDER = 6
BLOCK = 0.016
"""Rows are averaged to blocks of about this length, s."""

BAND = 0.05
"""Means over this many seconds hold what is below 10 Hz: above that the rotor's own vibration repeats too."""

SETTLED, ENOUGH, FEWEST = 1.0, 5.0, 20
"""s after a command until the rig rests; s of rest, and readings in each stretch of it, that tell its noise."""


@dataclass(frozen=True)
class Blocks:
    """How a record's rows are averaged: `edges` (blocks + 1,) row numbers, `time` (blocks,) s of the blocks' middles."""

    edges: np.ndarray
    time: np.ndarray

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Block means of (rows,) or (rows, k), rows that are NaN left out; NaN where a block has none."""
        rows = self.edges[1] - self.edges[0]
        values = values[: self.edges[-1]].reshape(-1, rows, *values.shape[1:])
        seen = np.isfinite(values)
        if seen.all():
            return values.mean(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(seen, values, 0.0).sum(axis=1) / seen.sum(axis=1)


def blocks(record: Record, length: float = BLOCK) -> Blocks:
    """Blocks of equal numbers of rows, about `length` seconds each; a rest at the end is left out.

    Where thrust renews more slowly than that, blocks are long enough to hold a reading each.
    """
    renewed = record.time[np.isfinite(record["thrust"])]
    length = max(length, 1.5 * float(np.median(np.diff(renewed)))) if len(renewed) < len(record) else length
    rows = max(1, round(length / float(np.median(record.steps))))
    edges = np.arange(0, len(record) - rows + 1, rows)
    edges = np.append(edges, edges[-1] + rows)
    time = record.time
    return Blocks(edges, 0.5 * (time[edges[:-1]] + time[np.minimum(edges[1:], len(time)) - 1]))


@dataclass(frozen=True)
class Noise:
    """Noise of one reading's thrust: standard deviation `floor` [N] of a row, autoregression of its block means.

    `weights` (order + 1,): the whitening filter, the first is 1; `innovation` [N]: what it leaves. `slow`: its power below
    10 Hz [N^2]. `verified`: from repeated records; else from rest, or from a model's residual, which may hold model error too.
    """

    floor: float
    weights: np.ndarray
    innovation: float
    slow: float
    verified: bool

    def whiten(self, means: np.ndarray) -> np.ndarray:
        """Filter block means (blocks,) or (blocks, k) in N: (blocks - order, ...) in units of the innovation; NaN spreads."""
        order = len(self.weights) - 1
        n = len(means) - order
        return sum(w * means[order - k : order - k + n] for k, w in enumerate(self.weights)) / self.innovation


def noise_of(record: Record, repeat: Record) -> Noise:
    """From the difference of two records of the same commands, over sqrt 2."""
    return _fitted(record, (record["thrust"] - repeat["thrust"]) / np.sqrt(2.0), True)


def noise_at_rest(record: Record) -> Noise | None:
    """From what thrust does while both commands have stood for SETTLED seconds, less a line through each such stretch.

    None where the record has less than ENOUGH seconds of it. What repeats there, such as a rotor's vibration, is in it.
    """
    time, thrust = record.time, record["thrust"]
    moved = np.any([np.append(True, record[n][1:] != record[n][:-1]) for n in ("omega_ref", "beta_ref")], axis=0)
    starts = np.flatnonzero(moved)
    e = np.full(len(record), np.nan)
    for first, end in zip(starts, [*starts[1:], len(record)], strict=True):
        rows = np.arange(first, end)[time[first:end] - time[first] > SETTLED]
        rows = rows[np.isfinite(thrust[rows])]
        if len(rows) > FEWEST and time[rows[-1]] - time[rows[0]] > SETTLED / 2:
            e[rows] = thrust[rows] - np.polynomial.Polynomial.fit(time[rows], thrust[rows], 1)(time[rows])
    if np.isfinite(e).sum() * float(np.median(record.steps)) < ENOUGH:
        return None
    return _fitted(record, e, False)


def noise_from_residual(record: Record, residual: np.ndarray) -> Noise:
    """From a model's residual (rows,) N: an upper bound, since what the model lacks is in it."""
    return _fitted(record, residual, False)


def _fitted(record: Record, e: np.ndarray, verified: bool) -> Noise:
    """From noise (rows,) N, NaN where it is not known."""
    means = blocks(record).mean(e)
    means = means - np.nanmean(means)
    order = min(ORDER, int(np.isfinite(means).sum()) // 20)
    lagged = np.column_stack([means[order - k : len(means) - k] for k in range(order + 1)])
    lagged = lagged[np.isfinite(lagged).all(axis=1)]
    weights, *_ = np.linalg.lstsq(lagged[:, 1:], lagged[:, 0], rcond=None)
    left = lagged[:, 0] - lagged[:, 1:] @ weights
    floor = float(np.sqrt(np.nanmean((e - np.nanmean(e)) ** 2)))
    slow = blocks(record, BAND).mean(e) ** 2
    least = _digit(record["thrust"])
    innovation = max(float(np.sqrt(np.mean(left**2))), least)
    return Noise(max(floor, least), np.append(1.0, -weights), innovation, max(float(np.nanmean(slow)), least**2), verified)


def _digit(thrust: np.ndarray) -> float:
    """What rounding to the last digit that a record shows leaves uncertain [N]: noise is never less."""
    values = np.unique(thrust[np.isfinite(thrust)])
    return float(np.min(np.diff(values))) / np.sqrt(12.0)
