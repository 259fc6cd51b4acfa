"""Thresholds: parameters in which the response is piecewise constant, such as a dead band.

They have no sensitivity, and are scanned. The smooth parameters are linearised within a grid and refitted after it.
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
"""Grids of a scan: None: the whole range; else the ratio to the current value. The whole range is scanned again if the value
has changed: the first grid uses a base that the missing effect biases."""

NEAR = (1.3, 1.05)

COARSE, FINE = 9, 48
"""Points over the whole range: to test for any change, and to find the best value."""

FINEST = 1024
"""Maximum number of parts of the range in which the response changes. Commands of a control loop differ by arbitrary amounts:
90 s of them identify a dead band of 2 deg to 0.006 deg."""

NOISE = 3.0
"""Allowance for noise, in standard deviations, when the interval between two values is assessed."""

SAME = 1e-9
"""Relative difference of costs that counts as equal."""

SMALL = 1e-9
"""Relative change of a parameter that shows whether the response is continuous in it; no steps of a command differ so little.
The values of a grid, but not the changed ones, may be those of a command."""

PARTINGS = 4
"""Refinements of the grid interval in which a constant piece of the cost ends, each by LANES values."""


def piecewise_constant(simulator: Simulator, experiments: Sequence[Experiment], values: Mapping[str, float], name: str) -> bool:
    """Whether the outputs depend on a parameter, but nowhere on a small change of it.

    An inactive limit has no influence either, but gets one as soon as it is active.
    """
    seen, grid = set(), _grid(simulator.model, name, COARSE)
    for first in range(0, COARSE, LANES // 2):
        points = [{**values, name: v * (1.0 + k * SMALL)} for v in grid[first : first + LANES // 2].tolist() for k in (1, 2)]
        runs = [simulator.simulate_all(points, *e.record.run)[:, e.compared] for e in experiments]
        shown = [tuple(run[:, :, k].tobytes() for run in runs) for k in range(len(points))]
        if shown[::2] != shown[1::2]:
            return False
        seen |= set(shown)
    return len(seen) > 1


def _grid(model: Model, name: str, count: int) -> np.ndarray:
    low, high = {p.name: (p.minimum, p.maximum) for p in model.parameters}[name]
    return np.linspace(low, high, count) if low < 0.0 else np.geomspace(max(low, high / 200), high, count)


def divided(residuals: Callable[[Sequence[float]], np.ndarray], grid: Sequence[float]) -> dict[float, float]:
    """Minimise half the sum of squares of a piecewise constant residual, by bisection of a grid: {point: half sum of squares}.

    `residuals`: function from points to residuals (rows, points). If the best value is between two neighbours whose residuals
    differ by the norm d, the better neighbour exceeds its cost by at most d^2 / 2 + NOISE d. Intervals that could contain a
    better value are halved, the most promising first, LANES at a time, down to 1 / FINEST of the range of changes.
    """

    def at(points: Sequence[float]) -> list[np.ndarray]:
        parts = (residuals(points[k : k + LANES]) for k in range(0, len(points), LANES))
        return [row for part in parts for row in np.ascontiguousarray(part.T)]

    rows = dict(zip(grid, at(grid), strict=True))
    found = {point: 0.5 * float(there @ there) for point, there in rows.items()}
    pending = [_Interval(a, b, rows[a], rows[b], min(found[a], found[b])) for a, b in pairwise(grid)]
    pending = [each for each in pending if each.distance > 0.0]
    smallest = (max((each.b for each in pending), default=0.0) - min((each.a for each in pending), default=0.0)) / FINEST
    del rows
    while True:
        best = min(found.values())
        pending = sorted((p for p in pending if p.b - p.a > smallest and p.bound < best), key=lambda p: p.bound)
        if not pending:
            return found
        halved, pending = pending[:LANES], pending[LANES:]
        middles = [0.5 * (p.a + p.b) for p in halved]
        for p, middle, there in zip(halved, middles, at(middles), strict=True):
            found[middle] = cost = 0.5 * float(there @ there)
            halves = [
                _Interval(p.a, middle, p.residual_a, there, min(found[p.a], cost)),
                _Interval(middle, p.b, there, p.residual_b, min(found[p.b], cost)),
            ]
            pending += [half for half in halves if half.distance > 0.0]


class _Interval:
    """Interval of two neighbours `a` < `b`, with their residuals (rows,). `cost`: the smaller one; `bound`: lower bound of the
    cost between them."""

    def __init__(self, a: float, b: float, residual_a: np.ndarray, residual_b: np.ndarray, cost: float):
        self.a, self.b, self.residual_a, self.residual_b = a, b, residual_a, residual_b
        change = residual_b - residual_a
        self.distance = float(np.sqrt(change @ change))
        self.bound = cost - 0.5 * self.distance**2 - NOISE * self.distance


def scan(
    problem: Problem, solution: Solution, name: str, off: float, grids: tuple[float | None, ...] = WHOLE
) -> tuple[Solution, tuple[float, float]]:
    """Estimate the threshold `name`: (solution at its best value, which is then set in the problem; 95 % interval).

    The cost is constant between the commands that bound the threshold. `off`: the value at which it has no influence.
    """
    simulator, changed = problem.simulator, True
    for near in grids:
        if near is None and not changed:
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
        changed = costs[best] < about.costs(simulator, [{}])[0] * (1.0 - SAME)
        problem.values[name] = best
        solution = problem.refit(solution.value)
    about = Linearised.of(problem, solution)
    (smallest,) = about.costs(simulator, [{}])
    # The records do not identify the value within the constant piece of the cost: the middle is taken, or, where the range ends
    # first, the end of smallest influence.
    low, high = _edges(about, simulator, name, best, smallest * (1.0 + SAME), whole)
    bounded = whole[0] < low and high < whole[-1]
    problem.values[name] = 0.5 * (low + high) if bounded else min((low, high), key=lambda value: abs(value - off))
    return solution, _edges(about, simulator, name, problem.values[name], smallest + 0.5 * CHI2_95, whole)


def _edges(
    about: Linearised, simulator: Simulator, name: str, at: float, level: float, whole: np.ndarray
) -> tuple[float, float]:
    """The last values on both sides of `at` with a cost up to `level`, within the range of `whole`."""

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
