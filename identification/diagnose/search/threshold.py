"""Parameters in which the response is piecewise constant: the dead band that decides which commands count.

They have no tangent; they are scanned, the smooth parameters linearised within a grid and refitted after it.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise

import numpy as np

from identification.fit.experiment import Experiment
from identification.fit.least_squares import Solution
from identification.fit.linearised import Linearised
from identification.fit.problem import Problem
from vpp_fmu.kernel.types import Model
from vpp_fmu.native import Simulator
from vpp_fmu.tracer import LANES

CHI2_95 = 3.841458820694124

WHOLE = (None, None, 1.1, 1.02)
"""Grids of a scan: None for the whole range, else the ratio to the value so far. The whole range again where it has moved:
the first grid stands on a base that the missing effect has bent."""

NEAR = (1.3, 1.05)

COARSE, FINE = 9, 48
"""Points over the whole range: to see whether anything changes, and to find where it is best."""

FINEST = 1024
"""Into how many parts the range in which anything changes is divided at most. Commands that a loop has made differ from each
other by anything: in 90 s of one a dead band of 2 deg shows where it is known to 0.006 deg, and is worse than none beside."""

NOISE = 3.0
"""Standard deviations of what noise adds to a comparison of two values that are looked between."""

SAME = 1e-9
"""Share by which costs on one flat may differ."""

PARTINGS = 4
"""How often the step of the whole range's grid in which a flat ends is parted, by LANES values at a time."""


def piecewise_constant(model: Model, experiments: Sequence[Experiment], values: Mapping[str, float], name: str) -> bool:
    """Whether what is measured changes with a parameter and yet has no tangent in it, wherever it stands.

    A limit that nothing runs into has no tangent either, but gets one as soon as something does.
    """
    simulator, seen = Simulator(model, [name]), set()
    for value in _grid(model, name, COARSE).tolist():
        shown = []
        for e in experiments:
            outputs, tangents = simulator.sensitivities({**values, name: value}, *e.record.run)
            if tangents[:, e.compared].any():
                return False
            shown.append(outputs[:, e.compared].tobytes())
        seen.add(tuple(shown))
    return len(seen) > 1


def _grid(model: Model, name: str, count: int) -> np.ndarray:
    low, high = {p.name: (p.minimum, p.maximum) for p in model.parameters}[name]
    return np.linspace(low, high, count) if low < 0.0 else np.geomspace(max(low, high / 200), high, count)


def divided(left: Callable[[Sequence[float]], np.ndarray], grid: Sequence[float]) -> dict[float, float]:
    """{point: half sum of squares of what is `left` (rows, points) there} of a grid, halved where what lies between may be the
    best.

    What is left is constant in pieces. Were the right value between two neighbours whose rows are d apart, the better of them
    would be no further from it than that: worse by d^2 / 2, give or take d for each standard deviation of noise. So they are
    halved as long as it is no more than that behind the best of all, the most promising first, LANES at a time, down to the
    FINEST-th part of the range in which anything changes. Where commands creep, each value looks like no other; else a few
    dozen tell.
    """

    def at(points: Sequence[float]) -> list[np.ndarray]:
        parts = (left(points[k : k + LANES]) for k in range(0, len(points), LANES))
        return [row for part in parts for row in np.ascontiguousarray(part.T)]

    rows = dict(zip(grid, at(grid), strict=True))
    found = {point: 0.5 * float(there @ there) for point, there in rows.items()}
    pending = [_Between(a, b, rows[a], rows[b], min(found[a], found[b])) for a, b in pairwise(grid)]
    pending = [each for each in pending if each.apart > 0.0]
    least = (max((each.b for each in pending), default=0.0) - min((each.a for each in pending), default=0.0)) / FINEST
    del rows
    while True:
        best = min(found.values())
        pending = sorted((p for p in pending if p.b - p.a > least and p.promise < best), key=lambda p: p.promise)
        if not pending:
            return found
        halved, pending = pending[:LANES], pending[LANES:]
        middles = [0.5 * (p.a + p.b) for p in halved]
        for p, middle, there in zip(halved, middles, at(middles), strict=True):
            found[middle] = cost = 0.5 * float(there @ there)
            halves = [
                _Between(p.a, middle, p.left_a, there, min(found[p.a], cost)),
                _Between(middle, p.b, there, p.left_b, min(found[p.b], cost)),
            ]
            pending += [half for half in halves if half.apart > 0.0]


class _Between:
    """Two neighbours `a` < `b`, with what is left there (rows,); `cost`: the better one's."""

    def __init__(self, a: float, b: float, left_a: np.ndarray, left_b: np.ndarray, cost: float):
        self.a, self.b, self.left_a, self.left_b = a, b, left_a, left_b
        change = left_b - left_a
        self.apart = float(np.sqrt(change @ change))
        self.promise = cost - 0.5 * self.apart**2 - NOISE * self.apart


def scan(
    problem: Problem, solution: Solution, name: str, off: float, grids: tuple[float | None, ...] = WHOLE
) -> tuple[Solution, tuple[float, float]]:
    """Close in on the threshold `name`: (solution at its best value, which the problem then holds; 95 % interval).

    The interval is of the value itself: between the commands that bound it nothing can tell where it lies. `off`: the value at
    which it acts on nothing.
    """
    simulator, moved = problem.simulator, True
    for near in grids:
        if near is None and not moved:
            continue
        spread = near if problem.values[name] > 0.0 else None  # nothing is near 0 by ratio
        about = Linearised.of(problem, solution)
        whole = _grid(problem.model, name, FINE)

        if spread is None:
            costs = divided(lambda values, about=about: about.left(simulator, [{name: v} for v in values]), whole.tolist())
        else:
            ends = problem.values[name] / spread, min(whole[-1], problem.values[name] * spread)
            values = np.geomspace(*ends, 25).tolist()
            costs = dict(zip(values, about.costs(simulator, [{name: v} for v in values]), strict=True))
        best = min(costs, key=costs.__getitem__)
        moved = costs[best] < about.costs(simulator, [{}])[0] * (1.0 - SAME)
        problem.values[name] = best
        solution = problem.refit(solution.value)
    about = Linearised.of(problem, solution)
    (least,) = about.costs(simulator, [{}])
    # The cost is flat between the values at which one more command counts. What it does to commands between them no record has
    # shown: the end of the flat at which it does least stands for it.
    flat = _edges(about, simulator, name, best, least * (1.0 + SAME), whole)
    problem.values[name] = min(flat, key=lambda value: abs(value - off))
    return solution, _edges(about, simulator, name, problem.values[name], least + 0.5 * CHI2_95, whole)


def _edges(
    about: Linearised, simulator: Simulator, name: str, at: float, level: float, whole: np.ndarray
) -> tuple[float, float]:
    """The last values on both sides of `at` from which on the cost is above `level`, within the range of `whole`."""

    def above(values: Sequence[float]) -> list[bool]:
        return [cost > level for cost in about.costs(simulator, [{name: v} for v in values])]

    found = []
    for values in (whole[whole < at][::-1].tolist(), whole[whole > at].tolist()):
        inside, beyond, onward = at, None, list(values)
        while onward and beyond is None:
            part, onward = onward[:LANES], onward[LANES:]
            first = [*above(part), True].index(True)
            inside, beyond = [inside, *part][first], [*part, None][first]
        for _ in range(PARTINGS if beyond is not None else 0):
            between = np.linspace(inside, beyond, LANES + 2)[1:-1].tolist()
            first = [*above(between), True].index(True)
            inside, beyond = [inside, *between][first], [*between, beyond][first]
        found.append(float(inside))
    return found[0], found[1]
