"""Fits of a model with effects, all parameters free.

The base parameters are refitted together with each effect. Fitted alone, the base is biased by the missing effect: an effect
fitted to its residual is the wrong one in a third of the cases.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from identification.assessment.profile import profiled
from identification.diagnose.search.rounding import settle
from identification.diagnose.search.threshold import NEAR, WHOLE, piecewise_constant, scan
from identification.fit.coordinates import regular_start
from identification.fit.experiment import Experiment
from identification.fit.least_squares import Solution
from identification.fit.linearised import Linearised
from identification.fit.noise import independent
from identification.fit.problem import Prior, Problem, Score
from identification.fit.refine import Refinement
from identification.fit.uncertainty import NORMAL_95, WIDEST, Uncertainty, disagreement, uncertainty
from identification.static.at_rest import Knowledge
from identification.static.static_map import TERMS
from vpp_fmu.kernel.ops import NUMBERS
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.signals import BETA_REF, OMEGA_REF
from vpp_fmu.kernel.types import Effect, Model, start
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record

NOTHING = 1e-9
"""Share of the thrust's scale below which a change is a rounding error."""

LOOKS = 4
"""Evaluations of a first look at a start: two Gauss-Newton steps or so."""


@dataclass(frozen=True)
class Fit:
    """A fitted model: effects, forms and values, its solution and its score on the fitted records.

    To save memory, `solution` omits residual and Jacobian; `tangent` computes them.

    `thresholds`: parameters with a piecewise constant cost, found by scanning, with their 95 % interval. `idle`: some of the
    effects' parameters had no influence, so that a simpler effect would do the same. `estimate`: the uncertainty of values
    estimated as in an identification; None for values of maximum likelihood. `parts`: fits of single channels that gave the
    values.
    """

    effects: tuple[str, ...]
    forms: Mapping[str, float]
    free: tuple[str, ...]
    slow_first: Mapping[str, bool]
    values: Mapping[str, float]
    problem: Problem
    solution: Solution
    score: Score
    thresholds: Mapping[str, tuple[float, float]]
    idle: bool
    estimate: Uncertainty | None = None
    parts: tuple["Fit", ...] = ()

    def with_values_of(self, parts: Sequence["Fit"]) -> "Fit":
        """The same effects with the values of fits of single channels. Where the law of the speed is not exact, a fit of all
        channels pulls the parameters of the thrust away from theirs."""
        shares = [(p, [n for n in (*p.problem.coordinates.names, *p.free) if n in self.values]) for p in parts]
        values = self.values | {n: p.values[n] for p, own in shares for n in own}
        again = replace(self, values=values)._anew(self.problem.experiments, self.problem.prior)
        x = again.problem.coordinates.vector(values)
        again.problem.weigh(again.problem.residual_at(values))
        cost = 0.5 * float(np.sum(again.problem.residual_at(values) ** 2))
        idle = np.zeros(len(x), bool)
        *others, (last, its) = shares  # its lags of the pitch count, where the speed tells them, too
        estimate = last.uncertainty.only(its)
        for part, own in others:
            estimate = estimate.beside(part.uncertainty, own)
        solution = Solution(x, np.zeros(0), np.zeros((0, len(x))), (cost,), 1, True, idle)
        return replace(again, values=values, solution=solution, estimate=estimate, parts=tuple(parts))

    def with_thresholds(self, values: Mapping[str, float], intervals: Mapping[str, tuple[float, float]]) -> "Fit":
        """The same with other thresholds, in narrower intervals. All other parameters are held."""
        moved = replace(self, values={**self.values, **values}, thresholds=intervals)
        return moved._anew(self.problem.experiments, self.problem.prior)

    def estimated(self, found: Refinement, uncertainty: Uncertainty) -> "Fit":
        """The same effects with the estimates of a refinement. The score is unchanged."""
        values = {**self.values, **found.values}
        return replace(self, values=values, problem=found.problem, solution=found.solution.slim(), estimate=uncertainty)

    def prior(self, knowledge: Knowledge | None) -> Prior | None:
        """Prior of the free parameters."""
        return knowledge and knowledge(self.problem.model, self.values, self.problem.coordinates.names)

    def as_identified(self, knowledge: Knowledge | None) -> "Fit":
        """The same effects, their smooth parameters estimated as in an identification: with independent noise, and `knowledge`
        as the prior."""
        scale = self.values["thrust_scale"]
        again = self._anew([e.of_noise(independent(scale)) for e in self.problem.experiments], self.prior(knowledge))
        return again._solved(again.problem.solve_and_weigh(self.values)[-1])

    def with_map_of(self, other: "Fit") -> "Fit":
        """The same effects, with the thrust map of another fit; effects and lags are estimated as in an identification.

        Beside effects that act only during transients, the records may not identify the map; these effects do not change it."""
        scale, c = self.values["thrust_scale"], self.problem.coordinates
        names, held = [n for n in c.names if n not in TERMS], {n: other.values[n] for n in c.names if n in TERMS}
        experiments = [e.of_noise(independent(scale)) for e in self.problem.experiments]
        problem = Problem(self.problem.model, experiments, {**self.values, **held}, names, None, c.slow_first)
        again = replace(self, problem=problem)
        again = again._solved(problem.solve_and_weigh(problem.values)[-1])
        return replace(again, estimate=again.uncertainty.beside(other.uncertainty, held))

    def agreed(self, knowledge: Knowledge) -> "Fit":
        """The same effects, with the prior of the static thrust as wide as its disagreement with the records requires.

        With fewer effects, the disagreement may come from a missing one. Effects that act only during transients bias no static
        point: with them the prior gets no wider."""
        nominal = self.prior(knowledge)
        if nominal is None:
            return self
        loose = self._with_prior(nominal.loosened(WIDEST))
        factor, prior = disagreement(nominal, loose.uncertainty), self.problem.prior
        if prior is not None and factor >= prior.wider_than(nominal) and not self.at_rest:
            return self
        return loose if factor == WIDEST else loose._with_prior(nominal.loosened(factor))

    @property
    def at_rest(self) -> bool:
        """Whether the effects change the settled thrust at any corner of the records' commands."""
        model, off = self.problem.model, {}
        for e in model.effects:
            if e.name in self.effects:
                off |= e.switched_off
        return any(
            abs(_settled(model, self.values, at) - _settled(model, self.values | off, at))
            > NOTHING * self.values["thrust_scale"]
            for e in self.problem.experiments
            for at in _corners(e.record)
        )

    def _with_prior(self, prior: Prior) -> "Fit":
        again = self._anew(self.problem.experiments, prior)
        solution = again.problem.fit(self.values)
        return replace(again._solved(solution), score=again.problem.score_of(solution.residual))

    def _anew(self, experiments: Sequence[Experiment], prior: Prior | None) -> "Fit":
        c = self.problem.coordinates
        return replace(self, problem=Problem(self.problem.model, experiments, self.values, c.names, prior, c.slow_first))

    def _solved(self, solution: Solution) -> "Fit":
        values = self.problem.values | self.problem.coordinates.values(solution.value)
        return replace(self, values=values, solution=solution.slim())

    @cached_property
    def uncertainty(self) -> Uncertainty:
        """Uncertainty of the smooth parameters, and those that are not identifiable.

        If the linear 95 % interval of an effect's only size includes "off", the profile likelihood gives it."""
        solution = self.problem.with_rows(self.solution)
        found = self.estimate or uncertainty(self.problem, solution)
        if found.names != self.problem.coordinates.names:  # some values are of another fit
            return found
        sizes = [e.switched_off for e in self.problem.model.effects if len(e.switched_off) == 1]
        off = {name: value for size in sizes for name, value in size.items()}
        ends = zip(found.names, found.intervals.tolist(), strict=True)
        unsure = {name for name, (low, high) in ends if name in off and low <= off[name] <= high} - {*found.left_open}
        return profiled(self.problem, solution, found, only=unsure) if unsure else found

    def std(self) -> dict[str, float | None]:
        """Standard errors of all fitted parameters; None if not identifiable. A threshold's follows from its interval."""
        found = dict(zip(self.uncertainty.names, self.uncertainty.std.tolist(), strict=True)) | dict.fromkeys(
            self.uncertainty.left_open
        )
        return found | {n: (high - low) / (2.0 * NORMAL_95) for n, (low, high) in self.thresholds.items()}

    def intervals(self) -> dict[str, tuple[float, float]]:
        """95 % intervals of the identifiable parameters."""
        found = zip(self.uncertainty.names, map(tuple, self.uncertainty.intervals.tolist()), strict=True)
        return {n: ends for n, ends in found if n not in self.uncertainty.left_open} | dict(self.thresholds)

    def leaves_open(self, effect: Effect) -> bool:
        """Whether any of an effect's parameters is not identifiable."""
        return any(effect.full(p.name) in self.uncertainty.left_open for p in effect.parameters)

    def tangent(self) -> tuple[np.ndarray, np.ndarray]:
        """(residual, Jacobian) at the solution, as `Problem.evaluate`. A parameter that a bound holds does not follow: two lags
        that would be complex stay a double pole."""
        x, bounds = self.solution.value, self.problem.coordinates
        residual, jacobian = self.problem.evaluate(x)
        slope = jacobian.T @ residual
        held = (x <= bounds.lower) & (slope > 0.0) | (x >= bounds.upper) & (slope < 0.0)
        return residual, np.where(held, 0.0, jacobian) if held.any() else jacobian

    def linearised(self) -> Linearised:
        """The model, linear in its smooth parameters about the solution."""
        return Linearised(self.problem, self.solution.value, *self.tangent())

    @property
    def at_limit(self) -> tuple[str, ...]:
        """Effects' parameters that ended on a bound."""
        active = dict(zip(self.problem.coordinates.names, self.solution.active, strict=True))
        return tuple(n for n in self.free if active.get(n, False))

    @property
    def at_bound(self) -> tuple[str, ...]:
        """The same without parameters whose bound is a form by design."""
        meant = {p.name for p in self.problem.model.parameters if p.limit_form}
        return tuple(n for n in self.at_limit if n not in meant)

    @property
    def deviance(self) -> float:
        """-2 log-likelihood with unknown noise variances, up to a constant."""
        return self.score.deviance

    def bic(self) -> float:
        """Bayesian information criterion; smaller is better."""
        return self.deviance + len(self.free) * float(np.log(sum(self.score.counts.values())))


