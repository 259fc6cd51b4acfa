"""Fits of a model with one more effect: first a look at many sizes with the base linearised, then the full refit of the best.

Freezing the base while an effect is fitted to its residual finds the wrong effect in a third of the cases, for the base has
already bent towards what is missing. In the look, the base parameters may move along their sensitivities; in the refit all
parameters are free.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.diagnose.candidates import Candidate
from identification.diagnose.evidence import Evidence, Score
from identification.diagnose.linearised import Linearised
from identification.least_squares import Solution
from identification.problem import Prior
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.types import Effect
from vpp_fmu.native import Simulator

CHI2_95 = 3.841458820694124

STRETCH = (0.7, 1.4)
"""How far the look may scale an effect's trace between the sizes of the grid, which are a factor of 2 apart."""


@dataclass(frozen=True)
class Fit:
    """A fitted model: effects, forms and values, its solution and its score on the records it was fitted to.

    `thresholds`: parameters with a piecewise constant cost, found by scanning, with the interval in which the cost stays
    within the 95 % level.
    """

    effects: tuple[str, ...]
    forms: Mapping[str, float]
    free: tuple[str, ...]
    slow_first: Mapping[str, bool]
    values: Mapping[str, float]
    evidence: Evidence
    solution: Solution
    score: Score
    thresholds: Mapping[str, tuple[float, float]]

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Effects' parameters that ended on a bound where that is no form of its own."""
        active = dict(zip(self.evidence.coordinates.names, self.solution.active, strict=True))
        meant = {p.name for p in self.evidence.model.parameters if p.limit_form}
        return tuple(n for n in self.free if active.get(n, False) and n not in meant)

    def bic(self) -> float:
        """Bayesian information criterion, noise variances unknown; smaller is better."""
        total = sum(self.score.counts.values())
        deviance = sum(n * np.log(self.score.squares[c]) for c, n in self.score.counts.items())
        return float(deviance + len(self.free) * np.log(total))


class Searcher:
    """Fits on given experiments with given knowledge; `names` are the base parameters that the data can tell."""

    def __init__(self, experiments, names: Sequence[str], prior: Prior | None, library: Iterable[Effect]):
        self.experiments, self.names, self.prior, self.library = experiments, tuple(names), prior, tuple(library)

    def fit(
        self,
        effects: Sequence[str],
        forms: Mapping[str, float],
        free: Sequence[str],
        start: Mapping[str, float],
        slow_first: Mapping[str, bool] | None = None,
    ) -> Fit:
        """Fit base parameters and `free` of a model with `effects`, from the values `start`."""
        model = plant(effects, self.library)
        values = model.values({k: v for k, v in start.items() if k in model.values()} | dict(forms))
        stuck = self._thresholds(model, values, free, slow_first)
        smooth = [n for n in free if n not in stuck]
        evidence = Evidence(model, self.experiments, values, [*self.names, *smooth], self.prior, slow_first)
        solution = evidence.fit(values)
        intervals = {}
        for name in stuck:
            solution, intervals[name] = self._scan(evidence, solution, name)
        found = evidence.values | evidence.coordinates.values(solution.value)
        score = evidence.score(found, Simulator(model))
        return Fit(tuple(effects), dict(forms), tuple(free), slow_first or {}, found, evidence, solution, score, intervals)

    def _thresholds(self, model, values, free, slow_first) -> list[str]:
        """Free parameters in which the response is piecewise constant: no tangent at all."""
        if not free:
            return []
        evidence = Evidence(model, self.experiments, values, [*self.names, *free], None, slow_first)
        _, jacobian = evidence.evaluate(evidence.coordinates.vector(values))
        return [n for n in free if not np.any(jacobian[:, evidence.coordinates.names.index(n)])]

    def _scan(self, evidence: Evidence, solution: Solution, name: str):
        """Close in on one threshold by grids, the rest linearised within a grid and refitted after it.

        The whole range twice, since the first grid stands on a base that the missing effect has bent; then around the best.
        """
        low, high = {p.name: (p.minimum, p.maximum) for p in evidence.model.parameters}[name]
        simulator, near = Simulator(evidence.model), ()
        for spread in (None, None, 1.1, 1.02):
            about = Linearised(evidence, solution, evidence.values | evidence.coordinates.values(solution.value))
            at = evidence.values[name]
            first, last = (max(low, high / 200), high) if spread is None else (at / spread, min(high, at * spread))
            grid = np.geomspace(first, last, 48 if spread is None else 25).tolist()
            costs = [about.cost(simulator, {name: value}) for value in grid]
            lowest = min(costs)
            # The cost is flat between the values at which one more command counts: the middle of the flat stands for it.
            flat = [v for v, cost in zip(grid, costs, strict=True) if cost <= lowest * (1 + 1e-9)]
            near = [v for v, cost in zip(grid, costs, strict=True) if cost <= lowest + 0.5 * CHI2_95]
            evidence.values[name] = 0.5 * (flat[0] + flat[-1])
            solution = evidence.refit(solution.value)
        return solution, (near[0], near[-1])


class Look:
    """A cheap look from a fitted base at what candidates could explain."""

    def __init__(self, base: Fit, library: Iterable[Effect]):
        self._base, self._library = base, tuple(library)
        self._about = Linearised(base.evidence, base.solution, base.values)

    def at(self, candidate: Candidate) -> tuple[float, dict[str, float]]:
        """Fall of the half sum of squares at the best point of the candidate's grid, and the parameters there."""
        effect, about = candidate.effect, self._about
        simulator = Simulator(plant([*self._base.effects, effect.name], self._library))
        off = {effect.full(n): v for n, v in effect.off.items()}
        quiet = about.rows(simulator, {**candidate.form, **off})
        best = 0.0, candidate.grid()[0]
        for point in candidate.grid():
            trace = about.apart(about.rows(simulator, {**candidate.form, **point}) - quiet)
            power = float(trace @ trace)
            if power == 0.0:
                continue
            shared = -float(about.residual @ trace)
            stretch = float(np.clip(shared / power, *STRETCH))
            fall = stretch * shared - 0.5 * stretch**2 * power
            if fall > best[0]:
                best = fall, {n: v * stretch if n in off else v for n, v in point.items()}
        return best
