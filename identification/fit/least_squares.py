"""Levenberg-Marquardt within bounds, on normal equations.

scipy's solvers factor the whole Jacobian (rows x parameters) at each iteration, which costs more than the exact sensitivities
from C. Here only the normal matrix is formed, and the linear algebra has the size of the parameter vector.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

FLAT = 1e-9
"""Converged if the residual's cosine with every free column is below this (the gradient test of MINPACK)."""

STRAIGHT = 0.25
"""Maximum relative difference between actual and predicted decrease of the cost to keep the Jacobian."""

CLOSE = 0.01
"""Maximum relative decrease of the cost by a step to keep the Jacobian: after a larger one the search is far from the optimum,
and an old Jacobian may lead to another minimum."""


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
    tangent: bool = True,
) -> Solution:
    """Minimise the sum of squares of `evaluate(x) -> (residual, jacobian)` from `start` within [lower, upper].

    Stops if the residual is orthogonal to every free column, if predicted and actual decrease of the cost are below `tolerance`
    of it, or after `limit` evaluations. A parameter at a bound is fixed until the gradient points inside. Damping follows
    Nielsen's rule. `residual_at(x)`: the residual alone, if that is cheaper. It evaluates trial steps, and the Jacobian is kept
    while steps are small and as predicted (a chord method). `tangent`: the returned Jacobian is evaluated at the solution.
    """
    x = np.clip(np.asarray(start, float), lower, upper)
    residual, jacobian = evaluate(x)
    costs, evaluations, converged, fresh = [0.5 * float(residual @ residual)], 1, False, True
    damping, growth = 1e-4, 2.0
    normal, gradient = jacobian.T @ jacobian, jacobian.T @ residual
    while evaluations < limit and damping < 1e12:
        length = np.sqrt(np.diag(normal))
        at_bound = ((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0))
        free = np.flatnonzero(~at_bound & (length > 0))
        share = np.abs(gradient[free]) / (length[free] * np.sqrt(2 * costs[-1]) + 1e-300)
        gained, done = 0.0, not len(free) or share.max() < FLAT
        if not done:
            step = np.zeros_like(x)
            step[free] = _damped_step(normal[np.ix_(free, free)], gradient[free], length[free], damping)
            there = np.clip(x + step, lower, upper)
            step = there - x
            predicted = -float(gradient @ step) - 0.5 * float(step @ normal @ step)
            if predicted <= 0:  # clipped to the bounds, the step increases the cost: more damping
                damping, growth = damping * growth, growth * 2
                continue
            new_residual, new_jacobian = evaluate(there) if residual_at is None else (residual_at(there), None)
            evaluations += 1
            cost = 0.5 * float(new_residual @ new_residual)
            gained, least = costs[-1] - cost, tolerance * costs[-1]
            done = predicted <= least and abs(gained) <= least
            if gained > 0:
                x, residual, fresh = there, new_residual, new_jacobian is not None
                costs.append(cost)
                damping, growth = damping * max(1 / 3, 1 - (2 * gained / predicted - 1) ** 3), 2.0
            else:
                damping, growth = damping * growth, growth * 2
            jacobian = jacobian if new_jacobian is None or gained <= 0 else new_jacobian
        if done and (fresh or not tangent):
            converged = True
            break
        if not fresh and (done or gained <= 0 or gained > CLOSE * cost or abs(gained / predicted - 1.0) > STRAIGHT):
            del jacobian  # a long record has memory for one Jacobian only
            jacobian, fresh = evaluate(x)[1], True
        if fresh:
            normal = jacobian.T @ jacobian
        gradient = jacobian.T @ residual
    active = (x <= lower) | (x >= upper)
    return Solution(x, residual, jacobian, tuple(costs), evaluations, converged, active)


def _damped_step(normal, gradient, length, damping):
    """Solve in units of each column's length, so that damping is the same for seconds and for coefficients."""
    scaled = normal / np.outer(length, length)
    return -np.linalg.solve(scaled + damping * np.eye(len(length)), gradient / length) / length
