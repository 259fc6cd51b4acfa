"""A preliminary fit of a file's thrust to its commands, for unknown units.

    thrust = c0 + c20 w^2 + c11 w b + c21 w^2 b + c12 w b^2 + c30 w^3

w and b are the commands after one first-order lag each, in rows instead of seconds, normalised by the file's ranges. Least
squares gives the map's terms and a constant, a search gives the lags. It is used for signs, factors and orders of magnitude.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.signal import lfilter

from identification.static.static_map import TERMS
from vpp_fmu.campaign import StaticMap
from vpp_fmu.record import Record

FINER = 1.6
"""Ratio of neighbouring lags in the search: a lag is found to a quarter, which hardly changes the fit."""

MOST_ROWS = 3000
"""Maximum number of rows of a fit, evenly taken from all: enough for six coefficients, few enough for hundreds of fits."""

FOLLOWS = 0.5
"""Minimum share of the variance that the commands explain, to use the preliminary fit."""


@dataclass(frozen=True, eq=False)
class Span:
    """Ranges (least, greatest) that normalise the commands: speed is divided by its greatest, pitch runs from 0 to 1."""

    speed: tuple[float, float]
    pitch: tuple[float, float]

    def columns(self, omega: np.ndarray, beta: np.ndarray) -> np.ndarray:
        """(n, 6): the terms at commands (n,), the constant first."""
        w = omega / (self.speed[1] or 1.0)
        b = (beta - self.pitch[0]) / ((self.pitch[1] - self.pitch[0]) or 1.0)
        return np.column_stack([np.ones_like(w), *(w**i * b**j for i, j in TERMS.values())])

    def holds(self, omega: np.ndarray, beta: np.ndarray) -> np.ndarray:
        """(n,): whether commands are inside, with a tolerance of a twentieth of each range."""
        inside = np.ones(len(omega), bool)
        for values, (low, high) in ((omega, self.speed), (beta, self.pitch)):
            reach = 0.05 * max(high - low, 1e-9 * abs(high))
            inside &= (values >= low - reach) & (values <= high + reach)
        return inside


@dataclass(frozen=True, eq=False)
class Response:
    """Result of the preliminary fit of a file.

    `omega`, `beta`, `thrust` (n,): lagged commands and readings of the fit. `coefficients` (6,) in the unit of the thrust;
    `lags`: of speed and pitch, in rows, 0 for a constant command; `row`: median sampling period, in the unit of the file's
    time.
    """

    span: Span
    omega: np.ndarray
    beta: np.ndarray
    thrust: np.ndarray
    coefficients: np.ndarray
    lags: Mapping[str, float]
    row: float

    @property
    def left(self) -> np.ndarray:
        """(n,): residual, readings minus fit."""
        return self.thrust - self.at(self.omega, self.beta)

    @property
    def explained(self) -> float:
        """Share of the thrust's variance that the fit explains."""
        total = float(np.var(self.thrust))
        return 1.0 - float(np.mean(self.left**2)) / total if total > 0.0 else 0.0

    @property
    def size(self) -> float:
        """Range of the readings, without a thousandth at each end."""
        low, high = np.quantile(self.thrust, [0.001, 0.999])
        return float(high - low)

    def at(self, omega: np.ndarray, beta: np.ndarray) -> np.ndarray:
        """(n,): thrust at settled commands (n,)."""
        return self.span.columns(np.asarray(omega, float), np.asarray(beta, float)) @ self.coefficients

    def rise(self, channel: str) -> float | None:
        """Thrust difference between the upper and lower tenth of a channel, the other at its median; None for a constant
        channel."""
        own, other = (self.omega, self.beta) if channel == "omega" else (self.beta, self.omega)
        ends, middle = np.quantile(own, [0.1, 0.9]), np.full(2, np.median(other))
        if ends[1] - ends[0] <= 1e-6 * max(abs(ends[0]), abs(ends[1]), 1e-6):
            return None
        low, high = self.at(ends, middle) if channel == "omega" else self.at(middle, ends)
        return float(high - low)

    def owed_to_pitch(self) -> tuple[float, float]:
        """(change of the thrust from the lower to the upper tenth of the pitch, ratio of residual variances without and with
        pitch), from speed, its square and pitch. Products of both would extrapolate into corners without readings."""
        w = self.omega / (self.span.speed[1] or 1.0)
        a = np.column_stack([np.ones_like(w), w, w**2, self.beta])
        whole, part = (np.linalg.lstsq(columns, self.thrust, rcond=1e-9)[0] for columns in (a, a[:, :3]))
        residual = float(np.mean((self.thrust - a @ whole) ** 2))
        low, high = np.quantile(self.beta, [0.1, 0.9])
        without = float(np.mean((self.thrust - a[:, :3] @ part) ** 2))
        return float(whole[3] * (high - low)), without / residual if residual > 0.0 else np.inf


