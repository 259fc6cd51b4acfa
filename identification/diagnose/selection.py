"""Forward selection of effects, then backward elimination."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from identification.diagnose.acceptance import Judge
from identification.diagnose.effort import Effort
from identification.diagnose.judgement import MAJORITY, MIN_EVIDENCE, MOST, STRONG, Judgement
from identification.diagnose.search.candidates import Candidate
from identification.diagnose.search.fits import Fit, Searcher
from identification.diagnose.search.refits import CandidateFit, added, evidence_over, key, search_round


@dataclass
class Selection:
    """Result of a search: the base, the final fit, its judgements by effect, and all candidates, round by round.

    `whole`: the final fit with its nuisances, which are significant but smaller than the minimum size; they are not named, and
    leave no lack of fit. `refused`: judgements of rejected candidates. `rivals`: for each effect, the fits with an
    indistinguishable effect in its place, by the name of that effect.
    """

    base: Fit
    final: Fit
    whole: Fit
    judgements: dict[str, Judgement] = field(default_factory=dict)
    rounds: list[list[CandidateFit]] = field(default_factory=list)
    refused: dict[str, Judgement] = field(default_factory=dict)
    rivals: dict[str, dict[str, Fit]] = field(default_factory=dict)

    @property
    def family(self) -> dict[str, list[str]]:
        """For each effect, the names of those that the data do not distinguish from it."""
        return {effect: sorted(fits) for effect, fits in self.rivals.items()}


def select(
    judge: Judge,
    options: Sequence[Candidate],
    clearer: Callable[[Judge, Fit], Judge | None],
    effort: Effort,
    pool,
    words: str = "",
) -> tuple[Judge, Selection]:
    """Search up to MOST effects: (final judge, selection).

    `clearer(judge, fit)`: a judge with a noise estimate from the residual of a fit, if that is lower; it then replaces the
    judge. The first round is completed for any budget of `effort`. Without a budget the result does not depend on the number
    of workers in `pool`. `words`: of what, for progress.
    """
    found, nuisances = Selection(judge.base, judge.base, judge.base), set()

    def accepted(beside: Fit) -> tuple[Fit | None, Fit | None, Fit | None]:
        effort.stage(f"try {len(options)} candidates{words}{_beside(beside)}")
        found.rounds.append(search_round(judge.searcher, beside, options, pool, effort.progress))
        return _first_accepted(found, beside, judge)

    for count in range(MOST):
        if count and not effort.allows(f"a further effect{words}{_beside(found.whole)}"):
            break
        best, small, half = accepted(found.whole)
        if best is None and half and effort.allows(f"a further effect{words}{_beside(half)}"):
            best = accepted(half)[0]
        if best is None and small and judge.lack(found.whole).significant and not judge.lack(small).significant:
            nuisances.add(small.effects[-1])
            best = small
        if best is None:
            break
        best = judge.searcher.again(best) if best.thresholds else best
        if again := clearer(judge, best):
            judge, best = again, again.searcher.again(best)
            found.base = judge.base
        found.whole, found.judgements = _pruned(judge, best, nuisances)
        while len(found.whole.effects) > 1 and _exchanged(found, judge, nuisances, pool):
            pass
        if any(judge.within_sensor(judged) for judged in found.judgements.values()):
            break  # a further one would correct the model of the sensor
    effort.stage(f"judge{words}")
    while _exchanged(found, judge, nuisances, pool):
        pass
    found.final = found.whole
    for name in nuisances & set(found.whole.effects):
        found.final = without(judge.searcher, judge.base, found.final, name)
    found.refused = {n: j for n, j in found.refused.items() if n not in found.final.effects}
    found.judgements = {n: j for n, j in found.judgements.items() if n in found.final.effects}
    found.rivals = {effect: _rivals(found, effect, judge, pool) for effect in found.final.effects}
    return judge, found


def _beside(fit: Fit) -> str:
    return "".join(f" + {name}" for name in fit.effects)


def _first_accepted(found: Selection, beside: Fit, judge: Judge) -> tuple[Fit | None, Fit | None, Fit | None]:
    """(the accepted candidate of most evidence `beside` a fit, None without one; the best one that is only too small; the best
    one that only explains too little of the lack of fit), of the last round.

    None with less than the share STRONG of the evidence of a refused one is accepted: it would stand in for that. A further
    effect must explain most of the lack of fit that is left: a chain of small gains corrects a wrong law. Of two of one size
    neither does; so one may be tried beside the effects found so far and a first one that explains too little. Both together
    must explain as much as two effects would that each explain most of what is left."""
    strongest, small, half = 0.0, None, None
    before = judge.lack(found.whole)
    needed = before.missing * MAJORITY ** (1 + len(beside.effects) - len(found.whole.effects))
    for t in _ranked([t for t in found.rounds[-1] if t.fit is not None]):
        if t.evidence <= max(MIN_EVIDENCE, STRONG * strongest):
            break
        fit = _bounded(judge.searcher, beside, t) if t.fit.at_bound else t.fit
        judged = judge(t.candidate.name, fit, beside)
        if not judged.refused and found.judgements:
            left = judge.lack(fit)
            if left.significant and left.missing > needed:
                removed = 1.0 - left.missing / before.missing if before.missing else 0.0
                least = f"the minimum is {100.0 * (1.0 - needed / before.missing) if before.missing else 0.0:.0f} %"
                why = f"it removes {100.0 * removed:.0f} % of the lack of fit that remains, {least}"
                judged, half = replace(judged, refused=(why,)), half or fit
        if not judged.refused:
            return fit, small, half
        found.refused.setdefault(t.candidate.name, judged)
        if judged.small:
            small = small or fit
        else:
            strongest = max(strongest, t.evidence)
    return None, small, half


Tried = list[tuple[str, Fit, Callable[[], Judgement]]]
"""(name, fit, function that judges it) of candidates."""


def nearest(judge: Judge, found: Selection, options: Sequence[Candidate], effort: Effort, pool) -> Tried:
    """Candidates beside the final set, by decreasing evidence."""
    searcher, final = judge.searcher, found.whole
    beside = [tried for tried in found.rounds if tried and key(final)[0] == tuple(sorted(tried[0].beside))]
    last = beside[-1] if beside else []
    on_these = all(t.fit.problem.experiments == searcher.experiments for t in last if t.fit)  # not on those of another logger
    if not last or not on_these:
        if not effort.allows(f"a best guess beside {' + '.join(final.effects)}"):
            return []
        last = search_round(searcher, final, options, pool, effort.progress)
    fits = []
    for t in _ranked([t for t in last if t.fit is not None]):
        fit = _bounded(searcher, final, t) if t.fit.at_bound else t.fit
        fits.append((t.candidate.name, fit, partial(judge, t.candidate.name, fit, final)))
    return fits


SAME = 1.0
"""Nats by which an effect must exceed a special case of it: less is rounding, and the simpler effect is preferred."""


def _ranked(refits: Sequence[CandidateFit]) -> list[CandidateFit]:
    """By decreasing evidence; a special case precedes its generalisation if that fits no better."""
    ranked = sorted(refits, key=lambda t: -t.evidence)
    for t in list(ranked):
        wider = [k for k, w in enumerate(ranked) if t.candidate.name in w.candidate.effect.contains]
        ahead = [k for k in wider if k < ranked.index(t) and ranked[k].evidence < t.evidence + SAME]
        if ahead:
            ranked.remove(t)
            ranked.insert(ahead[0], t)
    return ranked


def _bounded(searcher: Searcher, beside: Fit, tried: CandidateFit) -> Fit:
    """The refit with parameters that reached a bound held there: a bound is no reason to reject an effect."""
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


def _pruned(judge: Judge, fit: Fit, nuisances: set[str]) -> tuple[Fit, dict[str, Judgement]]:
    """Backward elimination: drop rejected effects, the weakest first; (fit, judgements of the named others)."""
    while True:
        rests = {effect: without(judge.searcher, judge.base, fit, effect) for effect in fit.effects}
        judged = {effect: judge(effect, fit, rest) for effect, rest in rests.items()}
        weak = [
            n
            for n, j in judged.items()
            if j.evidence <= MIN_EVIDENCE or j.likelihood_gain < j.needed or not (j.material or n in nuisances)
        ]
        if not weak:
            return fit, {n: j for n, j in judged.items() if n not in nuisances}
        fit = rests[min(weak, key=lambda effect: judged[effect].evidence)]


def _exchanged(found: Selection, judge: Judge, nuisances: set[str], pool) -> bool:
    """Replace one effect by another one, or by another form of it, that fits better beside the rest of the set, or by a special
    case that fits as well. Return whether one was replaced. It may have been ahead only because other effects were missing."""
    searcher = judge.searcher
    for effect in found.judgements:
        contained = next(e.contains for e in found.whole.problem.model.effects if e.name == effect)
        rest = without(searcher, judge.base, found.whole, effect)
        near = _near(found, effect)
        fits = pool.map(lambda t, rest=rest: _in_place(searcher, rest, t), near)
        for tried, other in sorted(zip(near, fits, strict=True), key=lambda pair: pair[1].bic()):
            least = -SAME if tried.candidate.name in contained else SAME
            if evidence_over(other, found.whole) > least and not judge(tried.candidate.name, other, rest).refused:
                found.whole, found.judgements = _pruned(judge, other, nuisances)
                return True
    return False


def _in_place(searcher: Searcher, rest: Fit, tried: CandidateFit) -> Fit:
    """A candidate of another round beside the rest of a set, refitted."""
    if key(rest)[0] == tuple(sorted(tried.beside)) and tried.fit.problem.experiments == searcher.experiments:
        return tried.fit
    start = {**rest.values, **{n: tried.fit.values[n] for n in tried.candidate.free}}
    return added(searcher, rest, tried.candidate, start, tried.fit.slow_first, thorough=False)


def _rivals(found: Selection, effect: str, judge: Judge, pool) -> dict[str, Fit]:
    """Effects that, in the place of one, have evidence within MIN_EVIDENCE of it, refitted beside the rest of the set.

    A generalisation always fits as well. It is a rival only if the records do not identify its additional parameter (a limit
    reached at one load only does not show whether it depends on load), or if it fits better.
    """
    searcher, final, stand = judge.searcher, found.final, {}
    rest = without(searcher, judge.base, final, effect)
    near = [t for t in _near(found, effect) if t.candidate.name != effect]
    for t, refit in zip(near, pool.map(lambda t: _in_place(searcher, rest, t), near), strict=True):
        candidate, other = t.candidate, refit
        wider = effect in candidate.effect.contains
        if wider and (whole := _all_on(searcher, candidate, refit)).leaves_open(candidate.effect):
            other, behind = whole, 0.5 * (whole.deviance - final.deviance)  # without the penalty of unidentified parameters
        else:
            behind = np.inf if wider and final.deviance - refit.deviance < 2.0 * MIN_EVIDENCE else evidence_over(final, refit)
        if not refit.idle and behind <= MIN_EVIDENCE and not judge(candidate.name, other, rest).refused:
            stand[candidate.name] = min(stand.get(candidate.name, other), other, key=Fit.bic)
    return stand


def _all_on(searcher: Searcher, candidate: Candidate, fit: Fit) -> Fit:
    """The fit with every size of its last effect free: an unidentifiable one had been held at off."""
    off = [n for n in candidate.sizes if n not in fit.free]
    start = fit.values | {n: candidate.probe[n] for n in off}
    return searcher.fit(fit.effects, fit.forms, [*fit.free, *off], start, fit.slow_first, thorough=False) if off else fit


def _near(found: Selection, effect: str) -> list[CandidateFit]:
    """Refitted candidates of the last round that tried an effect, its other forms too, with evidence near its best there."""
    final = found.whole
    others = {name for name in final.effects if name != effect}
    for tried in reversed(found.rounds):
        refits = [t for t in tried if t.fit is not None]
        mine = [t.evidence for t in refits if t.candidate.name == effect]
        if mine:
            rivals = [t for t in refits if t.candidate.name not in others and not _is_in(final, t.candidate)]
            return [t for t in rivals if t.evidence > max(mine) - _slack(found, effect)]
    return []


def _is_in(fit: Fit, candidate: Candidate) -> bool:
    """Whether a fit has a candidate, in the same form."""
    own = {n: v for n, v in fit.forms.items() if n.startswith(f"{candidate.name}.")}
    return candidate.name in fit.effects and candidate.form == own


def _slack(found: Selection, effect: str) -> float:
    """Nats by which a rival may have been behind before the other effects were included."""
    return 2.0 * MIN_EVIDENCE if len(found.judgements) == 1 else 0.2 * found.judgements[effect].evidence + 2.0 * MIN_EVIDENCE
