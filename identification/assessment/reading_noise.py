"""Standard deviation of one thrust reading's noise, its range, and the source of the estimate.

Records of the same commands differ only by noise. Without them, three sources need no correct model: the scatter within steady
holds of a record, the scatter of the steady points of static.csv, and the differences of neighbouring readings. Each contains
noise only up to the time that it spans, so slow noise makes them disagree: differences of neighbours contain the least. Noise
that depends on the operating point also makes them disagree, because they are at different ones.

Within a hold, half the mean squared difference of readings from its first and last third (the variogram, Cressie, Statistics
for Spatial Data, 1993, section 2.4) equals the variance, if the noise is uncorrelated over a third.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import stdtrit

from identification.assessment.prediction import Prediction
from identification.fit.converter import grid
from identification.fit.coordinates import slowest
from identification.roles import Fitted, together
from vpp_fmu.campaign import StaticMap
from vpp_fmu.digits import number
from vpp_fmu.record import Record

SETTLED = 2.0
"""Minimum duration of a hold that ends at rest, over the sum of lags of the slower channel."""

REPEATS, HOLDS = "differences of repeated records", "scatter within steady holds"
POINTS, NEIGHBOURS = "scatter of the readings in static.csv", "differences of neighbouring readings"

PARTS = 20
"""Parts of a record, from whose scatter the standard error of an estimate is computed."""

FEWEST = 3
"""Minimum number of parts, holds or points of a source, for a standard error."""


@dataclass(frozen=True)
class ReadingNoise:
    """Standard deviation `std` [N] of one reading's noise, its range `low` to `high` [N], and its `source` in words.

    The range covers the 95 % intervals of all sources. Without a repeat it extends to the noise over a whole record,
    extrapolated from holds, at most the residual.
    """

    std: float
    low: float
    high: float
    source: str

    @property
    def basis(self) -> str:
        """The range and the source, in words."""
        return f"{number(self.low)} to {number(self.high)} N; from {self.source}"

    def summary(self) -> dict:
        """For identification.json and diagnosis.json."""
        return {
            "noise_floor_thrust": self.std,
            "noise_floor_thrust_range": [self.low, self.high],
            "noise_floor_thrust_from": self.source,
        }


def reading_noise(
    predictions: Iterable[Prediction], static: StaticMap | None, values: Mapping[str, float]
) -> ReadingNoise | None:
    """Estimate from records with their predictions, and from steady points; None without a source.

    The model only removes the response to the commands: its error is constant at rest and equal in repeated records. `values`:
    its parameters, whose lags determine which holds end at rest. The source that spans the longest time gives the value:
    repeats, else points, else holds, else neighbours.
    """
    shown = {str(k): p for k, p in enumerate(predictions)}
    errors = {name: p.record["thrust"] - p.thrust for name, p in shown.items()}
    groups = together(Fitted(name, p.record) for name, p in shown.items())
    shortest = SETTLED * slowest(values, values)
    holds = [hold for name, p in shown.items() for hold in _holds(p.record, errors[name], shortest)]
    squares = {
        REPEATS: [part for group in groups if len(group) > 1 for part in _between([errors[one.name] for one in group])],
        POINTS: [(s**2, n) for s, n in zip(static.thrust_std, static.samples, strict=True) if s > 0.0] if static else [],
        HOLDS: [(hold.variance, hold.count) for hold in holds],
        NEIGHBOURS: [part for error in errors.values() for part in _neighbours(error)],
    }
    found = {source: _pooled(parts) for source, parts in squares.items() if len(parts) >= FEWEST}
    if not found:
        return None
    source, (variance, *_) = next(iter(found.items()))
    low, high = min(low for _, low, _ in found.values()), max(high for *_, high in found.values())
    if NEIGHBOURS in found and source != REPEATS:
        *_, most = _pooled([part for error in errors.values() for part in _about_mean(error)])
        if HOLDS in found:
            longest = max(float(np.ptp(p.record.time)) for p in shown.values())
            most = min(most, _pooled([(hold.over(longest), hold.count) for hold in holds])[-1])
        high = max(high, most)
    rounding = grid(np.concatenate([p.record["thrust"] for p in shown.values()]))[0] / np.sqrt(12.0) if shown else 0.0
    std, low = (max(float(np.sqrt(v)), rounding) for v in (variance, low))
    # The rounding error of a constant thrust is constant: holds do not show it unless noise changes the reading.
    return ReadingNoise(std, low, float(np.hypot(np.sqrt(high), rounding)), source)


@dataclass(frozen=True)
class _Hold:
    """`variance` [N^2] of readings at distance `lag` [s], its `growth` [N^2] over the last octave, `count` of readings."""

    variance: float
    growth: float
    lag: float
    count: int

    def over(self, longest: float) -> float:
        """Variance [N^2] over `longest` [s], if it grows equally in each octave of time. 1/f noise does; noise with a
        correlation time grows less."""
        return self.variance + self.growth * float(np.log2(max(longest / self.lag, 1.0)))


def last_thirds(record: Record, shortest: float) -> list[tuple[float, float]]:
    """(start, end) s of the last third of each hold of both commands of at least `shortest` [s]."""
    moves = np.any([np.diff(record[n]) != 0.0 for n in ("omega_ref", "beta_ref")], axis=0)
    ends = record.time[np.concatenate([[0], np.flatnonzero(moves) + 1, [len(record) - 1]])]
    return [((a + 2.0 * b) / 3.0, b) for a, b in pairwise(ends.tolist()) if b - a >= shortest]


def _holds(record: Record, error: np.ndarray, shortest: float) -> Iterator[_Hold]:
    """Noise of the last third of each hold, split into three parts. The first and last part are twice as far apart in time as
    neighbours."""
    for start, end in last_thirds(record, shortest):
        inside = (record.time >= start) & (record.time < end) & np.isfinite(error)
        third = int(inside.sum()) // 3
        if third < 2:
            continue
        parts = error[inside][: 3 * third].reshape(3, third)
        first, middle, last = parts.mean(axis=1)
        far, near = (first - last) ** 2, 0.5 * ((first - middle) ** 2 + (middle - last) ** 2)
        variance = 0.5 * (parts[0].var() + parts[2].var() + far)
        yield _Hold(float(variance), float(0.5 * (far - near)), 2.0 * (end - start) / 3.0, 3 * third)


def _between(errors: Sequence[np.ndarray]) -> list[tuple[float, int]]:
    """(N^2, readings) in parts, from differences between records of the same commands, minus each record's mean."""
    errors = np.stack(errors)
    errors = errors[:, np.isfinite(errors).all(axis=0)]
    if not errors.size:
        return []
    return _in_parts((errors - errors.mean(axis=1, keepdims=True)).var(axis=0, ddof=1))


def _neighbours(error: np.ndarray) -> list[tuple[float, int]]:
    """(N^2, readings) in parts, from differences of neighbouring readings."""
    return _in_parts(0.5 * np.diff(error[np.isfinite(error)]) ** 2)


def _in_parts(squares: np.ndarray) -> list[tuple[float, int]]:
    return [(float(part.mean()), len(part)) for part in np.array_split(squares, PARTS) if len(part)]


def _about_mean(error: np.ndarray) -> list[tuple[float, int]]:
    """(N^2, readings) in parts, from a record's error about its mean: noise plus model error."""
    seen = error[np.isfinite(error)]
    return _in_parts((seen - seen.mean()) ** 2) if len(seen) else []


def _pooled(parts: Sequence[tuple[float, float]]) -> tuple[float, float, float]:
    """(variance [N^2], its 95 % interval) from variances and their numbers of readings; the interval from their scatter."""
    squares, weights = np.array(parts).T
    share = weights / weights.sum()
    variance = float(share @ squares)
    error = np.sqrt(np.sum((share * (squares - variance)) ** 2) * len(parts) / (len(parts) - 1.0))
    reach = float(stdtrit(len(parts) - 1, 0.975) * error)
    return variance, max(variance - reach, 0.0), variance + reach
