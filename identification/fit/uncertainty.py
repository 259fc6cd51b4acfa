"""What estimates are worth: covariance under coloured residuals, intervals, weak directions.

Least squares stays unbiased when residuals are correlated, but its textbook covariance is then too small. The covariance
here is the sandwich H^-1 S H^-1, S the covariance of the scores J.T e. With F the filter of zero phase whose gain is the root
of the residual's spectrum, J.T e = (F J).T (F^-1 e) exactly, and F^-1 e is white: S sums the outer products of the rows of
F J times F^-1 e, as White (1980) does for white residuals. So it holds for any colour, and for residuals that are larger
while the model moves. Sums of the scores' correlation over lags (Newey and West, 1987) must choose a longest lag: the one
that slow colours need makes intervals of white residuals too small, since a fit absorbs what is slow.

What a model lacks is the same in every record of the same commands: such records are not independent. Their residuals are
summed before the scores are, so what they share counts as shared, and what is noise averages out.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import brentq

from identification.fit.bands import ORDINATES, banded
from identification.fit.coordinates import Coordinates
from identification.fit.least_squares import Solution
from identification.fit.problem import Prior, Problem, summed

NORMAL_95 = 1.959963984540054

UNIDENTIFIABLE = 1e-10
"""Share of what the records tell of the best known combination of parameters below which they tell nothing of another."""

WIDEST = 100.0
"""How much wider than its own scatter knowledge is taken at most: nothing is left of it then."""

SINGULAR = 1e-15
"""Ratio of a covariance's least to its largest eigenvalue that is rounding."""


@dataclass(frozen=True)
class Uncertainty:
    """Covariance (n, n) of the parameters `names`, in their own units, and what follows from it.

    `inflation` (n,): standard deviation over what white residuals would give. `reach` (n, 2): how far below and above the
    values the 95 % intervals go, where that is not the same on both sides. `profiled`: the parameters whose intervals come from
    the profile of the likelihood. The covariance is a tangent's: near a double pole
    it is right for what depends on a pair's sum and product, as predictions do, and too wide for the single constants;
    their `std` follows from their reach.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    inflation: np.ndarray
    reach: np.ndarray | None = None
    profiled: tuple[str, ...] = ()
    left_open: tuple[str, ...] = ()

    def renamed(self, names: Mapping[str, str]) -> "Uncertainty":
        """The same under other names, by the names it has."""
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
        """With what another says of further parameters `names`, as if the two had nothing to do with each other."""
        kept = [k for k, n in enumerate(other.names) if n in names and n not in self.names]
        further = {n for k, n in enumerate(other.names) if k in kept}
        reaches = [NORMAL_95 * u.std[:, None] * np.ones(2) if u.reach is None else u.reach for u in (self, other)]
        return Uncertainty(
            (*self.names, *(other.names[k] for k in kept)),
            np.append(self.values, other.values[kept]),
            block_diag(self.covariance, other.covariance[np.ix_(kept, kept)]),
            np.append(self.inflation, other.inflation[kept]),
            np.vstack([reaches[0], reaches[1][kept]]),
            (*self.profiled, *(n for n in other.profiled if n in further)),
            (*self.left_open, *(n for n in other.left_open if n in further)),
        )

    def kind(self, name: str) -> str:
        """In words, what a parameter's interval comes from."""
        return "profile likelihood" if name in self.profiled else "covariance"

    @property
    def correlation(self) -> np.ndarray:
        """(n, n); 0 where a parameter has no variance."""
        own = np.sqrt(np.diag(self.covariance))
        size = np.where(own > 0, own, np.inf)
        return self.covariance / np.outer(size, size) + np.diag(np.where(own > 0, 0.0, 1.0))

    def directions(self) -> tuple[float | None, np.ndarray, float]:
        """(condition number, weakest direction (n,) of unit length, its relative standard deviation), values as units.

        The condition number is None where some direction has no variance: what stands on a bound.
        """
        size = np.where(self.values == 0, 1.0, np.abs(self.values))
        spread, vectors = np.linalg.eigh(self.covariance / np.outer(size, size))
        weakest = vectors[:, -1] * np.sign(vectors[np.argmax(np.abs(vectors[:, -1])), -1])
        singular = spread[0] <= SINGULAR * spread[-1]
        return None if singular else float(np.sqrt(spread[-1] / spread[0])), weakest, float(np.sqrt(max(spread[-1], 0.0)))

    def of(self, gradient: np.ndarray) -> float:
        """Standard deviation of a quantity with the given gradient (n,) in the parameters."""
        return float(np.sqrt(gradient @ self.covariance @ gradient))


