"""Which effects are missing: add the best that stands, refit all, repeat; then drop what the others have made superfluous."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from identification.diagnose.crossval import HeldOut, cross_validated
from identification.diagnose.following import falls_in_bands
from identification.diagnose.judgement import (
    ACCURACY,
    MOST,
    RIVALS,
    SMALLEST,
    STRONG,
    Judgement,
    Smallest,
    left_by_forms,
    needed_fall,
    refusals,
)
from identification.diagnose.lack import Lack, lack_of_fit
from identification.diagnose.search.candidates import Candidate
from identification.diagnose.search.fits import Fit, Searcher
from identification.diagnose.search.refits import (
    REACH,
    CandidateFit,
    added,
    deeper,
    evidence_over,
    first_round,
    key,
    refitted,
    screened,
)
from identification.fit.uncertainty import NORMAL_95
from vpp_fmu.kernel.types import Effect
from vpp_fmu.record import Record

MORE_ROUNDS = 2
"""How often more candidates are refitted where none of the first ones stands and something is lacking."""


@dataclass
class Selection:
    """What a search found: the base, the final fit, its judgements by effect, and all that was tried, round by round.

    `refused`: what was looked into and does not stand. `rivals`: for each effect, others that these data do not tell from it,
    by name the set with that one in its place.
    """

    base: Fit
    final: Fit
    judgements: dict[str, Judgement] = field(default_factory=dict)
    rounds: list[list[CandidateFit]] = field(default_factory=list)
    refused: dict[str, Judgement] = field(default_factory=dict)
    rivals: dict[str, dict[str, Fit]] = field(default_factory=dict)

    @property
    def family(self) -> dict[str, list[str]]:
        """For each effect, the names of those that these data do not tell from it."""
        return {effect: sorted(fits) for effect, fits in self.rivals.items()}


class Judge:
    """Judges effects against the set without them, which may be the `base`.

    `smallest`: least sizes of interest; where none is named, SMALLEST of the noise's slow power in the thrust or ACCURACY of
    the largest thrust, if that is more, and the sensor's uncertainty in the speed. `runs`: of steps, which no fit of a
    diagnosis takes.
    """

    def __init__(self, searcher: Searcher, base: Fit, smallest: Smallest, runs: Sequence[Record]):
        self.searcher, self.base, self.smallest = searcher, base, smallest
        self.runs = [r for r in runs if np.isfinite(r["thrust"]).any()]
        self._held_out: dict[int, tuple[Fit, HeldOut]] = {}

    def held_out(self, fit: Fit) -> HeldOut:
        """Cross-validation of a fit, once for each."""
        if id(fit) not in self._held_out:
            self._held_out[id(fit)] = fit, cross_validated(fit)  # the fit is kept: its id must not be another's
        return self._held_out[id(fit)][1]

    def on_runs(self, fit: Fit) -> np.ndarray:
        """(runs,) mean square of the thrust's error in each of the step runs, N^2."""
        simulator = fit.problem.simulator
        shown = [simulator.simulate(fit.values, *r.run)[:, 0] for r in self.runs]
        return np.array([np.nanmean((y - r["thrust"]) ** 2) for y, r in zip(shown, self.runs, strict=True)])

    def __call__(self, effect: str, with_it: Fit, without: Fit) -> Judgement:
        """The judgement of one effect of a set."""
        falls, by_forms = self.likelihood_gain(with_it, without)
        fall, more = sum(falls.values()), max(1, len(with_it.free) - len(without.free))
        evidence = evidence_over(with_it, without) - (0.5 * (without.deviance - with_it.deviance) - fall)
        needed = needed_fall(more, self.searcher.points) + by_forms
        gain = self.held_out(with_it).gain(self.held_out(without))
        declared = next(e for e in with_it.problem.model.effects if e.name == effect)
        size, least, material = self._size(with_it, without, declared.common)
        carries_over = bool(declared.common) or self._carries_over(with_it, without)
        refused = refusals(fall, needed, evidence, gain, more, material, carries_over)
        if not refused and (unsure := _may_be_off(with_it, declared)):
            refused.append(unsure)
        return Judgement(effect, float(fall), needed, float(evidence), gain, size, least, tuple(refused))

    def likelihood_gain(self, with_it: Fit, without: Fit) -> tuple[dict[str, float], float]:
        """(log-likelihood that a set gains over the one without an effect, by channel; how much of it may come from errors of
        the forms of the others). In each band it counts by the noise that is there."""
        falls, explained, by_forms = with_it.score.fall(without.score), without.score.fall(self.base.score), 0.0
        for channel in [c for c, fall in falls.items() if fall > 0.0]:
            (known, gained), level = falls_in_bands((self.base, without, with_it), channel)
            gained = falls[channel] * gained / (gained.sum() or 1.0) / level
            falls[channel] = float(np.clip(gained.sum(), 0.0, falls[channel]))
            if explained[channel] > 0.0:
                by_forms += left_by_forms(gained, explained[channel] * known / (known.sum() or 1.0) / level)
        return falls, by_forms

    def lack(self, fit: Fit) -> Lack:
        """The tests of lack of fit."""
        return lack_of_fit(fit, self.least(), self.least_speed())

    def least(self) -> float:
        """N: the least size of interest of the thrust below 10 Hz."""
        if self.smallest.thrust is not None:
            return self.smallest.thrust
        experiments = self.searcher.experiments
        largest = max(float(np.nanmax(np.abs(r.record["thrust"]))) for e in experiments for r in e.records)
        return max(float(np.sqrt(SMALLEST * max(e.noise.slow for e in experiments))), ACCURACY * largest)

    def least_speed(self) -> float:
        """rpm: the least size of interest of the speed; infinite where none was measured."""
        if self.smallest.speed is not None:
            return self.smallest.speed
        known = [np.median(t.std) for e in self.searcher.experiments for t in e.tachometers if len(t)]
        return float(max(known, default=np.inf))

    def _carries_over(self, with_it: Fit, without: Fit) -> bool:
        """Whether the mean square error that an effect removes from the folds left out reaches the least size, in either
        channel."""
        now, was = self.held_out(with_it), self.held_out(without)
        if was.rmse_thrust**2 - now.rmse_thrust**2 >= self.least() ** 2:
            return True
        return was.rmse_omega is not None and was.rmse_omega**2 - now.rmse_omega**2 >= self.least_speed() ** 2

    def matters(self, effect: str, fit: Fit) -> bool:
        """Whether an effect of a fit reaches the least size of interest where the rest of the fit stays as it is."""
        declared = next(e for e in fit.problem.model.effects if e.name == effect)
        off = {declared.full(name): value for name, value in (declared.off or {}).items()}
        return self._size(fit, replace(fit, values={**fit.values, **off}), declared.common)[-1]

    def _size(self, with_it: Fit, without: Fit, common: float) -> tuple[float, float, bool]:
        """(what the effect changes of the thrust [N], rms; the least size; whether it, or what it does to speed, reaches
        that)."""
        thrust, rows, speed = [], [], []
        for e in self.searcher.experiments:
            shown = [_outputs(fit, e) for fit in (with_it, without)]
            change = shown[0] - shown[1]
            rows.append(change[:, 0])
            thrust.append(e.slow_thrust(change[:, 0]))
            if len(e.omega_time):
                speed.append(np.concatenate([t.shows(change[:, 1]) for t in e.tachometers]))
        size, least = _rms(thrust), self.least()
        if common:
            floor = max(e.noise.floor for e in self.searcher.experiments)
            return _rms(rows), float(np.sqrt(common)) * floor, _rms(rows) ** 2 >= common * floor**2
        return size, least, size >= least or (bool(speed) and _rms(speed) >= self.least_speed())


