"""Forward selection of effects, then backward elimination."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from identification.diagnose.acceptance import Judge
from identification.diagnose.effort import Effort
from identification.diagnose.judgement import (
    ALTERNATIVE_WINDOW,
    MIN_EVIDENCE,
    MOST,
    Judgement,
)
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

AGAIN = "a search from the second best effect"
"""Name of a step of the search."""

MORE_ROUNDS = 2
"""Further rounds of refits if no candidate is accepted and lack of fit remains."""


@dataclass
class Selection:
    """Result of a search: the base, the final fit, its judgements by effect, and all candidates, round by round.

    `refused`: judgements of rejected candidates. `rivals`: for each effect, the fits with an indistinguishable effect in its
    place, by the name of that effect.
    """

    base: Fit
    final: Fit
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
    options: Iterable[Candidate],
    clearer: Callable[[Judge, Fit], Judge | None],
    effort: Effort,
    pool,
) -> tuple[Judge, Selection]:
    """Search up to MOST effects: (final judge, selection).

    `clearer(judge, fit)`: a judge with a noise estimate from the residual of a fit, if that is lower; it then replaces the
    judge. If one effect does not explain all, the search starts once more from the second best single effect, if that was
    nearly as good; the better set is kept. The first round is completed for any budget of `effort`. Without a budget the result
    does not depend on the number of workers in `pool`.
    """
    forward = partial(_forward, options=list(options), clearer=clearer, effort=effort, pool=pool)
    judge, found = forward(judge, Selection(judge.base, judge.base))
    if len(found.final.effects) > 1 and (begin := _next_best(judge, found)) and effort.allows(AGAIN):
        first, own = begin
        again, other = forward(judge, replace(found, final=first, judgements=own, rounds=found.rounds[:1], refused={}))
        known = found.final if again is judge else again.searcher.again(found.final)
        if evidence_over(other.final, known) > 0.0:
            judge, found = again, other
    effort.stage("judge")
    searcher = judge.searcher
    while _exchanged(searcher, found, judge, pool):
        pass
    found.refused = {n: j for n, j in found.refused.items() if n not in found.final.effects}
    found.rivals = {effect: _rivals(searcher, found, effect, judge, pool) for effect in found.final.effects}
    return judge, found


def _forward(judge: Judge, found: Selection, options, clearer, effort, pool) -> tuple[Judge, Selection]:
    """(final judge, selection) after adding effects one by one to those `found`."""
    visited = set()
    while len(found.final.effects) < MOST and key(found.final) not in visited:
        beside = "".join(f" + {name}" for name in found.final.effects)
        if visited and not effort.allows(f"a further effect{beside}"):
            break
        visited.add(key(found.final))
        effort.stage(f"try {len(options)} candidates{beside}")
        tried = first_round(judge.searcher, found.final, options, pool, effort.progress)
        best = _first_accepted(judge.searcher, found, tried, judge)
        more = best is None and effort.thorough and judge.lack(found.final).significant
        for _ in range(MORE_ROUNDS if more else 0):
            if not effort.allows(f"less promising candidates{beside}"):
                break
            further = deeper(judge.searcher, found.final, tried, pool)
            if further == tried:
                break
            tried, best = further, _first_accepted(judge.searcher, found, further, judge)
            if best is not None:
                break
        found.rounds.append(tried)
        if best is None:
            break
        if again := clearer(judge, best):
            judge, best = again, again.searcher.again(best)
            found.base = judge.base
        found.final, found.judgements = _pruned(judge.searcher, judge.base, best, judge)
        while len(found.final.effects) > 1 and _exchanged(judge.searcher, found, judge, pool):
            pass
    return judge, found


def _next_best(judge: Judge, found: Selection) -> tuple[Fit, dict[str, Judgement]] | None:
    """(fit, judgement) of the best other effect of the first round that is accepted alone, within ALTERNATIVE_WINDOW of the
    best; None without one. Special cases and generalisations of the set's effects do not count. If two effects are present, a
    third may fit better than either alone."""
    ranked = _ranked([t for t in found.rounds[0] if t.fit is not None])
    theirs = {e.name: e.contains for e in found.final.problem.model.effects if e.name in found.final.effects}
    for t in (t for t in ranked if t.evidence > ranked[0].evidence - ALTERNATIVE_WINDOW):
        name = t.candidate.name
        if any(name == n or name in contained or n in t.candidate.effect.contains for n, contained in theirs.items()):
            continue
        fit = judge.searcher.again(_bounded(judge.searcher, judge.base, t) if t.fit.at_bound else t.fit)
        judged = judge(name, fit, judge.base)
        if not judged.refused:
            return fit, {name: judged}
    return None


def without_weakest(judge: Judge, found: Selection, refuted: str, pool) -> Selection:
    """The selection without its effect of least evidence, which was `refuted` for this reason."""
    searcher, judged = judge.searcher, found.judgements
    weakest = min(judged, key=lambda effect: judged[effect].evidence)
    final, judgements = _pruned(searcher, found.base, without(searcher, found.base, found.final, weakest), judge)
    refused = {**found.refused, weakest: replace(judged[weakest], refused=(refuted,))}
    fewer = replace(found, final=final, judgements=judgements, refused=refused)
    return replace(fewer, rivals={effect: _rivals(searcher, fewer, effect, judge, pool) for effect in final.effects})


def alternatives(searcher: Searcher, found: Selection, judge: Judge) -> Iterator[tuple[str, str, Selection]]:
    """(effect, its rival, the selection with the rival in its place), by decreasing evidence."""
    pairs = [(effect, name) for effect, fits in found.rivals.items() for name in fits]
    for effect, name in sorted(pairs, key=lambda pair: found.rivals[pair[0]][pair[1]].bic()):
        fit = found.rivals[effect][name]
        judgements = {n: judge(n, fit, without(searcher, found.base, fit, n)) for n in fit.effects}
        rivals = {e: fits for e, fits in found.rivals.items() if e != effect} | {name: {}}
        yield effect, name, replace(found, final=fit, judgements=judgements, rivals=rivals)


Tried = list[tuple[str, Fit, Callable[[], Judgement]]]
"""(name, fit, function that judges it) of candidates."""


def nearest(judge: Judge, found: Selection, options: Sequence[Candidate], effort: Effort, pool) -> Tried:
    """Candidates beside the final set, by decreasing evidence: those of the last round, or the most promising one, refitted."""
    searcher, final = judge.searcher, found.final
    last = found.rounds[-1] if found.rounds else []
    if not last or key(final)[0] != tuple(sorted(last[0].beside)):
        if not effort.allows(f"a best guess beside {' + '.join(final.effects)}"):
            return []
        last = first_round(searcher, final, options, pool, effort.progress)
    refits = [t for t in last if t.fit is not None]
    if last and not refits:
        candidate, at = screened(searcher, final, [t.candidate for t in last], pool)[0]
        fit = refitted(searcher, final, candidate, at)
        refits = [CandidateFit(candidate, final.effects, at.likelihood_gain, fit, evidence_over(fit, final))]
    fits = []
    for t in _ranked(refits):
        fit = _bounded(searcher, final, t) if t.fit.at_bound else t.fit
        fits.append((t.candidate.name, fit, partial(judge, t.candidate.name, fit, final)))
    return fits


def _first_accepted(searcher: Searcher, found: Selection, tried: Sequence[CandidateFit], judge: Judge) -> Fit | None:
    """The accepted candidate of most evidence beside the effects found so far; None without one."""
    for t in _ranked([t for t in tried if t.fit is not None]):
        if t.evidence <= MIN_EVIDENCE:
            return None
        fit = _bounded(searcher, found.final, t) if t.fit.at_bound else t.fit
        judged = judge(t.candidate.name, fit, found.final)
        if not judged.refused:
            return fit
        found.refused.setdefault(t.candidate.name, judged)
    return None


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


def _pruned(searcher: Searcher, base: Fit, fit: Fit, judge: Judge) -> tuple[Fit, dict[str, Judgement]]:
    """Backward elimination: drop rejected effects, the weakest first; (fit, judgements of the others)."""
    while True:
        rests = {effect: without(searcher, base, fit, effect) for effect in fit.effects}
        judged = {effect: judge(effect, fit, rest) for effect, rest in rests.items()}
        weak = [n for n, j in judged.items() if j.evidence <= MIN_EVIDENCE or j.likelihood_gain < j.needed or not j.material]
        if not weak:
            return fit, judged
        fit = rests[min(weak, key=lambda effect: judged[effect].evidence)]


def _exchanged(searcher: Searcher, found: Selection, judge: Judge, pool) -> bool:
    """Replace one effect by another one, or by another form of it, that fits better beside the rest of the set, or by a special
    case that fits as well. Return whether one was replaced. It may have been ahead only because other effects were missing."""
    for effect in found.final.effects:
        contained = next(e.contains for e in found.final.problem.model.effects if e.name == effect)
        rest = without(searcher, found.base, found.final, effect)
        near = _near(found, effect)
        fits = pool.map(lambda t, rest=rest: _in_place(searcher, rest, t), near)
        for tried, other in sorted(zip(near, fits, strict=True), key=lambda pair: pair[1].bic()):
            least = -SAME if tried.candidate.name in contained else SAME
            if evidence_over(other, found.final) > least and not judge(tried.candidate.name, other, rest).refused:
                found.final, found.judgements = _pruned(searcher, found.base, other, judge)
                return True
    return False


def _in_place(searcher: Searcher, rest: Fit, tried: CandidateFit) -> Fit:
    """A candidate of another round beside the rest of a set, refitted."""
    if not rest.effects and not tried.beside and tried.fit.problem.experiments == searcher.experiments:
        return tried.fit
    start = {**rest.values, **{n: tried.fit.values[n] for n in tried.candidate.free}}
    return added(searcher, rest, tried.candidate, start, tried.fit.slow_first, thorough=False)


def _rivals(searcher: Searcher, found: Selection, effect: str, judge: Judge, pool) -> dict[str, Fit]:
    """Effects that, in the place of one, have evidence within MIN_EVIDENCE of it, refitted beside the rest of the set.

    A generalisation always fits as well. It is a rival only if the records do not identify its additional parameter (a limit
    reached at one load only does not show whether it depends on load), or if it fits better.
    """
    final, stand = found.final, {}
    rest = without(searcher, found.base, final, effect)
    for candidate, refit in _near_in_place(searcher, found, effect, rest, pool):
        wider, other = effect in candidate.effect.contains, refit
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


def _near_in_place(searcher: Searcher, found: Selection, effect: str, rest: Fit, pool) -> list[tuple[Candidate, Fit]]:
    """Candidates whose evidence was near that of an effect, in all their forms, refitted in its place."""
    near = [t for t in _near(found, effect) if t.candidate.name != effect]
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
    """Refitted candidates of the last round that tried an effect, its other forms too, with evidence near its best there."""
    final = found.final
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
    return 2.0 * MIN_EVIDENCE if len(found.final.effects) == 1 else 0.2 * found.judgements[effect].evidence + 2.0 * MIN_EVIDENCE
