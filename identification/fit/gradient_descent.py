"""The paper's fine-tuning: gradient descent on forward sensitivities (paper, section 3.2).

    J(p) = mean((T_hat - T)^2) / 2,   grad J = mean((T_hat - T) z),   z = dT_hat / dp,   p <- p - eta grad J

in normalised thrust. It stops if two successive costs differ by less than a threshold. The paper's J has a further factor dt,
which contradicts its figures. The sensitivities here are exact; the paper integrates them by Euler steps.
"""

import numpy as np

from identification.fit.least_squares import Solution
from identification.fit.problem import Problem

RATE = 0.5
"""The update step eta; the paper gives none. Much above 1 diverges on the paper's own map."""

THRESHOLD = 1e-9
"""Minimum decrease of J to continue; the paper gives none, and its curve is flat to this at the end."""


def descend(
    problem: Problem, start: np.ndarray, rate: float = RATE, threshold: float = THRESHOLD, limit: int = 5000
) -> Solution:
    """Run the paper's descent in the parameters, from coordinates `start`. Costs are half sums of squares.

    The problem's residual must be normalised thrust. Steps are clipped to the parameters' bounds.
    """
    coordinates = problem.coordinates
    x = np.clip(start, coordinates.lower, coordinates.upper)
    costs, converged = [], False
    residual = jacobian = None
    while len(costs) < limit:
        found = coordinates.values(x)
        residual, own = problem.rows(found)
        jacobian = own @ coordinates.jacobian(x)
        costs.append(0.5 * float(residual @ residual))
        if len(costs) > 1 and abs(costs[-2] - costs[-1]) < threshold * len(residual):
            converged = True
            break
        values = np.array(list(found.values())) - rate * (own.T @ residual) / len(residual)
        x = coordinates.vector(dict(zip(coordinates.names, np.maximum(values, coordinates.floor), strict=True)))
    active = (x <= coordinates.lower) | (x >= coordinates.upper)
    return Solution(x, residual, jacobian, tuple(costs), len(costs), converged, active)