def _may_be_off(fit: Fit, effect: Effect) -> str:
    """Why an effect of a fit may as well not be there, in words: the 95 % interval of each of its sizes holds the value that
    switches it off. "" where one does not."""
    sizes = {effect.full(name): off for name, off in (effect.off or {}).items()}
    sizes = {name: off for name, off in sizes.items() if name in fit.free}
    std, told = fit.std(), []
    if not sizes or any(std[name] is None for name in sizes):  # only a combination of sizes is known, and it is not "off"
        return ""
    for name, off in sizes.items():
        half = NORMAL_95 * std[name]
        low, high = fit.thresholds.get(name, (fit.values[name] - half, fit.values[name] + half))
        if not low <= off <= high or half == 0.0:
            return ""
        told.append(f"{name} {fit.values[name]:.3g} (95 %: {low:.3g} to {high:.3g})")
    return f"its size may be none: {', '.join(told)}"


def _outputs(fit: Fit, experiment) -> np.ndarray:
    return fit.problem.simulator.simulate(fit.values, *experiment.record.run)


def _rms(parts: Sequence[np.ndarray]) -> float:
    return float(np.sqrt(np.nanmean(np.concatenate(parts) ** 2)))


def select(
    judge: Judge,
    options: Iterable[Candidate],
    clearer: Callable[[Judge, Fit], Judge | None],
    thorough: bool,
    pool,
    stage: Callable[[str], None] = lambda text: None,
) -> tuple[Judge, Selection]:
    """Search up to MOST effects: (judge in the end, selection).

    `thorough`: where something is still missing, more is refitted. `clearer(judge, fit)`: a judge on the noise that a fit
    leaves, where that is clearer than the judge's own: all further ones judge by it. Where one effect does not explain all,
    the search is begun anew with the one that was the next best by itself, if it was nearly as good, and the better set stays.
    The result does not depend on the number of workers in `pool`.
    """
    forward = partial(_forward, options=list(options), clearer=clearer, thorough=thorough, pool=pool, stage=stage)
    judge, found = forward(judge, Selection(judge.base, judge.base))
    if len(found.final.effects) > 1 and (begin := _next_best(judge, found)):
        first, own = begin
        again, other = forward(judge, replace(found, final=first, judgements=own, rounds=found.rounds[:1], refused={}))
        known = found.final if again is judge else again.searcher.again(found.final)
        if evidence_over(other.final, known) > 0.0:
            judge, found = again, other
    stage("judge")
    searcher = judge.searcher
    _narrow(searcher, found, judge)
    found.refused = {n: j for n, j in found.refused.items() if n not in found.final.effects}
    found.rivals = {effect: _rivals(searcher, found, effect, judge, pool) for effect in found.final.effects}
    return judge, found


