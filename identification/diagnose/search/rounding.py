"""Steps in which a command may be executed, found from the levels that it takes.

The response jumps in a step wherever a level's nearest multiple changes: a step must be met to a small share of step / level,
and a grid of whole simulations would need thousands of points. Instead the residual's response to each level is simulated once,
alone. What a step moves the levels by is then a product away: thousands of steps cost less than ten simulations. Each response
is taken for linear in its level, so a simulation of the best few steps decides.
"""

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2, norm

from identification.diagnose.search.threshold import CHI2_95
from identification.fit.least_squares import Solution
from identification.fit.linearised import Linearised
from identification.fit.problem import Problem
from vpp_fmu.kernel.types import Effect
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record

LEVELS = 128
"""Levels that are looked at, those held longest; on a ramp each is held for a row, and tells nothing."""

NUDGE = 0.01
"""Share of the command's range by which a level is moved to see its response."""

PHASE = 0.08
"""Share of a step by which two neighbouring steps of a search may differ in the multiples of the highest level."""

FINER = 16
"""Parts of the way from one step of the search to the next that are looked at about the best ones."""

CLOSER = 256
"""Steps of the search about which is looked more finely. Between two of them each level's multiple may change: a step may then
explain half of what its neighbour does."""

BEST, SPACED = 4, 20
"""Steps that are simulated; how many steps of the finer search are between them at least."""

BETTER = 0.5
"""Log-likelihood that another step must bring to take the place of the one that a fit has."""

SMALLEST = 1.0 / 30.0
"""Share of the largest step from which steps are looked at."""

JUDGED = 10.0
"""Log-likelihood about which chance is judged."""


class Rounding:
    """What of the residual goes with the step of an effect that rounds a command, beside a fitted model.

    `about`: the fitted model, which has the effect with the step `step`, or does not have it (0). `simulator`: of the model
    with the effect. `records`: that were fitted.
    """

    def __init__(self, about: Linearised, simulator: Simulator, effect: Effect, records: Sequence[Record], step: float = 0.0):
        ((command, parameter),) = effect.rounds.items()
        self.name = effect.full(parameter)
        self._largest = next(p.maximum for p in effect.parameters if p.name == parameter)
        seen = np.concatenate([r[command] for r in records])
        levels, rows = np.unique(seen[np.isfinite(seen)], return_counts=True)
        kept = np.sort(np.argsort(-rows, kind="stable")[:LEVELS])
        self._levels, self._from = levels[kept], rounded(levels[kept], step)
        nudge, held = NUDGE * max(float(np.ptp(levels)), self._largest), {self.name: 0.0}
        executed = [r.columns | {command: rounded(r[command], step)} for r in records]
        quiet = about.rerun(simulator, held, executed)
        responses = []
        for level in self._levels:
            moved = [c | {command: c[command] + nudge * (r[command] == level)} for c, r in zip(executed, records, strict=True)]
            shown = about.rerun(simulator, held, moved)
            responses.append(about.change([(y - z) / nudge for y, z in zip(shown, quiet, strict=True)]))
        response = about.orthogonal_part(np.column_stack(responses))
        self._cost = 0.5 * float(about.residual @ about.residual)
        self._slope, self._power = response.T @ about.residual, response.T @ response

    def costs(self, steps: np.ndarray) -> np.ndarray:
        """Half the sum of squares (n,) of the residual at steps (n,)."""
        moves, powers = self._moves(steps)
        return self._cost + moves @ self._slope + powers

    def _moves(self, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(by how much each level is executed elsewhere (n, levels), half the power (n,) of what that does to the residual)."""
        moves = rounded(self._levels, steps[:, None]) - self._from
        return moves, 0.5 * np.einsum("ij,ij->i", moves @ self._power, moves)

    @property
    def points(self) -> int:
        """Points of a candidate with one free size that chance finds as much with as with all the steps.

        A step has no free size. Half the power L of what it does is what it gains on average if it is there, and loses if it
        is not, with a variance of 2 L: it reaches x by chance with the probability Q((x + L) / sqrt(2 L)), where a free size
        reaches it with that of a chi-square of 2 x.
        """
        _, powers = self._moves(self.steps)
        powers = powers[powers > 0.0]
        reached = norm.sf((JUDGED + powers) / np.sqrt(2.0 * powers))
        return int(np.ceil(reached.sum() / chi2.sf(2.0 * JUDGED, 1)))

    @property
    def steps(self) -> np.ndarray:
        """Steps to look at, the smallest first: so many that two neighbours' multiples agree to PHASE at the highest level."""
        ends = 1.0 / self._largest, 1.0 / (SMALLEST * self._largest)
        count = int(np.ceil((ends[1] - ends[0]) * np.abs(self._levels).max() / PHASE)) + 1
        return 1.0 / np.linspace(*ends[::-1], max(2, count))

    def best(self) -> list[float]:
        """The BEST steps, the most likely first."""
        steps = self.steps
        near = steps[np.argsort(self.costs(steps), kind="stable")[:CLOSER]]
        fine = np.unique(np.concatenate([self.about(step) for step in near]))
        costs, found = self.costs(fine), []
        for k in np.argsort(costs, kind="stable"):
            if all(abs(k - other) >= SPACED for other in found):
                found.append(int(k))
            if len(found) == BEST:
                break
        return fine[found].tolist()

    def about(self, step: float, reach: float = 1.0) -> np.ndarray:
        """Steps about one, FINER as close as those of a search, over so many of their distances to both sides."""
        distance = PHASE / np.abs(self._levels).max()
        parts = np.arange(-round(reach * FINER), round(reach * FINER) + 1) / FINER
        return np.minimum(1.0 / np.maximum(1.0 / step + distance * parts, 1.0 / self._largest), self._largest)

    def interval(self, step: float, above: float) -> tuple[float, float]:
        """The first steps to both sides of one from which on the cost is more than so much `above` its own."""
        near = np.unique(self.about(step, 1.0 / PHASE))
        inside = np.flatnonzero(self.costs(near) <= self.costs(np.array([step]))[0] + above)
        return float(near[max(inside[0] - 1, 0)]), float(near[min(inside[-1] + 1, len(near) - 1)])


def settle(problem: Problem, solution: Solution, effect: Effect) -> tuple[Solution, tuple[float, float]]:
    """Close in on the step of an effect: (solution at its best value, which the problem then holds; 95 % interval)."""
    records = [e.record for e in problem.experiments]
    while True:
        about = Linearised.of(problem, solution)
        ((_, parameter),) = effect.rounds.items()
        name = effect.full(parameter)
        look = Rounding(about, problem.simulator, effect, records, problem.values[name])
        steps = [problem.values[name], *look.best()]
        costs = about.costs(problem.simulator, [{name: step} for step in steps])
        best = int(np.argmin(costs))
        if costs[0] - costs[best] < BETTER:
            return solution, look.interval(steps[0], 0.5 * CHI2_95)
        problem.values[name] = steps[best]
        solution = problem.refit(solution.value)


def rounded(values: np.ndarray, step: float | np.ndarray) -> np.ndarray:
    """What is executed of command values in steps; 0: they are."""
    return np.where(step > 0.0, step * np.rint(values / np.where(step > 0.0, step, 1.0)), values)
