"""Uncertainty of estimates: covariance under coloured residuals, confidence intervals, weakly identified directions.

Least squares is unbiased if residuals are correlated, but its textbook covariance is then too small. The covariance here is the
sandwich H^-1 S H^-1, with S the covariance of the scores J.T e. Let F be the zero-phase filter whose gain is the root of the
residual's spectrum. Then J.T e = (F J).T (F^-1 e) exactly, and F^-1 e is white: S sums the outer products of the rows of F J
times F^-1 e, as White (1980) does for white residuals. So it is valid for any colour, and for residuals that are larger during
transients. Sums of the scores' autocorrelation (Newey and West, 1987) need a longest lag. The lag for slow colours makes
intervals of white residuals too small, because a fit absorbs slow residuals.

Records of the same commands share the model error, so they are not independent. Their residuals are summed before the scores
are computed: the model error adds up, and the noise averages out.
"""

from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, rfft
from scipy.linalg import block_diag
from scipy.optimize import brentq

from identification.fit.bands import ORDINATES, banded
from identification.fit.coordinates import Coordinates
from identification.fit.least_squares import Solution
from identification.fit.problem import Prior, Problem, summed

NORMAL_95 = 1.959963984540054

UNIDENTIFIABLE = 1e-10
"""Ratio of information to that of the best identified combination, below which a combination is not identifiable."""

WIDEST = 100.0
"""Maximum factor on the standard deviations of a prior: it then has no influence."""

SINGULAR = 1e-15
"""Ratio of the smallest to the largest eigenvalue of a covariance that is rounding error."""


@dataclass(frozen=True)
class Uncertainty:
    """Covariance (n, n) of the parameters `names`, in their units, with intervals and derived statistics.

    `inflation` (n,): ratio of the standard deviation to that under white residuals. `reach` (n, 2): distances of the lower and
    upper end of the 95 % intervals from the values; None: symmetric ones from the covariance. `profiled`: parameters with
    profile likelihood intervals. `left_open`: parameters that the records do not identify. The covariance is linearised. Near a
    double pole it is right for functions of a pair's sum and product, such as predictions, but too wide for the single
    constants. Their `std` is from their reach.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    inflation: np.ndarray
    reach: np.ndarray | None = None
    profiled: tuple[str, ...] = ()
    left_open: tuple[str, ...] = ()

    def renamed(self, names: Mapping[str, str]) -> "Uncertainty":
        """The same with parameters renamed: `names` maps old to new."""
        own, profiled, left_open = (tuple(names.get(n, n) for n in ns) for ns in (self.names, self.profiled, self.left_open))
        return replace(self, names=own, profiled=profiled, left_open=left_open)

    @property
    def std(self) -> np.ndarray:
        """(n,)"""
        return np.sqrt(np.diag(self.covariance)) if self.reach is None else self.reach.mean(axis=1) / NORMAL_95

    @property
    def intervals(self) -> np.ndarray:
        """(n, 2) 95 % intervals."""
        reach = NORMAL_95 * self.std[:, None] if self.reach is None else self.reach
        return self.values[:, None] + np.array([-1.0, 1.0]) * reach

    def beside(self, other: "Uncertainty", names: Iterable[str]) -> "Uncertainty":
        """Joined with the parameters `names` of `other` that it does not have, assumed independent."""
        further = other.only({*names} - {*self.names})
        reaches = [NORMAL_95 * u.std[:, None] * np.ones(2) if u.reach is None else u.reach for u in (self, further)]
        return Uncertainty(
            self.names + further.names,
            np.append(self.values, further.values),
            block_diag(self.covariance, further.covariance),
            np.append(self.inflation, further.inflation),
            np.vstack(reaches),
            self.profiled + further.profiled,
            self.left_open + further.left_open,
        )

    def only(self, names: Container[str]) -> "Uncertainty":
        """That of the parameters `names` alone."""
        at = [k for k, n in enumerate(self.names) if n in names]
        own, profiled, left_open = (tuple(n for n in ns if n in names) for ns in (self.names, self.profiled, self.left_open))
        reach = None if self.reach is None else self.reach[at]
        return Uncertainty(
            own, self.values[at], self.covariance[np.ix_(at, at)], self.inflation[at], reach, profiled, left_open
        )

    def kind(self, name: str) -> str:
        """Source of a parameter's interval, in words."""
        return "profile likelihood" if name in self.profiled else "covariance"

    @property
    def correlation(self) -> np.ndarray:
        """(n, n); 0 for a parameter without variance."""
        own = np.sqrt(np.diag(self.covariance))
        size = np.where(own > 0, own, np.inf)
        return self.covariance / np.outer(size, size) + np.diag(np.where(own > 0, 0.0, 1.0))

    def summary(self) -> dict:
        """For identification.json: the values with their intervals, correlation, weakest direction, inflation."""
        condition, weakest, spread = self.directions()
        rows = zip(self.names, self.values.tolist(), self.std.tolist(), self.intervals.tolist(), strict=True)
        return {
            "parameters": {
                name: {"value": value, "std": std, "interval": interval, "interval_from": self.kind(name)}
                for name, value, std, interval in rows
            },
            "correlation": {"names": list(self.names), "matrix": self.correlation.tolist()},
            "condition_number": condition,
            "weakest_direction": dict(zip(self.names, weakest.tolist(), strict=True)) | {"relative_std": spread},
            "inflation_by_coloured_residuals": dict(zip(self.names, self.inflation.tolist(), strict=True)),
        }

    def directions(self) -> tuple[float | None, np.ndarray, float]:
        """(condition number, weakest direction (n,) of unit length, its relative standard deviation), in units of the values.

        The condition number is None if a direction has no variance: a parameter is at a bound.
        """
        size = np.where(self.values == 0, 1.0, np.abs(self.values))
        spread, vectors = np.linalg.eigh(self.covariance / np.outer(size, size))
        weakest = vectors[:, -1] * np.sign(vectors[np.argmax(np.abs(vectors[:, -1])), -1])
        singular = spread[0] <= SINGULAR * spread[-1]
        return None if singular else float(np.sqrt(spread[-1] / spread[0])), weakest, float(np.sqrt(max(spread[-1], 0.0)))

    def of(self, gradient: np.ndarray) -> float:
        """Standard deviation of a quantity whose gradient with respect to the parameters is `gradient` (n,)."""
        return float(np.sqrt(gradient @ self.covariance @ gradient))


