"""A dead time and two first-order lags, fitted to one signal of a step response."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from identification.fit.coordinates import CLOSEST, WIDEST
from identification.fit.least_squares import solve

LONGEST_DELAY = 0.12
"""Maximum dead time, as a share of a run after its step. The model's effects reach 0.6 of a rig's time scale; a run that
settles lasts five."""


@dataclass(frozen=True, eq=False)
class Response:
    """A fit of one signal: lags `slow` and `fast` and dead time `delay` [s], `offset` and `gain` in the signal's unit.

    `std`: standard deviations by the same names and of `sum` (slow + fast), for white residuals; None for lags that are not
    identifiable separately. `rms`: residual of `readings` readings, each weighted by the uncertainty of its sensor. `predicted`
    (rows,): the signal at each row, before any sensor.
    """

    slow: float
    fast: float
    delay: float
    offset: float
    gain: float
    std: Mapping[str, float | None]
    rms: float
    readings: int
    predicted: np.ndarray

    @property
    def double_pole(self) -> bool:
        """Whether both lags are equal: often due to a rate limit."""
        return self.slow - self.fast < 0.01 * self.slow

    @property
    def covariance(self) -> np.ndarray:
        """(2, 2) of slow and fast; if only their sum is identifiable, that of lags with a fixed share of it."""
        sum_, slow, fast = (self.std[name] for name in ("sum", "slow", "fast"))
        if slow is None or fast is None:
            share = np.array([self.slow, self.fast]) / (self.slow + self.fast)
            return sum_**2 * np.outer(share, share)
        both = 0.5 * (sum_**2 - slow**2 - fast**2)
        return np.array([[slow**2, both], [both, fast**2]])

    def summary(self) -> dict:
        """For identification.json."""
        names = ("slow", "fast", "delay", "offset", "gain", "rms")
        return {name: getattr(self, name) for name in names} | {"std": dict(self.std)}


def settled_from(time: np.ndarray) -> float:
    """s after the step at which the settled part of the response starts: its last third."""
    return float(time[-1]) * 2.0 / 3.0


def two_lags(t: np.ndarray, slow: float, fast: float) -> np.ndarray:
    """Unit step response of two different lags in series, (n, 4): the value, and its derivatives by slow, fast and t.

    1 - (a e_a - b e_b) / (a - b) with e_a = exp(-t / a), a slow, b fast; 0 for t <= 0 (solution of the paper's eqs. 13 to 15).
    """
    t, difference = np.maximum(t, 0.0), slow - fast
    e_slow, e_fast = np.exp(-t / slow), np.exp(-t / fast)
    decay = (slow * e_slow - fast * e_fast) / difference
    in_slow = (decay - e_slow * (1.0 + t / slow)) / difference
    in_fast = (e_fast * (1.0 + t / fast) - decay) / difference
    return np.column_stack([1.0 - decay, in_slow, in_fast, (e_slow - e_fast) / difference])


class LagFit:
    """Least squares of one signal of a run, in the coordinates offset, gain, log(slow + fast), spread and, optionally, delay.

    `observe`, (rows, k) -> (readings, k), is the sensor of the signal predicted at `time` (rows,). Its readings are compared
    with `measured` (readings,) at the times `at` (readings,) s in units of `std` (readings,). `curve`: the signal as a
    polynomial of the lags' response from 0 to 1, lowest power first.
    """

    def __init__(self, time, at, measured, observe, std, curve):
        self.time, self.at, self.measured, self.observe, self.std, self.curve = time, at, measured, observe, std, curve
        self.slope = np.polynomial.polynomial.polyder(curve)

    def signal(self, x: np.ndarray) -> np.ndarray:
        """(rows, 1 + coordinates): the signal and its derivatives at coordinates `x`."""
        spread = np.sqrt(x[3])
        slow, fast = (0.5 * np.exp(x[2]) * (1.0 + sign * spread) for sign in (1.0, -1.0))
        s, in_slow, in_fast, in_time = two_lags(self.time - (x[4] if len(x) > 4 else 0.0), slow, fast).T
        g, rise = (np.polynomial.polynomial.polyval(s, p) for p in (self.curve, self.slope))
        in_spread = (in_slow - in_fast) * np.exp(x[2]) / (4.0 * spread)
        inner = (in_slow * slow + in_fast * fast, in_spread, -in_time)[: len(x) - 2]
        return np.column_stack([x[0] + x[1] * g, np.ones_like(g), g, *(x[1] * rise * d for d in inner)])

    def evaluate(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual (readings,) and Jacobian (readings, coordinates)."""
        seen = self.observe(self.signal(x))
        return (seen[:, 0] - self.measured) / self.std, seen[:, 1:] / self.std[:, None]

    def start(self, delay: bool) -> np.ndarray:
        """Start of the search: the mean lag of the response is the sum of all lags and delays."""
        # A tachometer without noise shows no new value after the speed has settled: then take its last ones.
        settled = self.measured[self.at >= min(settled_from(self.time), self.at[-3])].mean()
        before, after = self.at < 0.0, self.at >= 0.0
        offset = self.measured[before].mean() if before.any() else self.measured[0]
        remaining = (settled - self.measured[after]) / ((settled - offset) or 1.0)
        lag = float(np.clip(np.sum(remaining[1:] * np.diff(self.at[after])), 0.02, self.time[-1] / 4.0))
        return np.array([offset, settled - offset, np.log(lag), 0.3, *[0.1 * lag] * delay])

    def solve(self, delay: bool) -> Response:
        """The best fit."""
        lower = np.array([-np.inf, -np.inf, np.log(0.002), CLOSEST, *[0.0] * delay])
        upper = np.array([np.inf, np.inf, np.log(2.0 * self.time[-1]), WIDEST, *[LONGEST_DELAY * self.time[-1]] * delay])
        found = solve(self.evaluate, self.start(delay), lower, upper)
        x, total, spread = found.value, np.exp(found.value[2]), np.sqrt(found.value[3])
        degrees = max(len(self.at) - len(x), 1)
        known = np.delete(np.arange(len(x)), 3) if found.active[3] else np.arange(len(x))
        normal = found.jacobian[:, known].T @ found.jacobian[:, known]
        covariance = np.zeros((len(x), len(x)))
        covariance[np.ix_(known, known)] = np.linalg.pinv(normal, hermitian=True) * 2.0 * found.cost / degrees
        std = dict(zip(("offset", "gain", "sum", "spread", "delay"), np.sqrt(np.diag(covariance)).tolist(), strict=False))
        std |= {"sum": std["sum"] * total, "delay": std.get("delay")}
        for name, sign in (("slow", 1.0), ("fast", -1.0)):
            to = np.array([0.0, 0.0, 0.5 * total * (1.0 + sign * spread), sign * total / (4.0 * spread), *[0.0] * delay])
            std[name] = None if found.active[3] else float(np.sqrt(to @ covariance @ to))
        del std["spread"]
        rms = np.sqrt(np.mean(found.residual**2) / np.mean(self.std**-2.0))
        return Response(
            slow=float(0.5 * total * (1.0 + spread)),
            fast=float(0.5 * total * (1.0 - spread)),
            delay=float(x[4]) if delay else 0.0,
            offset=float(x[0]),
            gain=float(x[1]),
            std=std,
            rms=max(float(rms), 1e-12),
            readings=len(self.at),
            predicted=self.signal(x)[:, 0],
        )
