"""The paper's fine-tuning: gradient descent on forward sensitivities (paper, section 3.2).

    J(p) = mean((T_hat - T)^2) / 2,   grad J = mean((T_hat - T) z),   z = dT_hat / dp,   p <- p - eta grad J

in normalised thrust, stopped when two costs in a row differ by less than a threshold. The paper's J carries a further factor
dt, which its figures show was not meant. The sensitivities here are exact, where the paper integrates them by Euler steps.
"""

import numpy as np

from identification.fit.least_squares import Solution
from identification.fit.problem import Problem

RATE = 0.5
"""The update step eta; the paper gives none. Much above 1 diverges on the paper's own map."""

THRESHOLD = 1e-9
"""Smallest fall of J between iterations that goes on; the paper gives none, its curve is flat to this at its end."""


def descend(
    problem: Problem, start: np.ndarray, rate: float = RATE, threshold: float = THRESHOLD, limit: int = 5000
) -> Solution:
    """Run the paper's descent from coordinates `start`, in the parameters themselves. Costs are half sums of squares.

    The problem's residual must be normalised thrust. A step that leaves the parameters' bounds ends on them.
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