def uncertainty(problem: Problem, found: Solution) -> Uncertainty:
    """Uncertainty of the fitted parameters at a solution. A coordinate at a bound, or without influence, has no variance."""
    coordinates = problem.coordinates
    e, parts = found.residual, [found.jacobian[rows] for rows in (*(b.at for b in problem.blocks), slice(problem.size, None))]
    *normals, known = [part.T @ part for part in parts]
    free, inverse, unidentifiable, size = _free(problem, found, sum(normals) + known)
    j = found.jacobian if len(free) == len(found.value) else found.jacobian[:, free]
    scores = sum(_coloured(j[g[0].at], summed(g, e), inverse * len(g)) for g in problem.groups)
    white = sum(normal * float(np.mean(e[b.at] ** 2)) for normal, b in zip(normals, problem.blocks, strict=True))
    own = np.ix_(free, free)
    coloured, plain = (inverse @ (s + known[own]) @ inverse for s in (scores, white[own]))
    std = np.zeros(len(found.value))
    std[free] = np.sqrt(np.diag(coloured))
    tangent = coordinates.jacobian(found.value)[:, free]
    away = tangent / size
    is_unidentifiable = np.linalg.norm(away @ unidentifiable, axis=1) > np.sqrt(UNIDENTIFIABLE) * np.linalg.norm(away, axis=1)
    covariance, plain = (tangent @ c @ tangent.T for c in (coloured, plain))
    with np.errstate(invalid="ignore", divide="ignore"):
        inflation = np.nan_to_num(np.sqrt(np.diag(covariance) / np.diag(plain)), nan=1.0, posinf=1.0)
    values = np.array(list(coordinates.values(found.value).values()))
    sides = (slope[:, free] for slope in _secants(coordinates, found.value, NORMAL_95 * std))
    reach = NORMAL_95 * np.column_stack([np.sqrt(np.diag(side @ coloured @ side.T)) for side in sides])
    left_open = tuple(n for n, is_open in zip(coordinates.names, is_unidentifiable, strict=True) if is_open)
    return Uncertainty(coordinates.names, values, covariance, inflation, reach, left_open=left_open)


