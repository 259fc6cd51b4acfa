"""Quasi-Newton search on the adjoint gradient: the gradient in all parameters costs a few simulations.

    J(x) = |r(x)|^2 / 2,   grad J = (dr/dx)^T r

The gradient equals that of Levenberg-Marquardt to rounding. Without the Jacobian the curvature is estimated from the steps
(L-BFGS-B: Byrd, Lu, Nocedal and Zhu, 1995). This pays with very many parameters; with ten, Levenberg-Marquardt is faster.
"""

from collections.abc import Mapping
from functools import cached_property

import numpy as np
from scipy.optimize import minimize

from identification.fit.least_squares import Solution
from identification.fit.problem import Problem
from vpp_fmu.native.adjoint import Adjoint

MEMORY = 30
"""Steps whose curvature is kept: more than there are parameters, because the cost has a long and narrow valley."""

FLAT = 1e-13
"""Converged if a step decreases the cost by less than this share of the cost at the start."""

LIMIT = 1000
"""Maximum number of evaluations."""


class AdjointProblem(Problem):
    """The same problem for white noise, solved with the adjoint gradient. CompilerMissing without a C compiler."""

    @cached_property
    def _adjoint(self) -> Adjoint:
        return Adjoint(self.model, self.coordinates.names)

    def slope(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Cost and its gradient (coordinates,) at `x`."""
        found, inner = self.values | self.coordinates.values(x), self.coordinates.jacobian(x)
        cost, gradient = 0.0, np.zeros(len(x))
        for e in self.experiments:
            tape = self._adjoint.record(found, *e.record.run)
            errors = {"thrust": e.thrust_residual(tape.outputs[:, 0]) / self.scale["thrust"]}
            if len(e.omega_time):
                errors["omega"] = e.omega_residual(tape.outputs[:, 1]) / self.scale["omega"]
            cost += 0.5 * sum(float(r @ r) for r in errors.values())
            gradient += tape.pull_back(e.pull_back({c: r / self.scale[c] for c, r in errors.items()}, tape.outputs))
        if self.prior is not None:
            error, rows = self.prior.rows(found, self.coordinates.names)
            cost, gradient = cost + 0.5 * float(np.sum(error**2)), gradient + error @ rows
        return cost, gradient @ inner

    def solve(self, start: Mapping[str, float], enough: float = 0.0, known: list[tuple] | None = None) -> Solution:
        """Fit from `start` under the present weights, always to full numerical precision. `known` is not used."""
        lower, upper = self.coordinates.lower, self.coordinates.upper
        costs, evaluations = [], 0

        def scaled(x):
            nonlocal evaluations
            cost, gradient = self.slope(x)
            evaluations += 1
            if not costs or cost < costs[-1]:
                costs.append(cost)
            return cost / costs[0], gradient / costs[0]

        options = {"maxcor": MEMORY, "ftol": FLAT, "gtol": 0.0, "maxiter": LIMIT, "maxfun": LIMIT}
        bounds = list(zip(lower, upper, strict=True))
        found = minimize(scaled, self.coordinates.vector(start), jac=True, method="L-BFGS-B", bounds=bounds, options=options)
        x = np.clip(found.x, lower, upper)
        residual, jacobian = self.evaluate(x)
        active = (x <= lower) | (x >= upper)
        return Solution(x, residual, jacobian, tuple(costs), evaluations, found.status == 0, active)