def _forward(judge: Judge, found: Selection, options, clearer, thorough, pool, stage) -> tuple[Judge, Selection]:
    """(judge in the end, selection) of adding effects to what was `found`, one after the other."""
    visited = set()
    while len(found.final.effects) < MOST and key(found.final) not in visited:
        visited.add(key(found.final))
        stage(f"try {len(options)} candidates" + "".join(f" + {name}" for name in found.final.effects))
        tried = first_round(judge.searcher, found.final, options, pool)
        best = _first_that_stands(judge.searcher, found, tried, judge)
        for _ in range(MORE_ROUNDS if best is None and thorough and judge.lack(found.final).found else 0):
            further = deeper(judge.searcher, found.final, tried, pool)
            if further == tried:
                break
            tried, best = further, _first_that_stands(judge.searcher, found, further, judge)
            if best is not None:
                break
        found.rounds.append(tried)
        if best is None:
            break
        if again := clearer(judge, best):
            judge, best = again, again.searcher.again(best)
            found.base = judge.base
        found.final, found.judgements = _pruned(judge.searcher, judge.base, best, judge)
    return judge, found


def _next_best(judge: Judge, found: Selection) -> tuple[Fit, dict[str, Judgement]] | None:
    """(fit, judgement) of the effect that stands by itself, had most evidence in the first round of those that are not in the
    set, nor a special case or a wider form of one there, and was within RIVALS of the best: alone, one effect may look better
    than either of the two that are there."""
    ranked = _ranked([t for t in found.rounds[0] if t.fit is not None])
    theirs = {e.name: e.contains for e in found.final.problem.model.effects if e.name in found.final.effects}
    for t in (t for t in ranked if t.evidence > ranked[0].evidence - RIVALS):
        name = t.candidate.name
        if any(name == n or name in contained or n in t.candidate.effect.contains for n, contained in theirs.items()):
            continue
        fit = judge.searcher.again(_bounded(judge.searcher, judge.base, t) if t.fit.at_bound else t.fit)
        judged = judge(name, fit, judge.base)
        if not judged.refused:
            return fit, {name: judged}
    return None


def alternatives(searcher: Searcher, found: Selection, judge: Judge) -> Iterator[tuple[str, str, Selection]]:
    """(effect, its rival, the selection with the rival in its place), the most evidence first."""
    pairs = [(effect, name) for effect, fits in found.rivals.items() for name in fits]
    for effect, name in sorted(pairs, key=lambda pair: found.rivals[pair[0]][pair[1]].bic()):
        fit = found.rivals[effect][name]
        judgements = {n: judge(n, fit, without(searcher, found.base, fit, n)) for n in fit.effects}
        rivals = {e: fits for e, fits in found.rivals.items() if e != effect} | {name: {}}
        yield effect, name, replace(found, final=fit, judgements=judgements, rivals=rivals)