def disagreement(prior: Prior, uncertainty: Uncertainty) -> float:
    """Factor, from 1 to WIDEST, by which a prior must be widened to agree with the records. `uncertainty`: of a fit to the
    records with a weak prior.

    Model error biases records and steady points in different ways. The factor f solves d' (C + f^2 S)^-1 d = k, with d (k,) the
    differences, and C and S the covariances of records and prior (Birge, 1932; Mandel and Paule, 1970). Parameters that the
    records hardly identify do not widen it.
    """
    names = [n for n in prior.names if n in uncertainty.names and n not in uncertainty.left_open]
    own, its = [uncertainty.names.index(n) for n in names], [prior.names.index(n) for n in names]
    away = uncertainty.values[own] - prior.mean[its]
    records, known = uncertainty.covariance[np.ix_(own, own)], prior.covariance[np.ix_(its, its)]

    def excess(log_factor: float) -> float:
        return float(away @ np.linalg.solve(records + np.exp(2.0 * log_factor) * known, away)) - len(names)

    most = float(np.log(WIDEST))
    if not names or excess(0.0) <= 0.0:
        return 1.0
    return WIDEST if excess(most) >= 0.0 else float(np.exp(brentq(excess, 0.0, most)))


def _secants(coordinates: Coordinates, x: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Secants of values by coordinates (n, n) for changes of `reach` (n,) from `x`: towards (lower, higher) values.

    The constants of a pair depend on the root of the spread, whose derivative is infinite at a double pole.
    """
    below = coordinates.jacobian(x)
    above = below.copy()
    for i, j in coordinates.pairs:
        if reach[j] > 0:
            within = np.clip(x[j] + reach[j] * np.array([-1.0, 0.0, 1.0]), coordinates.lower[j], coordinates.upper[j])
            low, here, high = 0.5 * np.exp(x[i]) * np.sqrt(within) / reach[j]
            below[[i, j], j] = here - low, here - high
            above[[i, j], j] = high - here, low - here
    return below, above


def _coloured(jacobian, residual, inverse):
    """Covariance of the scores of one block, from rows (m, n) and (m,), assumed evenly spaced."""
    m = len(residual)
    j, e = rfft(np.ascontiguousarray(jacobian.T)), rfft(residual)
    spectrum = np.maximum(banded(np.abs(e) ** 2 / m), 1e-300) / _remaining_share(j, inverse, m)  # not 0, for data without noise
    gain = np.sqrt(spectrum)
    scores = irfft(np.multiply(j, gain, out=j), m)
    scores *= irfft(e / gain, m)
    return scores @ scores.T


def _remaining_share(j, inverse, m):
    """Share (k,) of the noise power that remains in the residual, by frequency; from the Jacobian's transform (n, k)."""
    parts = j.view(float)  # alternately real and imaginary; both add to the power
    absorbed = np.einsum("ij,ij->j", inverse @ parts, parts).reshape(-1, 2).sum(axis=1) / m
    return np.maximum(1.0 - banded(absorbed), 1.0 / ORDINATES)


def _free(problem, found, normal):
    """(free coordinates, inverse of their part of the `normal` matrix, directions (n, k) that the records do not identify, in
    units of the coordinates' influence `size`, size (n,)).

    A pair's spread at its lower bound is free: the response is smooth through a double pole.
    """
    coordinates, held = problem.coordinates, found.active.copy()
    held[[j for _, j in coordinates.pairs if found.value[j] <= coordinates.lower[j]]] = False
    free = np.flatnonzero(~held)
    normal = normal[np.ix_(free, free)]
    size = np.sqrt(np.diag(normal))
    size = np.where(size > 0.0, size, 1.0)
    power, axes = np.linalg.eigh(normal / np.outer(size, size))
    known = power > UNIDENTIFIABLE * power[-1] if len(power) else np.zeros(0, bool)
    inverse = (axes[:, known] / power[known]) @ axes[:, known].T / np.outer(size, size)
    return free, inverse, axes[:, ~known], size