class Look:
    """Records of one file for preliminary fits with any lags; rows without thrust are omitted."""

    def __init__(self, records: Sequence[Record]):
        self.records = [r for r in records if len(r) > 1]
        self.row = float(np.median(np.concatenate([r.steps for r in self.records])))
        self.longest = max(2.0, max(len(r) for r in self.records) / 4.0)
        seen = np.concatenate([np.isfinite(r["thrust"]) for r in self.records])
        every = max(1, int(np.ceil(seen.sum() / MOST_ROWS)))
        self.rows = np.flatnonzero(seen)[::every]
        self.thrust = np.concatenate([r["thrust"] for r in self.records])[self.rows]
        commands = {n: np.concatenate([r[n] for r in self.records]) for n in ("omega_ref", "beta_ref")}
        self.span = Span(*((float(c.min()), float(c.max())) for c in commands.values()))
        self.moves = {"omega": np.ptp(commands["omega_ref"]) > 0.0, "beta": np.ptp(commands["beta_ref"]) > 0.0}
        self._lagged: dict = {}

    def lagged(self, channel: str, lag: float, early: int = 0) -> np.ndarray:
        """A command after a lag in rows, at the rows in use; shifted `early` rows earlier than in the file."""
        key = channel, lag, early
        if key not in self._lagged:
            parts = [after_lag(_earlier(r[f"{channel}_ref"], early), lag) for r in self.records]
            self._lagged[key] = np.concatenate(parts)[self.rows]
        return self._lagged[key]

    def fit(self, lags: Mapping[str, float], early: int = 0) -> tuple[float, np.ndarray]:
        """(mean square of the residual, coefficients) with lags in rows."""
        a = self.span.columns(*(self.lagged(channel, lags[channel], early) for channel in ("omega", "beta")))
        found = np.linalg.lstsq(a, self.thrust, rcond=1e-9)[0]
        return float(np.mean((self.thrust - a @ found) ** 2)), found

    def best(self, longest: float) -> tuple[float, dict[str, float]]:
        """(mean square of the residual, lags) of the best lags up to `longest` rows: a coarse grid, then one channel at a
        time."""
        count = max(2, round(np.log(2.0 * longest) / np.log(FINER))) if longest > 0.5 else 0
        grid = [0.0, *np.geomspace(0.5, longest, count).tolist()]
        choices = {channel: grid if moves else [0.0] for channel, moves in self.moves.items()}
        lags = min(product(choices["omega"][::3], choices["beta"][::3]), key=self._error)
        for _ in range(2):
            lags = min(((lag, lags[1]) for lag in choices["omega"]), key=self._error)
            lags = min(((lags[0], lag) for lag in choices["beta"]), key=self._error)
        return self._error(lags), dict(zip(("omega", "beta"), lags, strict=True))

    def _error(self, lags: tuple[float, float]) -> float:
        return self.fit({"omega": lags[0], "beta": lags[1]})[0]

    def response(self) -> Response:
        """The fit with the best lags."""
        _, lags = self.best(self.longest)
        omega, beta = (self.lagged(channel, lags[channel]) for channel in ("omega", "beta"))
        return Response(self.span, omega, beta, self.thrust, self.fit(lags)[1], lags, self.row)


def _earlier(command: np.ndarray, rows: int) -> np.ndarray:
    """(n,): a command shifted earlier by `rows`; its last value is repeated."""
    return np.append(command[rows:], np.full(min(rows, len(command)), command[-1]))


def after_lag(command: np.ndarray, lag: float) -> np.ndarray:
    """(n,): a held command after a first-order lag in rows, in equilibrium at the start; each row has the value before its
    command acts."""
    kept = float(np.exp(-1.0 / lag)) if lag > 0.0 else 0.0
    moved = lfilter([0.0, 1.0 - kept], [1.0, -kept], command - command[0])
    return command[0] + moved


def steady_response(static: StaticMap) -> Response:
    """The preliminary fit of steady points, without lags."""
    ends = [(float(c.min()), float(c.max())) for c in (static.omega_ref, static.beta_ref)]
    span = Span(*ends)
    a = span.columns(static.omega_ref, static.beta_ref)
    found = np.linalg.lstsq(a, static.thrust, rcond=1e-9)[0]
    return Response(span, static.omega_ref, static.beta_ref, static.thrust, found, {"omega": 0.0, "beta": 0.0}, 0.0)
