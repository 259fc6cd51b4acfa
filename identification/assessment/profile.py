"""Profile likelihood intervals, if the cost is not quadratic: near a double pole, at a bound, in a strongly nonlinear model.

    { t : cost(t) <= cost + (1.96 k)^2 / 2 },   cost(t): the least half sum of squares with the parameter held at t

(Venzon and Moolgavkar, 1988), where k^2 is the parameter's variance over that under white residuals of unit variance. Twice the
increase of the cost is k^2 times a chi-square variable (Kent, 1982), so the interval is valid for any colour and size.

Each end of a linear interval is checked. If the root of the cost's increase is within DEPARTURE of the quadratic approximation,
the end is kept; else it is searched. A check takes one evaluation: a Gauss-Newton step replaces the refit of the others.
"""

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import ThreadpoolController

from identification.fit.coordinates import CLOSEST, Coordinates
from identification.fit.least_squares import Solution, solve
from identification.fit.problem import Problem
from identification.fit.uncertainty import NORMAL_95, Uncertainty

DEPARTURE = 0.05
"""Maximum relative difference of the actual from the quadratic root of the cost's increase, at a linear interval's end."""

CLOSE = 0.01
"""Relative tolerance of that root at a searched end."""

TRIALS = 20
"""Maximum number of points of a profile on one side; the search then takes the last."""

FARTHEST = 4.0
"""Maximum ratio of the distance of a trial to that of the last."""

NOTHING = 1e-20
"""Mean square of a residual that is rounding error."""

_BLAS = ThreadpoolController()


def profiled(
    problem: Problem,
    found: Solution,
    uncertainty: Uncertainty,
    others: Sequence[Solution] = (),
    only: Container[str] | None = None,
) -> Uncertainty:
    """`uncertainty` of a solution, with ends of its 95 % intervals from the profile if the linear ones are wrong.

    `only`: the parameters to check; None: all.
    An interval ends at a parameter's bound if the cost does not reach the target before. It includes `others`, solutions of
    other searches, whose cost is below the target: a profile starts from one optimum, and few data may have several. For data
    without noise the result is `uncertainty`.
    """
    if found.cost <= NOTHING * len(found.residual):
        return uncertainty
    with _BLAS.limit(limits=1):
        optimum = _optimum(problem, found, uncertainty)
        reach, names = np.abs(uncertainty.intervals - uncertainty.values[:, None]), []
        for k, name in enumerate(uncertainty.names):
            if only is not None and name not in only:
                continue
            profile = Profile(optimum, k)
            ends = [profile.end(side, linear) for side, linear in zip((-1.0, 1.0), reach[k], strict=True)]
            for other in others:
                if profile.root(other.cost) <= profile.target:
                    away = problem.coordinates.values(other.value)[name] - profile.at
                    ends[away > 0.0] = max(ends[away > 0.0], abs(away))
            if not np.array_equal(ends, reach[k]):
                reach[k] = ends
                names.append(name)
        return replace(uncertainty, reach=reach, profiled=tuple(names))


@dataclass(frozen=True)
class _Optimum:
    """A solution in parameters instead of coordinates, with its cost and normal matrix (n, n). `target` (n,): root of twice the
    cost's increase at the end of each interval."""

    problem: Problem
    names: tuple[str, ...]
    values: Mapping[str, float]
    cost: float
    normal: np.ndarray
    target: np.ndarray


def _optimum(problem: Problem, found: Solution, uncertainty: Uncertainty) -> _Optimum:
    values = dict(zip(uncertainty.names, uncertainty.values.tolist(), strict=True))
    _, jacobian = problem.rows(values)
    normal = jacobian.T @ jacobian
    variance, unit = np.diag(uncertainty.covariance), np.zeros(len(uncertainty.values))
    # A parameter at a bound is not in the covariance, so it is excluded from the comparison.
    free = np.flatnonzero(variance > 0)
    unit[free] = np.diag(_inverse(normal[np.ix_(free, free)]))
    determined = (variance > 0) & (unit > 0)
    scale = np.sqrt(np.divide(variance, unit, out=np.ones(len(unit)), where=determined))
    # At a bound the inflation is unknown: take the largest of the others, and at least the residual's size.
    residual_std = np.sqrt(2.0 * found.cost / max(1, len(found.residual) - len(found.value)))
    worst = scale[determined].max(initial=residual_std)
    return _Optimum(problem, uncertainty.names, values, found.cost, normal, NORMAL_95 * np.where(determined, scale, worst))


