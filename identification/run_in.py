"""Records that begin in motion: the readings of the run-in are left out of every fit and every figure.

A model starts settled on a record's first command. Where the rotor or the blades were still moving, readings and prediction
differ at once, and the difference dies away with the lags. Without these readings, the likelihood is the marginal one over an
unknown initial state.
"""

from collections.abc import Iterator

import numpy as np
from scipy.stats import f as f_distribution

from identification.fit.tachometer import Tachometer
from vpp_fmu.record import Record

BLOCKS = 10
"""Half lags of a run-in: five lags leave a per cent of an initial state or two."""

CHANCE = 1e-6
"""Chance that white noise, or another error that comes and goes in half a lag, passes for a run-in."""

DECAYED = 0.8
"""Share of the initial error from which one is constant while commands hold; a transient has less after half a lag."""

RESOLVED = 5e-3
"""Share of a signal's range below which a difference is none: sensors are no better, nor is the map at a single command."""


def run_in(record: Record, outputs: np.ndarray, lag: float) -> float:
    """s from a record's start to where its initial state has died away; 0 where it begins settled.

    `outputs` (rows, 3): a model's, that starts settled; `lag` [s]: of its slower channel. Thrust and speed are judged alike.
    """
    moves = np.any([np.diff(record[n]) != 0.0 for n in ("omega_ref", "beta_ref")], axis=0)
    held = record.time[np.argmax(moves) + 1 if moves.any() else -1]
    half = 0.5 * lag
    if moves.sum() == 1 and BLOCKS * half >= held:  # a step run needs readings before its step
        return 0.0
    return BLOCKS * half if any(_in_motion(*signal, half, int(held / half)) for signal in _signals(record, outputs)) else 0.0


def without(record: Record, run_in: float) -> Record:
    """The record with empty readings of thrust and speed before `run_in` [s]."""
    late = record.time >= run_in
    return record.with_columns(**{n: np.where(late, record[n], np.nan) for n in ("thrust", "omega") if n in record})


def _signals(record: Record, outputs: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """(time [s], measured, predicted) of each measured channel, (readings,) each."""
    seen = np.isfinite(record["thrust"])
    yield record.time[seen], record["thrust"][seen], outputs[seen, 0]
    if "omega" in record and len(record) > 1:
        sensor = Tachometer(record)
        yield sensor.times, sensor.measured, sensor.shows(outputs[:, 1])


def _in_motion(time: np.ndarray, measured: np.ndarray, predicted: np.ndarray, half: float, held: int) -> bool:
    """Whether the mean error of the first `half` lag [s] is larger than those behind the run-in, and no other error.

    What grows, what stays while commands hold (for so many blocks, `held`), or what is there behind the run-in is no run-in.
    """
    block = (time / half).astype(int)
    count = np.bincount(block, minlength=1)
    means = np.bincount(block, weights=predicted - measured, minlength=1)[count > 0] / count[count > 0]
    means, rest = np.abs(means), np.abs(means[BLOCKS:])
    if len(rest) < 2 or count[0] == 0:
        return False
    first, usual = means[0], max(np.mean(part**2) for part in (rest, rest[:BLOCKS]))
    larger = first > max(RESOLVED * np.ptp(measured), np.sqrt(usual * f_distribution.isf(CHANCE, 1, len(rest))))
    grows, stays = first < 0.5 * means[:BLOCKS].max(), held > 1 and means[min(held, BLOCKS) - 1] > DECAYED * first
    return bool(larger and not grows and not stays)
