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

SETTLED = 5.0
"""Times of a channel's lags after which it has settled, to a few per cent."""

FIRST = 0.5
"""Part of the lags in which a start is judged: a state that was not settled shows there in full, a command's move hardly."""

LARGER, CHANCE = 4.0, 1e-6
"""Ratio of the mean squares at the start and later that shows a run-in, and the chance of that ratio in white noise."""

RESOLVED = 1e-3
"""Share of a signal's range below which a difference is none: without noise, what remains is the integration's."""


def run_in(record: Record, outputs: np.ndarray, lag: float) -> float:
    """s from a record's start to where its initial state has died away; 0 where it begins settled.

    `outputs` (rows, 3): a model's, that starts settled; `lag` [s]: of its slower channel. Thrust and speed are judged alike.
    """
    return SETTLED * lag if any(_in_motion(*signal, lag) for signal in _signals(record, outputs)) else 0.0


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


def _in_motion(time: np.ndarray, measured: np.ndarray, predicted: np.ndarray, lag: float) -> bool:
    """Whether the error is larger at the start than in all that follows the run-in, and than in what follows it next: an error
    that stays for longer is no run-in."""
    square, behind = (predicted - measured) ** 2, time >= SETTLED * lag
    first, rest, following = square[time < FIRST * lag], square[behind], square[behind & (time < 2.0 * SETTLED * lag)]
    if len(first) < 2 or len(following) < 2:
        return False
    ratio = max(LARGER, float(f_distribution.isf(CHANCE, len(first), len(rest))))
    usual = max(float(rest.mean()), float(following.mean()), (RESOLVED * float(np.ptp(measured))) ** 2)
    return bool(first.mean() > ratio * usual)
