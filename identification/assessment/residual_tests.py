"""Autocorrelation of a residual, and its cross-correlation with the commands."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from identification.fit.uncertainty import NORMAL_95
from vpp_fmu.record import Record

STEP = 0.02
"""s: residuals are first averaged over about this time. It is shorter than any actuator's lag."""

LONGEST = 2.0
"""Longest lag, s."""


@dataclass(frozen=True)
class ResidualTests:
    """Correlations at `lags` (m,) s: autocorrelation `own` (m,), and `crossed` (m,) with the changes of each command.

    `band`: 95 % band of white residuals. `outside`: share of the lags outside it, by correlation.
    """

    lags: np.ndarray
    own: np.ndarray
    crossed: Mapping[str, np.ndarray]
    band: float

    @property
    def outside(self) -> dict[str, float]:
        """Expected by chance: 0.05."""
        shares = {"itself": self.own} | dict(self.crossed)
        return {name: float(np.mean(np.abs(values) > self.band)) for name, values in shares.items()}


def residual_tests(record: Record, residual: np.ndarray) -> ResidualTests:
    """Tests of a thrust residual (rows,) N, NaN without a reading. Rows must be about evenly spaced."""
    rows = max(1, round(max(STEP, _renewed(record)) / float(np.median(record.steps))))
    n = len(record) // rows
    e = _means(residual, rows, n)
    count = max(1, min(round(LONGEST / (rows * float(np.median(record.steps)))), n // 4))
    lags = np.arange(1, count + 1) * rows * float(np.median(record.steps))
    crossed = {}
    for name in ("omega_ref", "beta_ref"):
        change = np.diff(_means(record[name], rows, n), prepend=record[name][0])
        if np.any(change):
            crossed[name] = lagged_correlation(e, change, count)
    return ResidualTests(lags, lagged_correlation(e, e, count), crossed, NORMAL_95 / np.sqrt(np.isfinite(e).sum()))


def lagged_correlation(error: np.ndarray, signal: np.ndarray, count: int) -> np.ndarray:
    """Correlation (count,) of an error (n,) with a signal (n,) 1 to `count` values earlier, without NaN."""
    return np.array([_correlation(error[k:], signal[:-k]) for k in range(1, count + 1)])


def _renewed(record: Record) -> float:
    """s: minimum span of a mean that includes a reading, if thrust is renewed more slowly than the rows; else 0."""
    renewed = record.time[np.isfinite(record["thrust"])]
    return 1.5 * float(np.median(np.diff(renewed))) if 1 < len(renewed) < len(record) else 0.0


def _means(values: np.ndarray, rows: int, n: int) -> np.ndarray:
    blocks = values[: n * rows].reshape(n, rows)
    seen = np.isfinite(blocks)
    with np.errstate(invalid="ignore"):
        return np.where(seen, blocks, 0.0).sum(axis=1) / seen.sum(axis=1)


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Correlation of two signals; 0 if one is constant or no row has both."""
    both = np.isfinite(a) & np.isfinite(b)
    if not both.any():
        return 0.0
    a, b = a[both] - a[both].mean(), b[both] - b[both].mean()
    return float(a @ b / (np.sqrt((a @ a) * (b @ b)) or 1.0))
