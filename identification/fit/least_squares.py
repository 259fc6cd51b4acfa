"""Levenberg-Marquardt within bounds, on normal equations.

scipy's solvers factor the whole Jacobian (rows x parameters) at each iteration, which costs more than the exact sensitivities
from C. Here only the normal matrix is formed, and the linear algebra has the size of the parameter vector.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

FLAT = 1e-10
"""A Gauss-Newton step that decreases the cost by less than this share of it is the last: 0.001 standard deviations of the
estimate in a record of 15 000 rows. It is taken in the linearised problem, whose error is of the second order in the step."""

STRAIGHT = 0.25
"""Maximum relative difference between actual and predicted decrease of the cost to keep the Jacobian."""

CLOSE = 0.01
"""Maximum relative decrease of the cost by a step to keep the Jacobian: after a larger one the search is far from the optimum,
and an old Jacobian may lead to another minimum."""

ROUNDING = 1e-12
"""Least damping: only against a singular normal matrix."""


@dataclass(frozen=True)
class Solution:
    """Result of a search. `cost` is half the sum of squares of the residual.

    `value` (n,), `residual` (rows,), `jacobian` (rows, n) at the end; `costs`: the cost at the start and after each evaluation
    that decreased it; `active` (n,): whether a parameter is at a bound.
    """

    value: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    costs: tuple[float, ...]
    evaluations: int
    converged: bool
    active: np.ndarray

    def slim(self) -> "Solution":
        """The same without residual and Jacobian, which have as many rows as the data."""
        return replace(self, residual=np.zeros(0), jacobian=np.zeros((0, len(self.value))))

    @property
    def cost(self) -> float:
        """The final cost."""
        return self.costs[-1]


def solve(
    evaluate: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    tolerance: float = 1e-12,
    limit: int = 100,
    residual_at: Callable[[np.ndarray], np.ndarray] | None = None,
    inner: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Solution:
    """Minimise the sum of squares of `evaluate(x) -> (residual, jacobian)` from `start` within [lower, upper].

    The Jacobian is with respect to `x`, or to parameters with the derivatives `inner(x)` (parameters, n). In the second case
    only the small normal matrix and the last Jacobian are transformed.

    Stops after a Gauss-Newton step that gains less than FLAT, if predicted and actual decrease of the cost are below
    `tolerance` of it, or after `limit` evaluations. A parameter at a bound is fixed until the gradient points inside. Damping
    follows Nielsen's rule. `residual_at(x)`: the residual alone, if that is cheaper. It evaluates trial steps, and the Jacobian
    is kept while steps are small and as predicted (a chord method), but for the last step: a sum of squares has its minimum
    where its own Jacobian is orthogonal to the residual.
    """
    inner = inner or (lambda x: np.eye(len(x)))
    x = np.clip(np.asarray(start, float), lower, upper)
    residual, jacobian = evaluate(x)
    chain, costs, evaluations, converged, fresh = inner(x), [0.5 * float(residual @ residual)], 1, False, True
    damping, growth = 1e-4, 2.0
    normal, gradient = chain.T @ (jacobian.T @ jacobian) @ chain, chain.T @ (jacobian.T @ residual)
    while evaluations < limit and damping < 1e12:
        there, predicted = _step(x, normal, gradient, lower, upper, ROUNDING)
        if fresh and abs(predicted) <= FLAT * costs[-1]:
            residual = residual + jacobian @ (chain @ (there - x))
            x, converged = there, True
            costs.append(costs[-1] - predicted)
            break
        there, predicted = _step(x, normal, gradient, lower, upper, damping)
        if predicted <= 0:  # clipped to the bounds, the step increases the cost: more damping
            damping, growth = damping * growth, growth * 2
            continue
        if residual_at is None:
            del jacobian  # a long record has memory for one Jacobian only
            new_residual, jacobian = evaluate(there)
        else:
            new_residual = residual_at(there)
        evaluations += 1
        cost = 0.5 * float(new_residual @ new_residual)
        gained, least = costs[-1] - cost, tolerance * costs[-1]
        exact, converged = fresh, predicted <= least and abs(gained) <= least
        if gained > 0:
            x, residual, fresh = there, new_residual, residual_at is None
            costs.append(cost)
            damping, growth = max(damping * max(1 / 3, 1 - (2 * gained / predicted - 1) ** 3), ROUNDING), 2.0
        else:
            fresh = fresh and residual_at is not None
            damping, growth = damping * growth, growth * 2
        if converged and exact:
            break
        stale = residual_at is not None and not fresh
        bent = gained <= 0 or gained > CLOSE * cost or abs(gained / predicted - 1.0) > STRAIGHT
        if stale and evaluations < limit and (converged or bent):
            del jacobian
            jacobian, fresh = evaluate(x)[1], True
        if fresh:
            chain = inner(x)
            normal = chain.T @ (jacobian.T @ jacobian) @ chain
        if fresh or stale:
            gradient = chain.T @ (jacobian.T @ residual)
    if residual_at is None and not fresh:
        del jacobian
        jacobian = evaluate(x)[1]
    active = (x <= lower) | (x >= upper)
    return Solution(x, residual, jacobian @ chain, tuple(costs), evaluations, converged, active)


def _step(x, normal, gradient, lower, upper, damping):
    """(end of the step from `x` within the bounds, predicted decrease of the cost). Steps are solved in units of each column's
    length, so that damping is the same for seconds and for coefficients."""
    length, step = np.sqrt(np.diag(normal)), np.zeros_like(x)
    at_bound = ((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0))
    free = np.flatnonzero(~at_bound & (length > 0))
    units = length[free]
    scaled = normal[np.ix_(free, free)] / np.outer(units, units)
    step[free] = -np.linalg.solve(scaled + damping * np.eye(len(free)), gradient[free] / units) / units
    there = np.clip(x + step, lower, upper)
    step = there - x
    return there, -float(gradient @ step) - 0.5 * float(step @ normal @ step)
