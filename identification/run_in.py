"""Run-in of records that begin in motion: its readings are excluded from all fits and figures.

A model starts settled at the first command. If rotor or blades still move, the prediction error decays with the lags. Without
these readings, the likelihood is the marginal one over an unknown initial state.
"""

from collections.abc import Iterator

import numpy as np
from scipy.stats import f as f_distribution

from identification.fit.tachometer import Tachometer
from vpp_fmu.record import Record

BLOCKS = 10
"""Half lags of a run-in: after five lags, 1 % to 2 % of an initial state remain."""

CHANCE = 1e-6
"""Level of the test for a run-in against white noise, or another error that is uncorrelated over half a lag."""

DECAYED = 0.8
"""Share of the initial error from which an error counts as constant during a hold; a transient decays below it."""

RESOLVED = 5e-3
"""Share of a signal's range below which an error is neglected, as below the accuracy of sensors and of the map."""


def run_in(record: Record, outputs: np.ndarray, lag: float) -> float:
    """Seconds from a record's start until its initial state has decayed; 0 if it begins settled.

    `outputs` (rows, 3): of a model that starts settled; `lag` [s]: of its slower channel. Thrust and speed are tested alike.
    """
    moves = np.any([np.diff(record[n]) != 0.0 for n in ("omega_ref", "beta_ref")], axis=0)
    held = record.time[np.argmax(moves) + 1 if moves.any() else -1]
    half = 0.5 * lag
    if moves.sum() == 1 and BLOCKS * half >= held:  # a step response needs readings before its step
        return 0.0
    return BLOCKS * half if any(_in_motion(*signal, half, int(held / half)) for signal in _signals(record, outputs)) else 0.0


def without(record: Record, run_in: float) -> Record:
    """The record without readings of thrust and speed before `run_in` [s]."""
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
    """Whether the mean error of the first `half` lag [s] significantly exceeds those after the run-in.

    An error that grows, or that is constant during the first hold (of `held` blocks), is no run-in.
    """
    block = (time / half).astype(int)
    count = np.bincount(block, minlength=1)
    means = np.bincount(block, weights=predicted - measured, minlength=1)[count > 0] / count[count > 0]
    means, after = np.abs(means), np.abs(means[BLOCKS:])
    if len(after) < 2 or count[0] == 0:
        return False
    first, variance = means[0], max(np.mean(part**2) for part in (after, after[:BLOCKS]))
    larger = first > max(RESOLVED * np.ptp(measured), np.sqrt(variance * f_distribution.isf(CHANCE, 1, len(after))))
    grows, constant = first < 0.5 * means[:BLOCKS].max(), held > 1 and means[min(held, BLOCKS) - 1] > DECAYED * first
    return bool(larger and not grows and not constant)