class Searcher:
    """Fits models to given experiments. `knowledge`: the prior, its standard deviations multiplied by `factor`; `names`: the
    identifiable base parameters."""

    def __init__(
        self,
        experiments: Sequence[Experiment],
        names: Sequence[str],
        knowledge: Knowledge | None,
        library: Iterable[Effect],
        factor: float = 1.0,
    ):
        self.experiments, self.names, self.library = tuple(experiments), tuple(names), tuple(library)
        self.knowledge, self.factor = knowledge, factor
        self.screened: dict[tuple, dict] = {}
        self._fits: dict[tuple, Fit] = {}
        self.points = 0  # the largest number of points screened in one round
        self._off = {name: value for effect in self.library for name, value in effect.switched_off.items()}

    def fit(
        self,
        effects: Sequence[str],
        forms: Mapping[str, float],
        free: Sequence[str],
        start: Mapping[str, float],
        slow_first: Mapping[str, bool] | None = None,
        thorough: bool = True,
        held: Mapping[str, tuple[float, float]] | None = None,
    ) -> Fit:
        """Fit base parameters and `free` of a model with `effects`, from the values `start`.

        `thorough`: scan the whole range of a threshold, not only about its start value. `held`: intervals of thresholds that
        keep their values. Results are cached.
        """
        order, held = dict(slow_first or {}), dict(held or {})
        asked = tuple(effects), frozenset(forms.items()), tuple(free), frozenset(start.items()), thorough
        known = (*asked, frozenset(order.items()), frozenset(held))
        if known not in self._fits:
            self._fits[known] = self._fitted(effects, forms, free, start, order, thorough, held)
        return self._fits[known]

    def _fitted(self, effects, forms, free, start, slow_first, thorough, held) -> Fit:
        model, values = self._model(effects, forms, start)
        intervals = {name: ends for name, ends in held.items() if name in free}
        smooth, stuck = self._kinds(model, values, [n for n in free if n not in intervals])
        idle = [n for n in free if n not in smooth and n not in stuck and n not in intervals]
        # A parameter without influence on these records may have one on others: it is switched off.
        values |= {n: self._off[n] for n in idle if n in self._off and self._unreached(model, values, n)}
        problem = self._problem(model, values, smooth, slow_first)
        solution = problem.fit(problem.values)
        rounding = {e.full(p): e for e in model.effects for p in e.rounds.values()}
        for name in stuck if len(stuck) < 2 else stuck * 2:  # two are scanned twice: each with the other's last value
            if name in rounding:
                solution, intervals[name] = settle(problem, solution, rounding[name])
            else:
                grids = WHOLE if thorough else NEAR
                solution, intervals[name] = scan(problem, solution, name, self._off.get(name, 0.0), grids)
        fitted = tuple(n for n in free if n in smooth or n in intervals)
        return _fit(effects, forms, fitted, slow_first, problem, solution, intervals, bool(idle))

    def look(self, effects, forms, free, start, slow_first: Mapping[str, bool], scale: Mapping[str, float]) -> Fit:
        """A first look from a start: two Gauss-Newton steps or so, under the weights `scale` of the channels. Parameters in
        which the response jumps, or has no sensitivity, keep their values."""
        model, values = self._model(effects, forms, start)
        jumping = {e.full(p) for e in model.effects for p in e.rounds.values()}
        problem = self._problem(model, values, [n for n in free if n not in jumping], slow_first)
        problem.scale = dict(scale)
        solution = problem.refit(problem.coordinates.vector(problem.values), LOOKS)
        return _fit(effects, forms, tuple(free), dict(slow_first), problem, solution, {}, False)

    def counted(self, look: Fit, held: Mapping[str, tuple[float, float]]) -> Fit:
        """A first look without the parameters that have no influence, and with its thresholds named; some are `held`."""
        smooth, stuck = self._kinds(look.problem.model, look.values, [n for n in look.free if n not in held])
        thresholds = dict(held) | {n: (look.values[n], look.values[n]) for n in stuck}
        fitted = tuple(n for n in look.free if n in smooth or n in thresholds)
        return replace(look, free=fitted, thresholds=thresholds, idle=fitted != look.free)

    def _model(self, effects, forms, start) -> tuple[Model, dict[str, float]]:
        model = plant(effects, self.library)
        return model, model.values({k: v for k, v in start.items() if k in model.values()} | dict(forms))

    def _problem(self, model, values, smooth, slow_first) -> Problem:
        """The problem with the base parameters and those in `smooth` free, at a regular start."""
        names = [*self.names, *smooth]
        values = regular_start(model, values, names)
        return Problem(model, self.experiments, values, names, self.known(model, values, names), slow_first)

    def again(self, fit: Fit) -> Fit:
        """Refit, on these experiments, a fit of other experiments or with another noise model."""
        found = self.fit(fit.effects, fit.forms, fit.free, fit.values, fit.slow_first, thorough=False)
        return replace(found, idle=fit.idle or found.idle)

    def known(self, model: Model, values: Mapping[str, float], names: Sequence[str]) -> Prior | None:
        """Prior of the free parameters of a model, widened by the factor. The widest has no influence, with any effects."""
        prior = self.knowledge and self.knowledge(model, values, self.names if self.factor == WIDEST else names)
        return prior and prior.loosened(self.factor)

    def _unreached(self, model, values, name) -> bool:
        """Whether the simulated records are the same to the bit with the parameter switched off."""
        simulator, off = Simulator(model), {**values, name: self._off[name]}
        records = [e.record for e in self.experiments]
        runs = [[simulator.simulate(v, *r.run) for v in (values, off)] for r in records]
        return all(np.array_equal(*pair) for pair in runs)

    def _kinds(self, model, values, free) -> tuple[list[str], list[str]]:
        """Free parameters (with sensitivities; to be scanned, because the response is piecewise constant in them or jumps). The
        others have no influence, and keep their values."""
        if not free:
            return [], []
        simulator = Simulator(model, [*self.names, *free])  # if all are smooth, the fit uses the same one
        moved = np.zeros(len(free), bool)
        for e in self.experiments:
            for _, _, tangents in simulator.pieces(values, *e.record.run):
                moved |= tangents[:, e.compared, len(self.names) :].any(axis=(0, 1))
                if moved.all():
                    break
        jumping = {e.full(p) for e in model.effects for p in e.rounds.values()}
        smooth = [n for n, does in zip(free, moved, strict=True) if does and n not in jumping]
        scanned = {n for n, does in zip(free, moved, strict=True) if does and n in jumping}
        scanned |= {
            n for n in free if not {n} & {*smooth, *jumping} and piecewise_constant(simulator, self.experiments, values, n)
        }
        return smooth, [n for n in free if n in scanned]


def _fit(effects, forms, free, slow_first, problem: Problem, solution: Solution, thresholds, idle: bool) -> Fit:
    values, score = problem.values | problem.coordinates.values(solution.value), problem.score_of(solution.residual)
    return Fit(tuple(effects), dict(forms), free, slow_first, values, problem, solution.slim(), score, thresholds, idle)


def _corners(record: Record) -> Iterable[dict[str, float]]:
    """Minimum and maximum of each command of a record, by name, in all combinations."""
    spans = {u: (float(record[u].min()), float(record[u].max())) for u in (OMEGA_REF.name, BETA_REF.name) if u in record}
    return (dict(zip(spans, at, strict=True)) for at in product(*spans.values()))


def _settled(model: Model, values: Mapping[str, float], at: Mapping[str, float]) -> float:
    """Settled thrust [N] at given commands."""
    return float(
        start(model, NUMBERS, {u.name: u.start for u in model.inputs} | model.measured_inputs | at, values)[0]["thrust"]
    )
