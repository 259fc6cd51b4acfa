"""Parallel searches, repeated with the operating points and the plants that the gains found require.

The operating points of a loop with two actuators depend on its gains, and so does the worst of many plants.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from identification.tune.objective import SLACK, Objective
from identification.tune.operating import margins_at, operating_points
from identification.tune.search import SearchResult, search
from identification.workers import spread

ROUNDS = 4
"""Maximum number of search rounds; each adds operating points and plants at which the last gains exceed a limit or the cost."""

WIDTHS = (0.3, 0.6)
"""Standard deviations of the logarithms of perturbed gains."""


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
