"""Estimate the step (quantum) to which a command is rounded.

The cost jumps where the nearest multiple of a command level changes: a grid of simulations would need thousands of points.
Instead, the response of the residual to each level is simulated once. The response to a step is their linear combination:
thousands of steps cost less than ten simulations. A simulation of the best few steps decides.
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
from vpp_fmu.tracer import LANES

LEVELS = 128
"""Maximum number of levels that are used, those held longest."""

BRIEF = 0.125 / LEVELS
"""Share of the rows up to which a level is omitted, such as those of a ramp: they have little information."""

NUDGE = 0.01
"""Share of the command's range by which a level is perturbed."""

PHASE = 0.08
"""Grid spacing: share of a step by which two neighbours may differ in their multiples at the highest level."""

FINER = 16
"""Fine grid points per interval of the grid, about its best points."""

CLOSER = 256
"""Best grid points about which the grid is refined. Multiples may change between two points: one may then explain half as much
as its neighbour."""

BEST, SPACED = 4, 20
"""Steps that are simulated; minimum number of fine grid points between them."""

BETTER = 0.5
"""Log-likelihood gain that another step needs to replace that of a fit."""

SMALLEST = 1.0 / 30.0
"""Smallest step of the grid, as a share of the largest."""

JUDGED = 10.0
"""Log-likelihood gain at which a step's chance of a false gain is compared with that of a free size."""


class Rounding:
    """Cost of a fitted model as a function of the step of an effect that rounds a command.

    `about`: the fitted model, which has the effect with the step `step`, or does not have it (0). `simulator`: of the model
    with the effect. `records`: the fitted records.
    """

    def __init__(self, about: Linearised, simulator: Simulator, effect: Effect, records: Sequence[Record], step: float = 0.0):
        ((command, parameter),) = effect.rounds.items()
        self.name = effect.full(parameter)
        self._largest = next(p.maximum for p in effect.parameters if p.name == parameter)
        seen = np.concatenate([r[command] for r in records])
        levels, rows = np.unique(seen[np.isfinite(seen)], return_counts=True)
        longest = np.argsort(-rows, kind="stable")[:LEVELS]
        held = longest[rows[longest] > BRIEF * rows.sum()]
        kept = np.sort(held if len(held) else longest)
        self._levels, self._from = levels[kept], rounded(levels[kept], step)
        nudge, held = NUDGE * max(float(np.ptp(levels)), self._largest), {self.name: 0.0}
        executed = [r.columns | {command: rounded(r[command], step)} for r in records]
        baseline = about.rerun(simulator, held, executed)

        def nudged(columns, at: np.ndarray):
            return columns | {command: columns[command] + nudge * at}

        responses = []
        for first in range(0, len(self._levels), LANES):
            runs = [
                about.rerun(simulator, held, [nudged(c, r[command] == level) for c, r in zip(executed, records, strict=True)])
                for level in self._levels[first : first + LANES]
            ]
            shown = (np.stack(each, axis=-1) for each in zip(*runs, strict=True))
            responses.append(about.change([(y - z[..., None]) / nudge for y, z in zip(shown, baseline, strict=True)]))
        response = about.orthogonal_part(np.hstack(responses))
        self._cost = 0.5 * float(about.residual @ about.residual)
        self._slope, self._power = response.T @ about.residual, response.T @ response

    def costs(self, steps: np.ndarray) -> np.ndarray:
        """Half the sum of squares (n,) of the residual at steps (n,)."""
        moves, powers = self._moves(steps)
        return self._cost + moves @ self._slope + powers

    def _moves(self, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(rounding of each level (n, levels), half the power (n,) of the residual's response)."""
        moves = rounded(self._levels, steps[:, None]) - self._from
        return moves, 0.5 * np.einsum("ij,ij->i", moves @ self._power, moves)

    @property
    def points(self) -> int:
        """Equivalent number of comparisons: points of a candidate with one free size that have the same chance of a false gain.

        A step has no free size. Let L be half the power of its response. Its gain has the mean L if it is real, else -L; the
        variance is 2 L. By chance it reaches x with probability Q((x + L) / sqrt(2 L)); a free size reaches it with the
        probability that a chi-square variable exceeds 2 x.
        """
        _, powers = self._moves(self.steps)
        powers = powers[powers > 0.0]
        reached = norm.sf((JUDGED + powers) / np.sqrt(2.0 * powers))
        return int(np.ceil(reached.sum() / chi2.sf(2.0 * JUDGED, 1)))

    @property
    def steps(self) -> np.ndarray:
        """Grid of steps, ascending: multiples of two neighbours agree to PHASE at the highest level."""
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
        """Fine grid about a step, FINER points per grid interval, over `reach` intervals to both sides."""
        distance = PHASE / np.abs(self._levels).max()
        parts = np.arange(-round(reach * FINER), round(reach * FINER) + 1) / FINER
        return np.minimum(1.0 / np.maximum(1.0 / step + distance * parts, 1.0 / self._largest), self._largest)

    def interval(self, step: float, above: float) -> tuple[float, float]:
        """The first steps to both sides beyond which the cost exceeds that of `step` by more than `above`."""
        near = np.unique(self.about(step, 1.0 / PHASE))
        inside = np.flatnonzero(self.costs(near) <= self.costs(np.array([step]))[0] + above)
        return float(near[max(inside[0] - 1, 0)]), float(near[min(inside[-1] + 1, len(near) - 1)])


def settle(problem: Problem, solution: Solution, effect: Effect) -> tuple[Solution, tuple[float, float]]:
    """Estimate the step of an effect: (solution at its best value, which is then set in the problem; 95 % interval)."""
    records = [e.record for e in problem.experiments]
    while True:
        about = Linearised.of(problem, solution)
        ((_, parameter),) = effect.rounds.items()
        name = effect.full(parameter)
        rounding = Rounding(about, problem.simulator, effect, records, problem.values[name])
        steps = [problem.values[name], *rounding.best()]
        costs = about.costs(problem.simulator, [{name: step} for step in steps])
        problem.values[name] = steps[int(np.argmin(costs))]
        refit = problem.refit(solution.value) if costs[0] - min(costs) >= BETTER else solution
        if refit.cost >= solution.cost:  # the refit does not have the decrease that the linearised refit predicts
            problem.values[name] = steps[0]
            return solution, rounding.interval(steps[0], 0.5 * CHI2_95)
        solution = refit


def rounded(values: np.ndarray, step: float | np.ndarray) -> np.ndarray:
    """Command values rounded to multiples of `step`; 0: unchanged."""
    return np.where(step > 0.0, step * np.rint(values / np.where(step > 0.0, step, 1.0)), values)
