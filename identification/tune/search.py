"""Search gains by the simplex of Nelder and Mead (1965): proportional and integral gains, then derivative gains, then all.

The paper (section 4.3) uses the first two stages, because the loop is sensitive to the derivative. The third is added because
the best proportional gains depend on the derivative. Positive gains are searched by their logarithm.

Parallel searches are repeated with the operating points and the plants that the gains found require: the operating points of a
loop with two actuators depend on its gains, and so does the worst of many plants.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from identification.tune.objective import SLACK, Objective
from identification.tune.operating import margins_at, operating_points
from identification.workers import spread

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

ROUNDS = 4
"""Maximum number of search rounds; each adds operating points and plants at which the last gains exceed a limit or the cost."""

WIDTHS = (0.3, 0.6)
"""Standard deviations of the logarithms of perturbed gains."""


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


def rounds(
    objectives: Mapping[str, Objective],
    starts: Mapping[str, Sequence[tuple[np.ndarray, Sequence[str]]]],
    reserve: np.ndarray | None = None,
    shakes: int = 0,
    workers: int = 1,
    scheduler: str | None = None,
    what: str = "",
) -> dict[str, tuple[Objective, SearchResult]]:
    """The best search for each controller, and the objective that it minimises.

    `starts`: initial gains and stages, equally many for each. `reserve` (count, parameters): plants that are added if they are
    the worst case. `shakes`: number of final searches from perturbed best gains, because the cost has many local minima.
    `workers`, `scheduler`, `what` as in `identification.workers`.
    """
    pending, done = dict(objectives), {}
    for _ in range(ROUNDS):
        jobs = [(o, *start) for name, o in pending.items() for start in starts[name]]
        best = _best(pending, jobs, workers, scheduler, what)
        for name, each in best.items():
            done[name] = pending[name], each
        extended = {name: _extended(o, best[name].gains, reserve) for name, o in pending.items()}
        pending = {name: o for name, o in extended.items() if o is not pending[name]}
        # From the initial gains if they are better: the best gains may be infeasible under the added limits.
        starts = {name: [(min(best[name].gains, o.gains, key=o.penalised), ("all",))] for name, o in pending.items()}
        if not pending:
            break
    names = [name for name, (o, each) in done.items() if each.cost > o.penalised(o.gains)]
    if names:  # all starts ended in local minima worse than the initial gains
        jobs = [(done[name][0], done[name][0].gains, ("all",)) for name in names]
        for name, each in _best(names, jobs, workers, scheduler, what).items():
            done[name] = done[name][0], each
    if shakes:
        names = list(objectives)
        jobs = [(done[name][0], perturbed, ("all",)) for name in names for perturbed in _perturbed(done[name][1].gains, shakes)]
        for name, each in _best(names, jobs, workers, scheduler, what).items():
            o, before = done[name]
            if each.cost < before.cost and _extended(o, each.gains, reserve) is o:
                done[name] = o, each
    return {name: done[name] for name in objectives}


def _perturbed(gains: np.ndarray, count: int) -> list[np.ndarray]:
    """Perturbed gains, alternating small and large perturbations; deterministic."""
    rng = np.random.default_rng(0)
    return [gains * np.exp(WIDTHS[k % len(WIDTHS)] * rng.standard_normal(len(gains))) for k in range(count)]


def _extended(objective: Objective, gains: np.ndarray, reserve: np.ndarray | None) -> Objective:
    """The objective with operating points at which the gains exceed the sensitivity, and with plants of the reserve that exceed
    its cost, both by more than SLACK; the same object if there are none."""
    extended, own = objective, operating_points(objective, gains)
    worst = max((m.sensitivity for m in margins_at(objective, gains, own)), default=0.0)
    if worst > SLACK * objective.sensitivity:
        extended = replace(extended, points=(*objective.points, *own))
    if reserve is not None:
        harder = reserve[replace(objective, plants=reserve).costs(gains) > SLACK * objective.cost(gains)]
        if len(harder):
            extended = replace(extended, plants=np.vstack([extended.plants, harder]))
    return extended


def _best(names, jobs: Sequence[tuple], workers, scheduler, what: str) -> dict[str, SearchResult]:
    """The search of least cost for each name; jobs are ordered by name, equally many for each."""
    found = spread(_search, jobs, workers, scheduler, what)
    each = len(jobs) // len(names)
    return {name: min(found[k * each : (k + 1) * each], key=lambda s: s.cost) for k, name in enumerate(names)}


def _search(job: tuple) -> SearchResult:
    return search(*job)
