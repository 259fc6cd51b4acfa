"""A line of the thrust residual that turns with the rotor: power that no repeat shares, since its phase is another each time.

Records are cut in windows of whole revolutions, and in each the residual's Fourier coefficient at once a revolution stands
beside those next to it, at orders that nothing in a rotor has. Of noise, whatever its colour, its rank among them is uniform; a
mains hum meets the rotor in the few windows in which it turns at that frequency. So a rank sum over the windows is a test that
supposes nothing of the noise.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.stats import norm

from identification.diagnose.search.fits import Fit
from identification.fit.tachometer import Tachometer
from vpp_fmu.record import Record

TURNS = 40
"""Revolutions of a window: its orders are 1 / 40 apart, and a speed that is known to 1 % still meets its own."""

BESIDE = np.array([-8, -7, -6, -5, -4, -3, 3, 4, 5, 6, 7, 8])
"""Orders beside 1, in steps of 1 / TURNS, that a window's line is compared with: near enough for a spectrum to be even, and far
enough for a line that is one step off not to reach them."""

VARIED = 0.05
"""Share by which the rotor's frequency must vary over the windows, as a standard deviation: else a hum may follow it."""


@dataclass(frozen=True)
class Turning:
    """A line at once a revolution: its `size` [N] rms, and the p-value of none; 1 where these records can't tell."""

    size: float
    p: float


UNTURNED = Turning(0.0, 1.0)
"""Where nothing was asked, or nothing can be told."""


def turning(fit: Fit) -> Turning:
    """Of what a fit leaves, over all windows of all its records."""
    lines, ranks, speeds = [], [], []
    for e, outputs in zip(fit.problem.experiments, fit.problem.outputs(fit.values), strict=True):
        for one in e.records:
            residual = one.record["thrust"] - e.converter.reads(outputs[:, 0])
            for window, frequency in _windows(one.record, outputs[:, 1], residual):
                own, beside = window[0], window[1:]
                lines.append(own - beside.mean())
                ranks.append(float(np.sum(own > beside)) / len(beside))
                speeds.append(frequency)
    if len(ranks) < 2 or np.std(speeds) < VARIED * np.mean(speeds):
        return UNTURNED
    count, places = len(ranks), len(BESIDE) + 1
    # Ranks 0 to n of n + 1 places, as shares of n: variance ((n + 1)^2 - 1) / 12 n^2.
    std = np.sqrt((places**2 - 1.0) / 12.0) / (places - 1) / np.sqrt(count)
    return Turning(float(np.sqrt(max(2.0 * np.mean(lines), 0.0))), float(norm.sf((np.mean(ranks) - 0.5) / std)))


def _windows(record: Record, predicted: np.ndarray, residual: np.ndarray):
    """(power [N^2] of the residual's coefficients at order 1 and BESIDE it, the rotor's frequency [Hz]) of each window."""
    speed = _speed(record, predicted)
    turns = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) / 60.0 * record.steps))
    seen = np.isfinite(residual)
    number = (turns / TURNS).astype(int)
    edges = np.searchsorted(number, np.arange(number[-1] + 1))
    for first, last in pairwise(edges):
        rows = np.arange(first, last)[seen[first:last]]
        if len(rows) < 2 * (len(BESIDE) + 1):
            continue
        orders = 1.0 + np.append(0, BESIDE) / TURNS
        own = residual[rows] - residual[rows].mean()
        found = np.exp(-2.0j * np.pi * np.outer(orders, turns[rows])) @ own / len(rows)
        yield np.abs(found) ** 2, TURNS / float(record.time[last] - record.time[first])


def _speed(record: Record, predicted: np.ndarray) -> np.ndarray:
    """rpm (rows,): as measured between the instants at which it renewed, else as predicted."""
    if "omega" not in record:
        return predicted
    sensor = Tachometer(record)
    if len(sensor) < 2:
        return predicted
    off = sensor.measured - sensor.shows(predicted)
    return predicted + np.interp(record.time, record.time[sensor.rows], off)
