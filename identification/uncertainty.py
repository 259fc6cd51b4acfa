"""What estimates are worth: covariance under coloured residuals, weak directions, profiles, bootstrap.

Least squares stays unbiased when residuals are correlated, but its textbook covariance is then too small. The covariance
here is the sandwich H^-1 S H^-1: S sums the correlation of the scores (Jacobian row times residual) over lags up to MEMORY
with Bartlett's weights (Newey and West, 1987), so it holds for any colour that dies out within that time.
"""

from dataclasses import dataclass

import numpy as np

from identification.least_squares import Solution, solve
from identification.problem import Problem

MEMORY = 1.0
"""Longest correlation of residuals that counts, s; a few of the rig's time constants."""

NORMAL_95 = 1.959963984540054


@dataclass(frozen=True)
class Uncertainty:
    """Covariance (n, n) of the parameters `names`, in their own units, and what follows from it.

    `inflation` (n,): standard deviation over what white residuals would give.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    inflation: np.ndarray

    @property
    def std(self) -> np.ndarray:
        """(n,)"""
        return np.sqrt(np.diag(self.covariance))

    @property
    def intervals(self) -> np.ndarray:
        """(n, 2) 95 % intervals."""
        half = NORMAL_95 * self.std
        return np.column_stack([self.values - half, self.values + half])

    @property
    def correlation(self) -> np.ndarray:
        """(n, n); 0 where a parameter has no variance."""
        std = np.where(self.std > 0, self.std, np.inf)
        return self.covariance / np.outer(std, std) + np.diag(np.where(self.std > 0, 0.0, 1.0))

    def directions(self) -> tuple[float, np.ndarray, float]:
        """(condition number, weakest direction (n,) of unit length, its relative standard deviation), values as units."""
        size = np.where(self.values == 0, 1.0, np.abs(self.values))
        spread, vectors = np.linalg.eigh(self.covariance / np.outer(size, size))
        weakest = vectors[:, -1] * np.sign(vectors[np.argmax(np.abs(vectors[:, -1])), -1])
        return float(np.sqrt(spread[-1] / max(spread[0], 1e-300))), weakest, float(np.sqrt(spread[-1]))

    def of(self, gradient: np.ndarray) -> float:
        """Standard deviation of a quantity with the given gradient (n,) in the parameters."""
        return float(np.sqrt(gradient @ self.covariance @ gradient))


def uncertainty(problem: Problem, found: Solution) -> Uncertainty:
    """Covariance of the fitted parameters at a solution. A coordinate at a bound, or without influence, has no variance."""
    free = np.flatnonzero(~found.active & (np.linalg.norm(found.jacobian, axis=0) > 0))
    j, e = found.jacobian[:, free], found.residual
    inverse = _inverse(j.T @ j)
    prior = slice(problem.size, len(e))
    scores = sum(_long_run(j[b.at] * e[b.at, None], _memory(problem, b)) for b in problem.blocks)
    scores = scores + j[prior].T @ j[prior]
    white = sum(_white(j[b.at], e[b.at]) for b in problem.blocks) + j[prior].T @ j[prior]
    to_values = problem.coordinates.jacobian(found.value)[:, free]
    coloured, plain = (to_values @ inverse @ s @ inverse @ to_values.T for s in (scores, white))
    values = np.array(list(problem.coordinates.values(found.value).values()))
    with np.errstate(invalid="ignore", divide="ignore"):
        inflation = np.sqrt(np.diag(coloured) / np.diag(plain))
    return Uncertainty(problem.coordinates.names, values, coloured, np.nan_to_num(inflation, nan=1.0))


def _memory(problem: Problem, block) -> int:
    """Rows of a block that span MEMORY."""
    time = problem.records[block.record].time[block.rows]
    return max(1, min(len(time) // 4, round(MEMORY / max(1e-9, float(np.median(np.diff(time)))))))


def _white(jacobian, residual):
    return jacobian.T @ jacobian * float(np.mean(residual**2))


def _long_run(scores: np.ndarray, lags: int) -> np.ndarray:
    """Sum over lags of the scores' correlation with Bartlett's weights: the mean outer product of moving sums.

    sum_l (1 - |l| / L) Gamma_l equals the outer products of all sums over L neighbours, divided by L: one pass.
    """
    sums = np.cumsum(np.vstack([np.zeros((lags, scores.shape[1])), scores, np.zeros((lags - 1, scores.shape[1]))]), axis=0)
    windows = sums[lags:] - sums[:-lags]
    return windows.T @ windows / lags


def _inverse(normal: np.ndarray) -> np.ndarray:
    size = np.sqrt(np.diag(normal))
    return np.linalg.pinv(normal / np.outer(size, size), rcond=1e-13, hermitian=True) / np.outer(size, size)


def profile(problem: Problem, found: Solution, k: int, level: float = 3.841458820694124) -> tuple[float, float]:
    """95 % interval of coordinate `k` by profile likelihood: where the cost, all others refitted, has risen by level / 2.

    For where the parabola is wrong: near a bound, or at a double pole. Returns coordinates, within the bounds. Residuals
    must be in units of their (white) standard deviation.
    """
    variance = 2.0 * found.cost / max(1, len(found.residual) - len(found.value))
    wanted = found.cost + 0.5 * level * variance
    lower, upper = problem.coordinates.lower, problem.coordinates.upper
    return tuple(_edge(problem, found, k, wanted, bound) for bound in (lower[k], upper[k]))


def _edge(problem, found, k, wanted, bound):
    def cost(at, start):
        low, high = problem.coordinates.lower.copy(), problem.coordinates.upper.copy()
        low[k] = high[k] = at
        start = start.copy()
        start[k] = at
        return solve(problem.evaluate, start, low, high, tolerance=1e-8)

    inside, outside = found.value[k], bound
    start = found.value
    if cost(outside, start).cost <= wanted:
        return outside
    for _ in range(40):
        middle = 0.5 * (inside + outside)
        tried = cost(middle, start)
        if tried.cost <= wanted:
            inside, start = middle, tried.value
        else:
            outside = middle
        if abs(outside - inside) <= 1e-3 * abs(inside - found.value[k]) + 1e-12:
            break
    return 0.5 * (inside + outside)
