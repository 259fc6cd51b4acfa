"""What the thrust residual of an identified model is made of while nothing new happens: noise, and the model's own error."""

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, sqrt

import numpy as np

from vpp_fmu.errors import BadInput
from vpp_fmu.files import read_text

SLOW_SHARE, SLOW_TIME = 0.37, 0.15
"""Slow noise where only its sum with the fast is known: its share of the standard deviation, and its correlation time [s].
Measured on repeated runs of four rigs (`band_of`): 0.36 to 0.38, and 0.12 to 0.17 s."""

PEAK = 3.0
"""The model's error at its largest, in units of its root mean square."""


@dataclass(frozen=True)
class Band:
    """Noise of one reading: `white` [N], and `slow` [N] with the correlation time `slow_time` [s], both standard deviations.

    `model_error` [N]: the largest mean residual over half a second that the model's own error makes, and the largest rms of
    it about that mean.
    """

    white: float
    slow: float
    slow_time: float
    model_error: float

    @property
    def noise(self) -> float:
        """Of one reading [N], standard deviation."""
        return sqrt(self.white**2 + self.slow**2)

    @property
    def width(self) -> float:
        """N about the model's thrust within which 19 of 20 readings lie while nothing new happens."""
        return self.model_error + 1.96 * self.noise


def read_band(path: str | os.PathLike) -> Band:
    """The band from what `vpp identify` wrote (identification.json): noise floor, and the largest rmse of its records.

    What the rmse has above the noise is the model's error. BadInput names a missing or impossible number.
    """
    try:
        content = json.loads(read_text(path))
        floor = float(content["noise_floor_thrust"])
        rmse = max(float(record["rmse_thrust"]) for record in content["records"].values())
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        allowed = "noise_floor_thrust and rmse_thrust of each record, as vpp identify writes them"
        raise BadInput(path, "content", f"{type(error).__name__}: {error}", allowed) from error
    if not 0.0 < floor < float("inf") or not 0.0 < rmse < float("inf"):
        raise BadInput(path, "noise_floor_thrust, rmse_thrust", f"{floor}, {rmse}", "numbers above 0")
    error = sqrt(max(rmse * rmse - floor * floor, 0.0))
    return Band(floor * sqrt(1.0 - SLOW_SHARE**2), floor * SLOW_SHARE, SLOW_TIME, PEAK * error)


def band_of(residuals: Sequence[np.ndarray], noise: np.ndarray, dt: float, block: float = 0.5) -> Band:
    """The band from thrust residuals [N] of good runs, one array a run, dt [s] apart, and from their noise alone.

    `noise` (n,): half the difference of two runs with the same commands, times sqrt(2). Its covariance at the lags to 0.5 s
    is fitted by that of white and slow noise. The model's error is the largest mean of a block, or the largest rms about it.
    """
    noise = noise - noise.mean()
    lags = np.arange(1, max(3, round(0.5 / dt)) + 1)
    covariance = np.array([noise[k:] @ noise[:-k] / len(noise) for k in lags])
    best = (np.inf, 0.0, SLOW_TIME)
    for time in np.geomspace(5.0 * dt, 2.0, 40):
        shape = np.exp(-lags * dt / time)
        slow = max(float(covariance @ shape / (shape @ shape)), 0.0)
        best = min(best, (float(np.sum((covariance - slow * shape) ** 2)), slow, float(time)))
    rows, largest = round(block / dt), 0.0
    for residual in residuals:
        blocks = residual[: len(residual) // rows * rows].reshape(-1, rows)
        about = np.sqrt(np.maximum(blocks.var(axis=1, ddof=1) - noise.var(), 0.0))
        largest = max(largest, float(np.abs(blocks.mean(axis=1)).max()), float(about.max()))
    white = float(noise @ noise) / len(noise) - best[1]
    return Band(sqrt(max(white, 1e-12)), sqrt(best[1]), best[2], largest)


class Whitener:
    """Means of `rows` readings, made independent and of variance 1.

    Block means of white and first-order noise are an ARMA(1, 1) process; its innovations are

        v = e - phi e_before - theta v_before,   theta from the covariances of e - phi e_before at lags 0 and 1

    `scale` [N]: their standard deviation. `gain` [1]: what is left in v of a constant residual.
    """

    def __init__(self, band: Band, rows: int, dt: float):
        a = exp(-dt / band.slow_time)
        within = rows + 2.0 * sum((rows - k) * a**k for k in range(1, rows))
        across = a * ((1.0 - a**rows) / (1.0 - a)) ** 2
        variance = band.white**2 / rows + band.slow**2 * within / rows**2
        covariance = band.slow**2 * across / rows**2
        self._phi = a**rows
        at_0 = (1.0 + self._phi**2) * variance - 2.0 * self._phi * covariance
        at_1 = covariance - self._phi * variance
        self._theta = 0.0 if at_1 == 0.0 else (at_0 - sqrt(at_0**2 - 4.0 * at_1**2)) / (2.0 * at_1)
        self.scale = sqrt(at_0 / (1.0 + self._theta**2))
        self.gain = (1.0 - self._phi) / (1.0 + self._theta)
        self.reset()

    def reset(self) -> None:
        """No block before."""
        self._before = self._innovation = 0.0

    def update(self, mean: float) -> float:
        """The innovation of a block's mean residual [N], in units of `scale`."""
        self._innovation = mean - self._phi * self._before - self._theta * self._innovation
        self._before = mean
        return self._innovation / self.scale


class Spread:
    """Variances of `rows` readings about their mean, made normal with variance 1; of mean 0 where the model errs at its most.

    The sum of squares of correlated noise is about a chi-squared number, shifted and stretched to the same three moments; the
    cube root of that is normal (Wilson and Hilferty, PNAS 17, 1931).
    """

    def __init__(self, band: Band, rows: int, dt: float):
        lags = np.abs(np.subtract.outer(np.arange(rows), np.arange(rows))) * dt
        covariance = band.white**2 * np.eye(rows) + band.slow**2 * np.exp(-lags / band.slow_time)
        powers = np.linalg.eigvalsh(covariance - covariance.mean(axis=0) - covariance.mean(axis=1)[:, None] + covariance.mean())
        first, second, third = (float(np.sum(powers**k)) for k in (1, 2, 3))
        self._freedom = second**3 / third**2
        self._mean = first / (rows - 1)
        self._stretch = sqrt(self._freedom / second) * (rows - 1)
        self._mean_most = self._mean + band.model_error**2

    def update(self, variance: float) -> float:
        """A block's variance [N^2] as a normal number."""
        noise = variance * self._mean / self._mean_most
        squares = self._freedom + self._stretch * (noise - self._mean)
        width = 2.0 / (9.0 * self._freedom)
        return (max(squares / self._freedom, 0.0) ** (1.0 / 3.0) - 1.0 + width) / sqrt(width)
