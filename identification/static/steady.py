"""Steady points from raw samples, and how many samples a mean needs (paper, section 3.1)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vpp_fmu.campaign import StaticMap
from vpp_fmu.errors import BadInput
from vpp_fmu.record import Record

SETTLE = 3.0
"""s that the paper lets transients decay."""

BATCHES = 50
"""Blocks that the longest mean leaves in the readings: its variance is then known to 16 %, sqrt(4 / (3 BATCHES))."""

FEWEST = 4 * BATCHES
"""Readings from which the colour of noise can be told."""

_GROWTH = 1.3
"""More than chance lets m times the variance of a mean grow over the last doubling of m, once readings are independent."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """Commands [rpm, deg] that stood still; of what was settled by then, `thrust` N and `omega` rpm, each (readings,)."""

    omega_ref: float
    beta_ref: float
    thrust: np.ndarray
    omega: np.ndarray


def resting(record: Record, settle: float = SETTLE) -> list[Stretch]:
    """Where neither command of a record moves, without the first `settle` s, and without rows that have no value.

    Those with less than two readings of thrust are left out.
    """
    moved = (np.diff(record["omega_ref"]) != 0) | (np.diff(record["beta_ref"]) != 0)
    starts = np.append(0, np.flatnonzero(moved) + 1)
    speed = record["omega"] if "omega" in record else np.full(len(record), np.nan)
    found = []
    for first, end in zip(starts, [*starts[1:], len(record)], strict=True):
        settled = first + int(np.sum(np.round(record.time[first:end] - record.time[first], 9) < settle))
        thrust = _seen(record["thrust"][settled:end])
        if len(thrust) >= 2:
            commands = float(record["omega_ref"][first]), float(record["beta_ref"][first])
            found.append(Stretch(*commands, thrust, _seen(speed[settled:end])))
    return found


def noise(found: Sequence[Stretch]) -> np.ndarray:
    """Readings (n,) N of all stretches, one after the other, each less its stretch's mean."""
    return np.concatenate([stretch.thrust - stretch.thrust.mean() for stretch in found])


def steady_points(record: Record, settle: float = SETTLE) -> StaticMap:
    """The static map of a record with thrust: a point for each stretch `resting`, with their errors. BadInput without any.

    Means, and the spread of single readings, are over what is settled. `samples` is the number of independent readings that
    such a mean is worth: neighbours share noise, by an inflation that all stretches tell together (1 where all of them have
    too few readings for one). `omega` is the command where no speed was measured. A point measured twice is two points.
    """
    found = resting(record, settle)
    if not found:
        allowed = f"both commands still for longer than {settle:g} s somewhere"
        raise BadInput(record.source, "steady stretches", "none", allowed)
    shared = np.concatenate([(s.thrust - s.thrust.mean()) / (s.thrust.std() or 1.0) for s in found])
    enough = len(shared) >= FEWEST and np.ptp(shared) > 0.0
    inflation = max(1.0, samples_needed(shared, 1.0).inflation) if enough else 1.0
    points = [
        (
            stretch.omega_ref,
            stretch.beta_ref,
            stretch.omega.mean() if len(stretch.omega) else stretch.omega_ref,
            stretch.thrust.mean(),
            stretch.thrust.std(ddof=1),
            max(1.0, len(stretch.thrust) / inflation),
        )
        for stretch in found
    ]
    return StaticMap(*np.array(points, float).T, source=record.source)


@dataclass(frozen=True, eq=False)
class SampleSize:
    """How the mean of m readings settles: `std` of the mean [N] and that of white noise, `white`, both over `m` (k,).

    `number` readings make the mean's standard deviation `wanted` [N]. `inflation`: variance of a long mean over that of white
    noise, so one reading in `inflation` counts; it and `number` are known to `relative_std`, with `settled` False not even
    that: the readings wander more slowly than their record is long, and more of them would be needed.
    """

    m: np.ndarray
    std: np.ndarray
    white: np.ndarray
    wanted: float
    number: int
    inflation: float
    relative_std: float
    settled: bool

    def std_of(self, count: float) -> float:
        """Standard deviation [N] of the mean of `count` readings: from the curve, beyond it with one over the root."""
        beyond = np.sqrt(max(1.0, count / self.m[-1]))
        return float(np.exp(np.interp(np.log(count), np.log(self.m), np.log(self.std))) / beyond)


def samples_needed(readings: np.ndarray, wanted_std: float) -> SampleSize:
    """How many readings in a row [N] a mean needs, so that its standard deviation is `wanted_std` [N].

    `readings` (n,) of one steady point, or the noise of any record; NaN is left out. The variance of a mean of m is that of
    the overlapping blocks of m about the mean of all, n / ((n - m) (n - m + 1)) sum (block - mean)^2 (Meketon and Schmeiser,
    1984), unbiased for white readings, whatever m; of coloured ones it stays above var / m, by
    (1 + rho) / (1 - rho) in the end for a first-order colour rho. m runs up to n / BATCHES. The paper settled on 5000.
    BadInput for less than FEWEST readings, or for readings that are all the same.
    """
    y = _seen(np.asarray(readings, float))
    n = len(y)
    if n < FEWEST or np.ptp(y) == 0.0 or not wanted_std > 0.0:
        found = f"{n} numbers from {y.min(initial=np.inf):g} to {y.max(initial=-np.inf):g}, for {wanted_std:g} N"
        raise BadInput("samples_needed", "readings", found, f"{FEWEST} or more that differ, for more than 0 N")
    longest = n // BATCHES
    m = np.unique(np.round(np.geomspace(1, longest, 40)).astype(int))
    sums = np.append(0.0, np.cumsum(y - y.mean()))
    variance = np.array([_variance(sums, size) for size in m.tolist()])
    # A tone that a block holds whole times leaves a mean without any variance, and no logarithm.
    std, inflation = np.sqrt(np.maximum(variance, 1e-24 * variance[0])), longest * variance[-1] / variance[0]
    halved = longest // 2 * _variance(sums, longest // 2) / variance[0]
    return SampleSize(
        m=m,
        std=std,
        white=std[0] / np.sqrt(m),
        wanted=wanted_std,
        number=_first_below(m, std, wanted_std),
        inflation=float(inflation),
        relative_std=float(np.sqrt(4.0 / 3.0 * longest / n)),
        settled=bool(inflation < _GROWTH * halved),
    )


def _variance(sums: np.ndarray, m: int) -> float:
    """Variance of a mean of m, from running sums (n + 1,) of readings about their mean."""
    n = len(sums) - 1
    blocks = (sums[m:] - sums[:-m]) / m
    return n / ((n - m) * (n - m + 1)) * float(np.sum(blocks**2))


def _first_below(m: np.ndarray, std: np.ndarray, wanted: float) -> int:
    """The number from which on the curve stays at or below `wanted`, on straight lines of its logarithms."""
    above = np.flatnonzero(std > wanted)
    if not len(above):
        return 1
    k = above[-1]
    if k == len(m) - 1:
        return int(np.ceil(m[k] * (std[k] / wanted) ** 2))
    share = np.log(std[k] / wanted) / np.log(std[k] / std[k + 1])
    return int(np.ceil(m[k] * (m[k + 1] / m[k]) ** share))


def _seen(values: np.ndarray) -> np.ndarray:
    return values[np.isfinite(values)]