Tried = list[tuple[str, Fit, Callable[[], Judgement]]]
"""(name, fit, its judgement when asked for) of candidates."""


def nearest(judge: Judge, found: Selection, options: Sequence[Candidate], pool) -> Tried:
    """The candidates beside the final set, the most evidence first.

    They are those of the last round where that is of this set; where none was refitted, the most promising one is.
    """
    searcher, final = judge.searcher, found.final
    last = found.rounds[-1] if found.rounds else []
    if not last or key(final)[0] != tuple(sorted(last[0].beside)):
        last = first_round(searcher, final, options, pool)
    refits = [t for t in last if t.fit is not None]
    if last and not refits:
        candidate, at = screened(searcher, final, [t.candidate for t in last], pool)[0]
        fit = refitted(searcher, final, candidate, at)
        refits = [CandidateFit(candidate, final.effects, at.fall, fit, evidence_over(fit, final))]
    fits = []
    for t in _ranked(refits):
        fit = _bounded(searcher, final, t) if t.fit.at_bound else t.fit
        fits.append((t.candidate.name, fit, partial(judge, t.candidate.name, fit, final)))
    return fits


def _first_that_stands(searcher: Searcher, found: Selection, tried: Sequence[CandidateFit], judge: Judge) -> Fit | None:
    """The candidate of most evidence that stands beside what is there already."""
    for t in _ranked([t for t in tried if t.fit is not None]):
        if t.evidence <= STRONG:
            return None
        fit = _bounded(searcher, found.final, t) if t.fit.at_bound else t.fit
        judged = judge(t.candidate.name, fit, found.final)
        if not judged.refused:
            return fit
        found.refused.setdefault(t.candidate.name, judged)
    return None


SAME = 1.0
"""Evidence by which an effect must be ahead of one that it contains: less is rounding, and the simpler name is the better
one."""


def _ranked(refits: Sequence[CandidateFit]) -> list[CandidateFit]:
    """By evidence; a special case goes before the wider effect that fits as well."""
    ranked = sorted(refits, key=lambda t: -t.evidence)
    for t in list(ranked):
        wider = [k for k, w in enumerate(ranked) if t.candidate.name in w.candidate.effect.contains]
        ahead = [k for k in wider if k < ranked.index(t) and ranked[k].evidence < t.evidence + SAME]
        if ahead:
            ranked.remove(t)
            ranked.insert(ahead[0], t)
    return ranked


def _bounded(searcher: Searcher, beside: Fit, tried: CandidateFit) -> Fit:
    """The refit without the parameters that ran onto a bound, held there: a bound is no reason to refuse an effect."""
    fit = tried.fit
    own = {tried.candidate.effect.full(p.name) for p in tried.candidate.effect.parameters}
    free = [n for n in fit.free if n not in fit.at_bound or n not in own]
    if len(free) == len(beside.free):
        return fit
    return replace(searcher.fit(fit.effects, fit.forms, free, fit.values, fit.slow_first, thorough=False), idle=fit.idle)


def without(searcher: Searcher, base: Fit, fit: Fit, effect: str) -> Fit:
    """The set of a fit without one effect, refitted."""
    rest = [name for name in fit.effects if name != effect]
    if not rest:
        return base
    forms = {n: v for n, v in fit.forms.items() if not n.startswith(f"{effect}.")}
    free = [n for n in fit.free if not n.startswith(f"{effect}.")]
    return searcher.fit(rest, forms, free, fit.values, fit.slow_first, thorough=False)


def _pruned(searcher: Searcher, base: Fit, fit: Fit, judge: Judge) -> tuple[Fit, dict[str, Judgement]]:
    """The fit less every effect that does not stand in the presence of the others, the weakest first; their judgements."""
    while True:
        rests = {effect: without(searcher, base, fit, effect) for effect in fit.effects}
        judged = {effect: judge(effect, fit, rest) for effect, rest in rests.items()}
        fallen = [effect for effect, j in judged.items() if j.evidence <= STRONG or j.fall < j.needed]
        if not fallen:
            return fit, judged
        fit = rests[min(fallen, key=lambda effect: judged[effect].evidence)]


