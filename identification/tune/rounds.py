"""Searches side by side, and again where an objective turns out to have left out what the gains that it led to run into.

Which operating points a loop of two actuators rests at follows from its gains; so does which of many plants is the worst.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from identification.tune.objective import SLACK, Objective
from identification.tune.operating import margins_at, operating_points
from identification.tune.search import Search, search
from identification.workers import spread

ROUNDS = 4
"""Searches at most, each with the operating points and the plants that the one before ran into."""

WIDTHS = (0.3, 0.6)
"""Standard deviations of the logarithms of shaken gains."""


def rounds(
    objectives: Mapping[str, Objective],
    starts: Mapping[str, Sequence[tuple[np.ndarray, Sequence[str]]]],
    reserve: np.ndarray | None = None,
    shakes: int = 0,
    workers: int = 1,
    scheduler: str | None = None,
    what: str = "",
) -> dict[str, tuple[Objective, Search]]:
    """The best search for each controller, and the objective that it has made small.

    `starts`: gains and stages to search from, as many for each. `reserve` (count, parameters): plants that count as well, for
    the worst case. `shakes`: searches from gains around the best in the end, for the cost has many hollows. `workers`,
    `scheduler`, `what` as in `identification.workers`.
    """
    pending, done = dict(objectives), {}
    for _ in range(ROUNDS):
        jobs = [(o, *start) for name, o in pending.items() for start in starts[name]]
        best = _best(pending, jobs, workers, scheduler, what)
        for name, each in best.items():
            done[name] = pending[name], each.after(done[name][1]) if name in done else each
        fuller = {name: _fuller(o, best[name].gains, reserve) for name, o in pending.items()}
        pending = {name: o for name, o in fuller.items() if o is not pending[name]}
        # Perhaps from the first gains again: the best may lie where the limits that are added now leave no way out.
        starts = {name: [(min(best[name].gains, o.gains, key=o.penalised), ("all",))] for name, o in pending.items()}
        if not pending:
            break
    names = [name for name, (o, each) in done.items() if each.cost > o.penalised(o.gains)]
    if names:  # all starts have ended in worse hollows than the one that the first gains are in
        jobs = [(done[name][0], done[name][0].gains, ("all",)) for name in names]
        for name, each in _best(names, jobs, workers, scheduler, what).items():
            done[name] = done[name][0], each.after(done[name][1])
    if shakes:
        names = list(objectives)
        jobs = [(done[name][0], shaken, ("all",)) for name in names for shaken in _shaken(done[name][1].gains, shakes)]
        for name, each in _best(names, jobs, workers, scheduler, what).items():
            o, before = done[name]
            if each.cost < before.cost and _fuller(o, each.gains, reserve) is o:
                done[name] = o, each.after(before)
    return {name: done[name] for name in objectives}


def _shaken(gains: np.ndarray, count: int) -> list[np.ndarray]:
    """Gains around the given ones, near and far in turn; always the same."""
    rng = np.random.default_rng(0)
    return [gains * np.exp(WIDTHS[k % len(WIDTHS)] * rng.standard_normal(len(gains))) for k in range(count)]


def _fuller(objective: Objective, gains: np.ndarray, reserve: np.ndarray | None) -> Objective:
    """The objective with the operating points where the gains exceed the sensitivity, and with the plants in reserve that cost
    more than all that it has, both by more than SLACK; itself where there are none."""
    fuller, own = objective, operating_points(objective, gains)
    worst = max((m.sensitivity for m in margins_at(objective, gains, own)), default=0.0)
    if worst > SLACK * objective.sensitivity:
        fuller = replace(fuller, points=(*objective.points, *own))
    if reserve is not None:
        harder = reserve[replace(objective, plants=reserve).costs(gains) > SLACK * objective.cost(gains)]
        if len(harder):
            fuller = replace(fuller, plants=np.vstack([fuller.plants, harder]))
    return fuller


def _best(names, jobs: Sequence[tuple], workers, scheduler, what: str) -> dict[str, Search]:
    """The cheapest search for each of the names; as many jobs belong to each, one name after the other."""
    found = spread(_search, jobs, workers, scheduler, what)
    each = len(jobs) // len(names)
    return {name: min(found[k * each : (k + 1) * each], key=lambda s: s.cost) for k, name in enumerate(names)}


def _search(job: tuple) -> Search:
    return search(*job)