def uncertainty(problem: Problem, found: Solution) -> Uncertainty:
    """Covariance of the fitted parameters at a solution. A coordinate at a bound, or without influence, has no variance."""
    coordinates = problem.coordinates
    free, inverse, blind = _free(problem, found)
    j, e = found.jacobian[:, free], found.residual
    prior = slice(problem.size, len(e))
    known = j[prior].T @ j[prior]
    scores = sum(_coloured(j[g[0].at], summed(g, e), inverse * len(g)) for g in problem.groups) + known
    white = sum(_white(j[b.at], e[b.at]) for b in problem.blocks) + known
    coloured, plain = (inverse @ s @ inverse for s in (scores, white))
    std = np.zeros(len(found.value))
    std[free] = np.sqrt(np.diag(coloured))
    tangent = coordinates.jacobian(found.value)[:, free]
    size = np.linalg.norm(found.jacobian[:, free], axis=0)
    away = tangent / np.where(size > 0.0, size, 1.0)
    unknown = np.linalg.norm(away @ blind, axis=1) > np.sqrt(UNIDENTIFIABLE) * np.linalg.norm(away, axis=1)
    covariance, plain = (tangent @ c @ tangent.T for c in (coloured, plain))
    with np.errstate(invalid="ignore", divide="ignore"):
        inflation = np.nan_to_num(np.sqrt(np.diag(covariance) / np.diag(plain)), nan=1.0, posinf=1.0)
    values = np.array(list(coordinates.values(found.value).values()))
    sides = (slope[:, free] for slope in _secants(coordinates, found.value, NORMAL_95 * std))
    reach = NORMAL_95 * np.column_stack([np.sqrt(np.diag(side @ coloured @ side.T)) for side in sides])
    left_open = tuple(n for n, is_open in zip(coordinates.names, unknown, strict=True) if is_open)
    return Uncertainty(coordinates.names, values, covariance, inflation, reach, left_open=left_open)


def disagreement(told: Prior, uncertainty: Uncertainty) -> float:
    """How much wider knowledge must be for records to agree with it, from 1 to WIDEST. `uncertainty`: of a fit to the records
    that it hardly held.

    What is missing in a model bends records and steady points, and not alike. The factor f solves d' (C + f^2 S)^-1 d = k, d
    (k,) the differences, C and S the covariances of records and knowledge (Birge, 1932; Mandel and Paule, 1970): where the
    records tell little, knowledge keeps its word.
    """
    names = [n for n in told.names if n in uncertainty.names and n not in uncertainty.left_open]
    own, its = [uncertainty.names.index(n) for n in names], [told.names.index(n) for n in names]
    away = uncertainty.values[own] - told.mean[its]
    records, known = uncertainty.covariance[np.ix_(own, own)], told.covariance[np.ix_(its, its)]

    def excess(log_factor: float) -> float:
        return float(away @ np.linalg.solve(records + np.exp(2.0 * log_factor) * known, away)) - len(names)

    most = float(np.log(WIDEST))
    if not names or excess(0.0) <= 0.0:
        return 1.0
    return WIDEST if excess(most) >= 0.0 else float(np.exp(brentq(excess, 0.0, most)))


def _secants(coordinates: Coordinates, x: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """d values / d coordinates (n, n) for changes of `reach` (n,) from `x`: towards (lower, higher) values.

    The constants of a pair go with the root of the spread, whose tangent is upright at a double pole.
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


def _white(jacobian, residual):
    return jacobian.T @ jacobian * float(np.mean(residual**2))


def _coloured(jacobian, residual, inverse):
    """Covariance of the scores of one block: rows (m, n) and (m,), evenly spaced as far as this goes."""
    m = len(residual)
    j, e = np.fft.rfft(jacobian, axis=0), np.fft.rfft(residual)
    spectrum = np.maximum(banded(np.abs(e) ** 2 / m), 1e-300) / _left(j, inverse, m)  # never 0: noise-free data
    gain = np.sqrt(spectrum)
    scores = np.fft.irfft(j * gain[:, None], m, axis=0) * np.fft.irfft(e / gain, m)[:, None]
    return scores.T @ scores


def _left(j, inverse, m):
    """Share (k,) of the residual's power that the fit has left in it, by frequency; from the Jacobian's transform (k, n)."""
    absorbed = np.sum((j @ inverse) * j.conj(), axis=1).real / m
    return np.maximum(1.0 - banded(absorbed), 1.0 / ORDINATES)


def restored(problem: Problem, found: Solution) -> np.ndarray:
    """The residual (rows,) as large as it was before the fit took its share, at each frequency; a prior's rows stay.

    What a bootstrap should draw from: a fit of steady levels absorbs a good part of what is slow. It takes from the mean of
    records of the same commands, and nothing from their differences.
    """
    free, inverse, _ = _free(problem, found)
    residual = found.residual.copy()
    for group in problem.groups:
        first, count = group[0], len(group)
        mean, m = summed(group, found.residual) / count, len(first.time)
        j = np.fft.rfft(found.jacobian[first.at][:, free], axis=0)
        taken = np.fft.irfft(np.fft.rfft(mean) / np.sqrt(_left(j, inverse * count, m)), m) - mean
        for block in group:
            residual[block.at] += np.interp(block.time, first.time, taken)
    return residual


def _free(problem, found):
    """(coordinates that vary, inverse of their normal matrix, directions (n, k) of which the records tell nothing, each column
    in units of the coordinates' influence).

    A double pole is no bound to hold them: the response is smooth through it, only the constants' names end there.
    """
    coordinates, held = problem.coordinates, found.active.copy()
    held[[j for _, j in coordinates.pairs if found.value[j] <= coordinates.lower[j]]] = False
    free = np.flatnonzero(~held)
    normal = found.jacobian[:, free].T @ found.jacobian[:, free]
    size = np.sqrt(np.diag(normal))
    size = np.where(size > 0.0, size, 1.0)
    told, axes = np.linalg.eigh(normal / np.outer(size, size))
    known = told > UNIDENTIFIABLE * told[-1] if len(told) else np.zeros(0, bool)
    inverse = (axes[:, known] / told[known]) @ axes[:, known].T / np.outer(size, size)
    return free, inverse, axes[:, ~known]