def _narrow(searcher: Searcher, found: Selection, judge: Judge) -> None:
    """A special case takes the place of an effect that contains it where, beside the rest of the set, it fits as well: what
    made the wider one the better one may have been what was not there yet."""
    for effect in found.final.effects:
        wide = next(e for e in found.final.problem.model.effects if e.name == effect)
        rest = without(searcher, found.base, found.final, effect)
        for tried in _near(found, effect):
            if tried.candidate.name not in wide.contains:
                continue
            other = _in_place(searcher, rest, tried)
            if evidence_over(other, found.final) > -SAME and not judge(tried.candidate.name, other, rest).refused:
                judgements = {n: judge(n, other, without(searcher, found.base, other, n)) for n in other.effects}
                found.final, found.judgements = other, judgements
                break


def _in_place(searcher: Searcher, rest: Fit, tried: CandidateFit) -> Fit:
    """A candidate of another round beside the rest of a set, refitted."""
    if not rest.effects and not tried.beside and tried.fit.problem.experiments == searcher.experiments:
        return tried.fit
    start = {**rest.values, **{n: tried.fit.values[n] for n in tried.candidate.free}}
    return added(searcher, rest, tried.candidate, start, tried.fit.slow_first, thorough=False)


def _rivals(searcher: Searcher, found: Selection, effect: str, judge: Judge, pool) -> dict[str, Fit]:
    """Other effects that, in the place of one, have evidence within STRONG of its own, refitted beside the rest of the set.

    An effect that contains it fits as well always. It is a rival where the records leave open how large what it adds is (a
    speed that was limited at one load: does the limit fall with the load?), else only where that makes it the better one.
    """
    final, stand = found.final, {}
    rest = without(searcher, found.base, final, effect)
    for candidate, refit in _near_in_place(searcher, found, effect, rest, pool):
        wider, other = effect in candidate.effect.contains, refit
        if wider and (whole := _all_on(searcher, candidate, refit)).leaves_open(candidate.effect):
            other, behind = whole, 0.5 * (whole.deviance - final.deviance)  # the BIC charges for what no record tells
        else:
            behind = np.inf if wider and final.deviance - refit.deviance < 2.0 * STRONG else evidence_over(final, refit)
        if not refit.idle and behind <= STRONG and not judge(candidate.name, other, rest).refused:
            stand[candidate.name] = min(stand.get(candidate.name, other), other, key=Fit.bic)
    return stand


def _all_on(searcher: Searcher, candidate: Candidate, fit: Fit) -> Fit:
    """The fit with every size of its last effect on: one that told too little had been left off."""
    off = [n for n in candidate.sizes if n not in fit.free]
    start = fit.values | {n: candidate.probe[n] for n in off}
    return searcher.fit(fit.effects, fit.forms, [*fit.free, *off], start, fit.slow_first, thorough=False) if off else fit


def _near_in_place(searcher: Searcher, found: Selection, effect: str, rest: Fit, pool) -> list[tuple[Candidate, Fit]]:
    """What came near an effect, refitted in its place; of what comes near there, all forms: another one may fit as well."""
    near = _near(found, effect)
    fits = list(zip([t.candidate for t in near], pool.map(lambda t: _in_place(searcher, rest, t), near), strict=True))
    enough = REACH * evidence_over(found.final, rest)
    names = {candidate.name for candidate, fit in fits if evidence_over(fit, rest) >= enough}
    tried = {candidate.label for candidate, _ in fits}
    every = {t.candidate.label: t.candidate for round_ in found.rounds for t in round_ if t.candidate.name in names}
    further = [candidate for label, candidate in every.items() if label not in tried]
    seen = screened(searcher, rest, further, pool)
    again = pool.map(lambda pair: refitted(searcher, rest, *pair), seen)
    return fits + list(zip([c for c, _ in seen], again, strict=True))


def _near(found: Selection, effect: str) -> list[CandidateFit]:
    """Refitted candidates of the round in which an effect came in, the last that tried it, whose evidence came near the best
    there."""
    for tried in reversed(found.rounds):
        refits = [t for t in tried if t.fit is not None]
        mine = [t.evidence for t in refits if t.candidate.name == effect]
        if mine:
            rivals = [t for t in refits if t.candidate.name not in found.final.effects]
            return [t for t in rivals if t.evidence > max(mine) - _slack(found, effect)]
    return []


def _slack(found: Selection, effect: str) -> float:
    """How far behind a rival may have been when other effects were not there yet."""
    return 2.0 * STRONG if len(found.final.effects) == 1 else 0.2 * found.judgements[effect].evidence + 2.0 * STRONG
