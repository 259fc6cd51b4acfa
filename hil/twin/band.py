"""The thrust residual of an identified model in normal operation: standard deviations of the noise and of the model error."""

import os
from dataclasses import dataclass
from math import exp, inf, sqrt

import numpy as np
from scipy.special import stdtrit

from vpp_fmu.errors import BadInput
from vpp_fmu.structured import read_object

SLOW_SHARE, SLOW_TIME = 0.37, 0.15
"""Default share of slow noise in the standard deviation, and its correlation time [s]. Repeated runs of four rigs have 0.36 to
0.38, and 0.12 to 0.17 s."""


@dataclass(frozen=True)
class Band:
    """Noise of one reading, standard deviations: `white` [N], and `slow` [N] with the correlation time `slow_time` [s].

    Model error over half a second, standard deviations: `steady` [N] while commands are constant, estimated with `freedom`
    degrees of freedom, and in addition `moving` [1] per N of change of the model's thrust.
    """

    white: float
    slow: float
    slow_time: float
    steady: float
    moving: float = 0.0
    freedom: float = inf

    @property
    def noise(self) -> float:
        """Standard deviation of one reading, N."""
        return sqrt(self.white**2 + self.slow**2)

    @property
    def width(self) -> float:
        """Half-width [N] of the 95 % band of readings about the model's thrust, in normal operation at constant commands."""
        return 1.96 * sqrt(self.noise**2 + self.steady**2)

    def deviations(self, probability: float) -> float:
        """Two-sided quantile of the model error, in standard deviations: Student's t, because these are estimated from a
        campaign."""
        return float(-stdtrit(self.freedom, 0.5 * probability))


def read_band(path: str | os.PathLike) -> Band:
    """Read the band from identification.json of `vpp identify` or `vpp diagnose`. BadInput names a missing entry."""
    allowed = "noise_floor_thrust and model_error, as vpp identify writes them"
    content = read_object(path, allowed=allowed)
    try:
        floor, error = float(content["noise_floor_thrust"]), content["model_error"]
        if error is None:
            found = "null: neither a static map nor a repeat determined it"
            raise BadInput(
                path, "model_error", found, "the model error of an identification with a static.csv: the twin's band needs it"
            )
        steady, moving, freedom = (float(error[name]) for name in ("steady", "moving", "freedom"))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise BadInput(path, "content", f"{type(error).__name__}: {error}", allowed) from error
    if not all(0.0 < number < inf for number in (floor, steady, freedom)) or not 0.0 <= moving < inf:
        found = f"{floor}, {error}"
        raise BadInput(path, "noise_floor_thrust, model_error", found, "finite numbers above 0")
    return Band(floor * sqrt(1.0 - SLOW_SHARE**2), floor * SLOW_SHARE, SLOW_TIME, steady, moving, freedom)


class Whitener:
    """Whiten means of `rows` readings to independent values of variance 1.

    Block means of white and first-order noise are an ARMA(1, 1) process; its innovations are

        v = e - phi e_before - theta v_before,   theta from the covariances of e - phi e_before at lags 0 and 1

    Standard deviations: `scale` [N] of the innovations, `spread` [N] of the means. `gain` [1]: v per constant residual.
    """

    def __init__(self, band: Band, rows: int, dt: float):
        a = exp(-dt / band.slow_time)
        within = rows + 2.0 * sum((rows - k) * a**k for k in range(1, rows))
        across = a * ((1.0 - a**rows) / (1.0 - a)) ** 2
        variance = band.white**2 / rows + band.slow**2 * within / rows**2
        covariance = band.slow**2 * across / rows**2
        self.spread, self._phi = sqrt(variance), a**rows
        at_0 = (1.0 + self._phi**2) * variance - 2.0 * self._phi * covariance
        at_1 = covariance - self._phi * variance
        self._theta = 0.0 if at_1 == 0.0 else (at_0 - sqrt(at_0**2 - 4.0 * at_1**2)) / (2.0 * at_1)
        self.scale = sqrt(at_0 / (1.0 + self._theta**2))
        self.gain = (1.0 - self._phi) / (1.0 + self._theta)
        self.reset()

    def reset(self) -> None:
        """Forget previous blocks."""
        self._before = self._innovation = 0.0

    def update(self, mean: float) -> float:
        """The innovation of a block's mean residual [N], in units of `scale`."""
        self._innovation = mean - self._phi * self._before - self._theta * self._innovation
        self._before = mean
        return self._innovation / self.scale


class Spread:
    """Transform variances of `rows` readings about their mean to a standard normal variable.

    The sum of squares of correlated noise is approximated by a chi-squared variable, shifted and scaled to the same three
    moments; its cube root is nearly normal (Wilson and Hilferty, PNAS 17, 1931).
    """

    def __init__(self, band: Band, rows: int, dt: float):
        lags = np.abs(np.subtract.outer(np.arange(rows), np.arange(rows))) * dt
        covariance = band.white**2 * np.eye(rows) + band.slow**2 * np.exp(-lags / band.slow_time)
        powers = np.linalg.eigvalsh(covariance - covariance.mean(axis=0) - covariance.mean(axis=1)[:, None] + covariance.mean())
        first, second, third = (float(np.sum(powers**k)) for k in (1, 2, 3))
        self._freedom = second**3 / third**2
        self._mean = first / (rows - 1)
        self._stretch = sqrt(self._freedom / second) * (rows - 1)

    def update(self, variance: float, most: float) -> float:
        """A block's variance [N^2] as a normal variable, of mean 0 if the model error has its bound `most` [N]."""
        noise = variance * self._mean / (self._mean + most**2)
        squares = self._freedom + self._stretch * (noise - self._mean)
        width = 2.0 / (9.0 * self._freedom)
        return (max(squares / self._freedom, 0.0) ** (1.0 / 3.0) - 1.0 + width) / sqrt(width)
