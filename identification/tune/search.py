"""Search gains by the simplex of Nelder and Mead (1965): proportional and integral gains, then derivative gains, then all.

The paper (section 4.3) uses the first two stages, because the loop is sensitive to the derivative. The third is added because
the best proportional gains depend on the derivative. Positive gains are searched by their logarithm.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from identification.tune.objective import Objective

WIDTH = 0.3
"""Size of an initial simplex: in the logarithm of gains, and relative to DERIVATIVE for derivative gains."""

RANGE = (1e-3, 1e4)
"""Bounds of proportional and integral gains, as in the controller's parameters."""

DERIVATIVE = 0.06
"""Typical derivative gain over proportional gain, in the rig's time scale."""

CLOSE = 1e-4
"""Relative range of the cost over a small simplex at which it has converged."""

SMALL = 0.01
"""Size of a small simplex, in the units of WIDTH: 1 % of a gain. At a minimum the cost then varies by less than CLOSE; in a
narrow valley it may vary more, and the simplex continues."""

RESOLVED = 10.0 * CLOSE
"""Relative decrease of the cost by one simplex above which another one follows."""


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Result of a search: `gains` (n,), and their `cost` with penalties."""

    gains: np.ndarray
    cost: float


def search(objective: Objective, start: np.ndarray, stages: Sequence[str] = ("PI", "D", "all")) -> SearchResult:
    """Search from the gains `start` (n,) through the stages; with a stage "PI", derivative gains start at 0."""
    derivative = np.array([name.startswith("kd") for name in objective.names])
    gains, cost = np.where(derivative, 0.0, start) if "PI" in stages else start, np.inf
    chosen = {"PI": ~derivative, "D": derivative, "all": np.ones_like(derivative)}
    for stage in stages:
        gains, cost = _stage(objective, gains, chosen[stage], derivative)
    return SearchResult(gains, cost)


def _stage(objective: Objective, start: np.ndarray, free: np.ndarray, derivative: np.ndarray) -> tuple[np.ndarray, float]:
    """Repeat the simplex from its result until the cost no longer decreases: a single simplex may collapse on a ridge."""
    size = np.where(derivative, DERIVATIVE * objective.time_scale * np.tile(start[: derivative.sum()], 3), 1.0)
    low, high = np.where(derivative, 0.0, np.log(RANGE[0]))[free], np.where(derivative, np.inf, np.log(RANGE[1]))[free]

    def gains_at(x: np.ndarray) -> np.ndarray:
        gains = start.copy()
        gains[free & derivative] = (size[free] * x)[derivative[free]]
        gains[free & ~derivative] = np.exp(x[~derivative[free]])
        return gains

    def cost_at(x: np.ndarray) -> float:
        return objective.penalised(gains_at(x))

    x = np.where(derivative, start / size, np.log(np.clip(start, *RANGE)))[free]
    best = cost_at(x)
    gained = np.inf
    while gained > RESOLVED * best:
        simplex = np.vstack([x, x + WIDTH * np.eye(len(x))])
        options = {"initial_simplex": simplex, "xatol": SMALL, "fatol": CLOSE * best, "adaptive": True, "maxfev": 200 * len(x)}
        found = minimize(cost_at, x, method="Nelder-Mead", bounds=list(zip(low, high, strict=True)), options=options)
        gained = best - found.fun
        if gained > 0.0:
            x, best = found.x, found.fun
    return gains_at(x), best