class Profile:
    """The fit with parameter number `k` held, the others free in regular coordinates."""

    def __init__(self, optimum: _Optimum, k: int):
        self.optimum, self.k, self.name = optimum, k, optimum.names[k]
        problem = optimum.problem
        self.at, self.target = optimum.values[self.name], float(optimum.target[k])
        declared = next(p for p in problem.model.parameters if p.name == self.name)
        self.minimum, self.maximum = declared.minimum, declared.maximum
        self.rest = [i for i in range(len(optimum.names)) if i != k]
        names = [optimum.names[i] for i in self.rest]
        self.coordinates = Coordinates(problem.model, names, problem.coordinates.slow_first)
        self.start = self.coordinates.vector(optimum.values)
        inner, normal = self.coordinates.jacobian(self.start), optimum.normal
        # Linear response of the others to a change of the parameter.
        others = normal[np.ix_(self.rest, self.rest)]
        self.slope = -_inverse(inner.T @ others @ inner) @ (inner.T @ normal[self.rest, k])

    def end(self, side: float, linear: float) -> float:
        """Distance of the interval's end on one `side` (-1, 1): the `linear` one if that is right."""
        room = self.maximum - self.at if side > 0 else self.at - self.minimum
        if room <= 0.0:
            return 0.0
        if 0.0 < linear <= room and abs(self._expected(side * linear) / self.target - 1.0) <= DEPARTURE:
            return linear
        own = float(self.optimum.normal[self.k, self.k])
        first = linear or self.target / float(np.sqrt(max(own, 1e-300)))
        return self._search(side, first, room)

    def _search(self, side: float, away: float, room: float) -> float:
        inside, outside, slope = (0.0, 0.0), None, self.slope
        for _ in range(TRIALS):
            away = min(away, room)
            found = self._refitted(side * away, slope)
            root, slope = self.root(found.cost), (found.value - self.start) / (side * away)
            if abs(root / self.target - 1.0) <= CLOSE or (away == room and root < self.target):
                break
            if root < self.target:
                inside = away, root
            else:
                outside = away, root
            away = self._next(inside, outside)
        return away

    def _next(self, inside: tuple[float, float], outside: tuple[float, float] | None) -> float:
        """Distance at which a straight line through both (distance, root) meets the target; extrapolated if `outside` is
        None."""
        (low, below), target = inside, self.target
        if outside is None:
            return low * float(np.clip(target / max(below, 1e-300), 1.0 + CLOSE, FARTHEST))
        high, above = outside
        share = (target - below) / (above - below)
        return low + (high - low) * float(np.clip(share, 0.05, 0.95))

    def root(self, cost: float) -> float:
        """Root of twice the cost's increase over the optimum."""
        return float(np.sqrt(max(0.0, 2.0 * (cost - self.optimum.cost))))

    def _expected(self, away: float) -> float:
        """Root of the cost's increase at the distance `away` from the optimum, from one evaluation."""
        lower, upper = self._bounds(away)
        x = np.clip(self.start + away * self.slope, lower, upper)
        residual, jacobian = self._evaluate(x, away)
        gradient = jacobian.T @ residual
        free = ~((x <= lower) & (gradient > 0)) & ~((x >= upper) & (gradient < 0))
        normal = (jacobian.T @ jacobian)[np.ix_(free, free)]
        decrease = gradient[free] @ _inverse(normal) @ gradient[free]
        return self.root(0.5 * float(residual @ residual - decrease))

    def _refitted(self, away: float, slope: np.ndarray) -> Solution:
        lower, upper = self._bounds(away)
        start = np.clip(self.start + away * slope, lower, upper)
        # Tolerance of the cost: half of CLOSE in the root of its increase.
        enough = 0.5 * CLOSE * self.target**2 / self.optimum.cost
        problem, held = self.optimum.problem, {self.name: self.at + away}

        def residual_at(x: np.ndarray) -> np.ndarray:
            return problem.residual_at(self.coordinates.values(x) | held)

        return solve(lambda x: self._evaluate(x, away), start, lower, upper, enough, residual_at=residual_at)

    def _evaluate(self, x: np.ndarray, away: float) -> tuple[np.ndarray, np.ndarray]:
        values = self.coordinates.values(x) | {self.name: self.at + away}
        inner = np.zeros((len(self.optimum.names), len(self.rest)))
        inner[self.rest] = self.coordinates.jacobian(x)
        return self.optimum.problem.rows(values, inner)

    def _bounds(self, away: float) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the others. If one constant of a pair is held, the slower one stays slower."""
        lower, upper, names = self.coordinates.lower.copy(), self.coordinates.upper.copy(), self.optimum.names
        ratio, held = 1.0 + float(np.sqrt(CLOSEST)), self.at + away
        for i, j in self.optimum.problem.coordinates.pairs:
            if self.k == i:
                fast = self.coordinates.names.index(names[j])
                upper[fast] = np.clip(held / ratio, lower[fast], upper[fast])
            elif self.k == j:
                slow = self.coordinates.names.index(names[i])
                lower[slow] = np.clip(held * ratio, lower[slow], upper[slow])
        return lower, upper


def _inverse(normal: np.ndarray) -> np.ndarray:
    """Inverse of a normal matrix; its columns may vanish or coincide at a bound."""
    size = np.maximum(np.sqrt(np.diag(normal)), 1e-150)
    return np.linalg.pinv(normal / np.outer(size, size), rcond=1e-13, hermitian=True) / np.outer(size, size)
