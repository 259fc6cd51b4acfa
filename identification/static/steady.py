"""Steady points from raw samples, and how many samples a mean needs (paper, section 3.1)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vpp_fmu.campaign import Campaign, StaticMap
from vpp_fmu.errors import BadInput
from vpp_fmu.record import Record

SETTLE = 3.0
"""s: the paper's time for transients to decay."""

SETTLED_LAGS = 5.0
"""Sums of a channel's lags after which a step response counts as settled: one lag then has 0.7 % of the step to go."""

BATCHES = 50
"""Number of blocks of the longest mean: the standard error of its variance is then 16 %, sqrt(4 / (3 BATCHES))."""

FEWEST = 4 * BATCHES
"""Minimum number of readings to estimate the colour of noise."""

_GROWTH = 1.3
"""Maximum growth of m times the variance of a mean over the last doubling of m: by chance independent readings grow less."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """A hold of both commands [rpm, deg], and its settled readings `thrust` N and `omega` rpm, each (readings,)."""

    omega_ref: float
    beta_ref: float
    thrust: np.ndarray
    omega: np.ndarray


def resting(record: Record, settle: float = SETTLE) -> list[Stretch]:
    """Holds of both commands of a record, without their first `settle` s and without rows that have no value.

    Holds with fewer than two thrust readings are omitted.
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
    """Readings (n,) N of all holds, concatenated, each minus the mean of its hold."""
    return np.concatenate([stretch.thrust - stretch.thrust.mean() for stretch in found])


def with_steady_points(campaign: Campaign, lag: float | None = None) -> Campaign:
    """The campaign with a static map: its means of steady points, else those of its raw samples, else those at the end of its
    step responses, whose slower channel has the sum of lags `lag` [s]. Without any it is unchanged."""
    if campaign.static is not None:
        return campaign
    if campaign.static_raw is not None:
        return replace(campaign, static=steady_points(campaign.static_raw))
    settle = np.inf if lag is None else SETTLED_LAGS * lag
    settled = [run for run in campaign.steps if resting(run, settle)]
    return replace(campaign, static=steady_points(*settled, settle=settle)) if settled else campaign


def steady_points(*records: Record, settle: float = SETTLE) -> StaticMap:
    """The static map of records with thrust: a point for each hold of `resting`. BadInput without any.

    Means and standard deviations of readings are over the settled readings. `samples` is the equivalent number of independent
    readings: neighbours share noise, with an inflation of the variance estimated from all holds together (1 with too few
    readings). `omega` is the command if no speed was measured. A point measured twice gives two points.
    """
    found, source = [stretch for record in records for stretch in resting(record, settle)], records[0].source
    if not found:
        raise BadInput(source, "steady stretches", "none", f"a hold of both commands longer than {settle:g} s")
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
    return StaticMap(*np.array(points, float).T, source=source)


@dataclass(frozen=True, eq=False)
class SampleSize:
    """Convergence of the mean of m readings: its standard deviation `std` [N], and `white` for white noise, over `m` (k,).

    `number` readings give the mean a standard deviation of `wanted` [N]. `inflation`: variance of a long mean over that under
    white noise, so one reading in `inflation` is independent. `relative_std`: standard error of both. `settled` False: the
    noise is slower than the record is long, and both are lower bounds.
    """

    m: np.ndarray
    std: np.ndarray
    white: np.ndarray
    wanted: float
    number: int
    inflation: float
    relative_std: float
    settled: bool


def samples_needed(readings: np.ndarray, wanted_std: float) -> SampleSize:
    """Number of successive readings [N] whose mean has a standard deviation of `wanted_std` [N].

    `readings` (n,) of one steady point, or the noise of any record; NaN is omitted. The variance of a mean of m is estimated
    from overlapping blocks, n / ((n - m) (n - m + 1)) sum (block - mean)^2 (Meketon and Schmeiser, 1984). It is unbiased for
    white readings. For coloured ones it exceeds var / m, in the limit by (1 + rho) / (1 - rho) for a first-order colour rho.
    The largest m is n / BATCHES. The paper uses 5000. BadInput for less than FEWEST readings, or for equal readings.
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
    # The mean over whole periods of a tone has no variance, and no logarithm.
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
    """Smallest number from which the curve is at or below `wanted`, by linear interpolation of logarithms."""
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
