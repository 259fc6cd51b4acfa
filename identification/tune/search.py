"""The search for gains: Nelder and Mead's simplex (1965), proportional and integral gains first, then derivative, then all.

The order is the paper's (section 4.3), for the loop is sensitive to the derivative; the last round is ours, since the best
proportional gains with a derivative are not those without. Gains that can't be 0 are searched by their logarithm.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from identification.tune.objective import Objective

WIDTH = 0.3
"""Size of a first simplex: gains by their logarithm, derivative gains in their own size."""

RANGE = (1e-3, 1e4)
"""Of proportional and integral gains; the controller's parameters go as far."""

DERIVATIVE = 0.06
"""Of the rig's time scale: a derivative gain's size as a share of the proportional gain beside it."""

CLOSE = 1e-4
"""Share of the cost over a simplex at which it has ended, if it is small."""

SMALL = 0.01
"""Size of a simplex that is small, in the units of WIDTH: a per cent of a gain. At a minimum that costs less than CLOSE; in a
narrow valley it may cost more, and the simplex goes on."""

RESOLVED = 10.0 * CLOSE
"""Share of the cost that another simplex must bring for the search to go on: less is no gain."""


@dataclass(frozen=True, eq=False)
class Search:
    """What a search found: `gains` (n,), their `cost` with penalties, and the cost of everything tried, in order.

    `stages`: (name, evaluations up to its end).
    """

    gains: np.ndarray
    cost: float
    curve: np.ndarray
    stages: tuple[tuple[str, int], ...]

    def after(self, before: "Search") -> "Search":
        """This search as what went on where `before` had ended."""
        stages = [(name, len(before.curve) + end) for name, end in self.stages]
        return replace(self, curve=np.r_[before.curve, self.curve], stages=(*before.stages, *stages))


def search(objective: Objective, start: np.ndarray, stages: Sequence[str] = ("PI", "D", "all")) -> Search:
    """Search from the gains `start` (n,) through the stages; the first begins without derivative where "PI" is among them."""
    curve: list[float] = []
    ends = []
    derivative = np.array([name.startswith("kd") for name in objective.names])
    gains = np.where(derivative, 0.0, start) if "PI" in stages else start
    chosen = {"PI": ~derivative, "D": derivative, "all": np.ones_like(derivative)}
    for stage in stages:
        gains, cost = _stage(objective, gains, chosen[stage], derivative, curve)
        ends.append((stage, len(curve)))
    return Search(gains, cost, np.array(curve), tuple(ends))


def _stage(objective: Objective, start: np.ndarray, free: np.ndarray, derivative: np.ndarray, curve: list[float]):
    """Simplexes, each from where the last one ended, until one brings nothing: a single one may collapse on a ridge."""
    size = np.where(derivative, DERIVATIVE * objective.time_scale * np.tile(start[: derivative.sum()], 3), 1.0)
    low, high = np.where(derivative, 0.0, np.log(RANGE[0]))[free], np.where(derivative, np.inf, np.log(RANGE[1]))[free]

    def gains_at(x: np.ndarray) -> np.ndarray:
        gains = start.copy()
        gains[free & derivative] = (size[free] * x)[derivative[free]]
        gains[free & ~derivative] = np.exp(x[~derivative[free]])
        return gains

    def cost_at(x: np.ndarray) -> float:
        curve.append(objective.penalised(gains_at(x)))
        return curve[-1]

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
