"""Learn a term of unknown form: its port, driver and shape, if the library does not explain the residual.

Screening ranks all terms by cross-validated gain. The best few are refitted with all parameters. Screening is repeated with the
base of the best refit. Terms are accepted or rejected by the rules for effects, and must exceed the gain that the best of all
comparisons reaches by chance.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.diagnose.acceptance import Judge
from identification.diagnose.crossval import HeldOut, by_thirds, p_no_decrease
from identification.diagnose.effort import Effort
from identification.diagnose.judgement import (
    ALPHA,
    ALPHA_HELD_OUT,
    ALTERNATIVE_WINDOW,
    FORM,
    MAJORITY,
    MIN_EVIDENCE,
    Judgement,
    Smallest,
)
from identification.diagnose.learned.laws import laws_of
from identification.diagnose.learned.refit import Term, refitted
from identification.diagnose.learned.screening import Lead, forms_of, screened
from identification.diagnose.search.fits import Fit, Searcher
from identification.diagnose.search.refits import evidence_over
from vpp_fmu.kernel.learned import PORTS
from vpp_fmu.kernel.scales import Scales
from vpp_fmu.record import Record

NAME = "learned"
"""Name of the effect."""

FIRST, AGAIN = 5, 3
"""Leads refitted after the first screening and after each further one."""

ROUNDS = 3
"""Maximum number of further screenings, each with the base of the best term, while lack of fit remains and terms improve."""

UNLAGGED = 2
"""Number of next best terms that, like the best, are also refitted without their lag."""

FAMILY = 2
"""Maximum number of leads of one family of ports that are refitted in a round."""


@dataclass(frozen=True, eq=False)
class Learned:
    """A learned term. `term`: the term in the model; `curve`: the same as a table, if a law replaces it; `beside`: the fit
    without it; `rivals`: other terms with evidence within ALTERNATIVE_WINDOW of it; `laws`: (name, evidence over the table) of
    the refitted laws. `stage_fit`: the term in the channels in which it was learned; `term` may have it in all of them."""

    term: Term
    curve: Term
    judgement: Judgement
    beside: Fit
    rivals: tuple[Term, ...]
    laws: tuple[tuple[str, float], ...]
    stage_fit: Fit

    @property
    def elsewhere(self) -> tuple[Term, ...]:
        """The rivals of another port or driver; a quantity and its share are one port."""
        return tuple(term for term in self.rivals if _place(term) != _place(self.term))


@dataclass(frozen=True, eq=False)
class Attempt:
    """Result of learning. `tried`: the refitted terms with their judgements; `comparisons`: number of screened terms;
    `learned`: None if no term is accepted; `refuted`: reason why validation refutes the accepted term."""

    tried: tuple[tuple[Term, Judgement], ...] = ()
    comparisons: int = 0
    learned: Learned | None = None
    refuted: str = ""

    def joined(self, fit: Fit) -> "Attempt":
        """The same with its term in a fit of all channels."""
        return replace(self, learned=replace(self.learned, term=replace(self.learned.term, fit=fit)))

    def but_refuted(self, why: str) -> "Attempt":
        """The same with its term refuted."""
        curve = self.learned.curve
        tried = tuple((term, replace(j, refused=(why,)) if term is curve else j) for term, j in self.tried)
        return replace(self, tried=tried, learned=None, refuted=why)


def by_chance(comparisons: int) -> float:
    """Cross-validated log-likelihood gain that the best of `comparisons` reaches by chance, at the level ALPHA.

    Under the null hypothesis a predictive likelihood ratio has an expectation of at most 1. So it exceeds comparisons / ALPHA
    with a probability of at most ALPHA (Markov, Bonferroni).
    """
    return float(np.log(max(comparisons, 1) / ALPHA))


def learn(known: Judge, beside: Fit, scales: Scales, pool, effort: Effort) -> Attempt:
    """Learn a term beside a fit. `known`: the judge of effects; `scales`: of the rig. The first refits are completed for any
    budget of `effort`."""
    effort.stage("search for an effect outside the library")
    searcher = known.searcher
    leads = screened(beside, spread=pool.map)
    comparisons = len(leads)
    searcher.points = max(searcher.points, comparisons)
    judge = Carried(searcher, beside, known.smallest, known.runs)
    chosen = short_list(leads, (), FIRST)
    effort.stage(f"refit {len(chosen)} of {comparisons} terms")
    terms = _refitted(searcher, beside, chosen, scales, pool)
    if not terms:
        return Attempt((), comparisons)
    for _ in range(ROUNDS):
        best, *others = sorted(terms, key=lambda t: -judge.gain(t.fit, beside))
        if not judge.lack(best.fit).significant or not effort.allows("further terms of unknown form"):
            break
        base = {n: best.fit.values[n] for n in beside.problem.coordinates.names}
        again = short_list(screened(beside, base, pool.map), [t.lead for t in terms], AGAIN)
        simpler = [lead for t in (best, *others[:UNLAGGED]) for lead in unlagged(t, [*(u.lead for u in terms), *again])]
        effort.stage(f"refit {len(again)} more of {comparisons} terms")
        more = _refitted(searcher, beside, [*again, *variants(best, terms), *simpler], scales, pool, best.fit)
        terms += more
        if not more or best is max(terms, key=lambda t: judge.gain(t.fit, beside)):
            break
    judged = {t: judged_term(judge, t.fit, beside, comparisons) for t in terms}
    tried = tuple(sorted(judged.items(), key=lambda pair: -judge.gain(pair[0].fit, beside)))
    accepted = [(t, j) for t, j in tried if not j.refused]
    if not accepted:
        return Attempt(tried, comparisons)
    top = judge.gain(accepted[0][0].fit, beside)
    near = [(t, j) for t, j in accepted if judge.gain(t.fit, beside) > top - MIN_EVIDENCE]
    curve, judgement = min(near, key=lambda pair: len(pair[0].free))
    effort.stage("try simple laws")
    term, laws = laws_of(searcher, beside, curve, scales, pool)
    if term is not curve:
        by_law = judged_term(judge, term.fit, beside, comparisons)
        term, judgement = (curve, judgement) if by_law.refused else (term, by_law)
    rivals = [t for t, j in tried if t is not curve and j.evidence > judgement.evidence - ALTERNATIVE_WINDOW]
    return Attempt(tried, comparisons, Learned(term, curve, judgement, beside, tuple(rivals), laws, term.fit))


def better_than(known: Judge, rest: Fit, with_it: Fit, scales: Scales, pool) -> Term | None:
    """A learned term that fits better than an accepted effect, in its place and channel; None without one. The effect then
    stands in for one that the library lacks. `rest`, `with_it`: the fits without and with it.

    The term must exceed the effect by MIN_EVIDENCE, and by what the form of a right effect may leave. In a single record it may
    follow flicker noise: only what it gains beside that counts."""
    (name,) = set(with_it.effects) - set(rest.effects)
    effect = next(e for e in with_it.problem.model.effects if e.name == name)
    channel = "omega" if effect.in_speed and not effect.reading else "".join(effect.channels[:1])
    leads = short_list(screened(rest, spread=pool.map, channel=channel), (), AGAIN)
    terms = _refitted(known.searcher, rest, leads, scales, pool)
    best = max(terms, key=lambda t: evidence_over(t.fit, with_it), default=None)
    needed = MIN_EVIDENCE + FORM * max(evidence_over(with_it, rest), 0.0)
    return best if best and known.evidence(best.fit, with_it) > needed else None


def remains_beside(term: Term, searcher: Searcher, rest: Fit, with_it: Fit) -> bool:
    """Whether an effect keeps most of its evidence beside a learned term, which then explains something else. `rest`,
    `with_it`: the fits without and with the effect."""
    (name,) = set(with_it.effects) - set(rest.effects)
    free = [n for n in with_it.free if n.startswith(f"{name}.")]
    forms = {n: v for n, v in with_it.forms.items() if n.startswith(f"{name}.")}
    fit, own = term.fit, {n: with_it.values[n] for n in free}
    both = term.searcher(searcher).fit(
        [*fit.effects, name], fit.forms | forms, [*fit.free, *free], fit.values | own, fit.slow_first, thorough=False
    )
    return evidence_over(both, fit) > MAJORITY * evidence_over(with_it, rest)


def _place(term: Term) -> tuple[str, str]:
    return term.lead.port.removesuffix("_share"), term.lead.driver


def _own(name: str) -> bool:
    return name.startswith(f"{NAME}.")


class Carried(Judge):
    """The judge of terms: cross-validation uses interleaved folds and also whole thirds of the records."""

    def __init__(self, searcher: Searcher, beside: Fit, smallest: Smallest, runs: Sequence[Record]):
        super().__init__(searcher, beside, smallest, runs)
        self._by_thirds: dict[int, tuple[Fit, HeldOut]] = {}

    def carried(self, fit: Fit) -> HeldOut:
        """Cross-validation of a fit by thirds, cached. Only the parameters of the term are refitted on the other two thirds,
        which may not identify the base: this favours the fit without a term.
        """
        if id(fit) not in self._by_thirds:
            self._by_thirds[id(fit)] = fit, by_thirds(fit, _own)
        return self._by_thirds[id(fit)][1]

    def gain(self, fit: Fit, beside: Fit) -> float:
        """Held-out log-likelihood ratio of two fits: the smallest of folds and thirds, of both channels and of the thrust
        alone."""
        gains = [one(fit).gain(one(beside)) for one in (self.held_out, self.carried)]
        return min(min(sum(g.values()), g.get("thrust", np.inf)) for g in gains)

    def p_no_decrease(self, fit: Fit, beside: Fit) -> float:
        """p-value of the hypothesis that the held-out error does not decrease: of the thrust on left-out thirds, and in each
        step response, which no fit of a diagnosis uses; of the speed, where it alone is fitted."""
        old, new, experiments = self.carried(beside), self.carried(fit), fit.problem.experiments
        if "thrust" not in experiments[0].channels:
            times = [np.concatenate([t.times for t in e.tachometers]) for e in experiments if e.tachometers]
            pairs = [pair for pair in zip(old.omega, new.omega, strict=True) if len(pair[0])]
            return p_no_decrease([(t, *pair) for t, pair in zip(times, pairs, strict=True)])
        triples = zip(experiments, old.thrust, new.thrust, strict=True)
        further = self.on_runs(beside) - self.on_runs(fit)
        return p_no_decrease([(e.record.time, *pair) for e, *pair in triples], further.tolist())


def judged_term(judge: Carried, fit: Fit, beside: Fit, comparisons: int) -> Judgement:
    """Judge a term as an effect. Its held-out gain must also exceed the best chance gain of all comparisons, and its held-out
    thrust error must decrease significantly."""
    judged = judge(fit.effects[-1], fit, beside)
    needed, gain, p, refused = (
        by_chance(comparisons),
        judge.gain(fit, beside),
        judge.p_no_decrease(fit, beside),
        list(judged.refused),
    )
    if gain <= needed:
        refused.append(f"cross-validation gains {gain:.1f} nats; the best of {comparisons} by chance {needed:.1f}")
    if p >= ALPHA_HELD_OUT:
        refused.append(f"the held-out thrust error does not decrease significantly (p = {p:.2g})")
    if judge.on_runs(fit).sum() > judge.on_runs(beside).sum():
        refused.append("the step responses are predicted worse")
    return replace(judged, refused=tuple(refused))


def short_list(leads: Sequence[Lead], had: Sequence[Lead], count: int) -> list[Lead]:
    """The promising leads of the best held-out score: one of each port and shape, up to FAMILY of a family of ports."""
    places, families, found = {lead.kind for lead in had}, {}, []
    for lead in leads:
        if len(found) == count:
            break
        family = PORTS[lead.port].channel or "thrust"
        if not lead.promising or lead.kind in places or families.get((family, lead.port), 0) >= FAMILY:
            continue
        places.add(lead.kind)
        families[family, lead.port] = families.get((family, lead.port), 0) + 1
        found.append(lead)
    return found


def variants(term: Term, had: Sequence[Term]) -> list[Lead]:
    """The same term at the other lag of its channel, and with the lags in the other order, if not tried yet."""
    lead, values = term.lead, {n: v for n, v in term.values.items() if n not in ("form", "lag")}
    own = replace(lead, values=values, lag=term.values.get("lag"))
    tried = {(t.lead.kind, t.lead.form, t.lead.swapped) for t in had}
    others = [replace(own, form=form, swapped=swapped) for form, swapped in forms_of(lead.port)]
    return [lead for lead in others if (lead.kind, lead.form, lead.swapped) not in tried]


def unlagged(term: Term, had: Sequence[Lead]) -> list[Lead]:
    """The same term without its lag, if it has one: a biased base causes spurious lags."""
    values = {n: v for n, v in term.values.items() if n not in ("form", "lag")}
    lead = replace(term.lead, values=values, lag=None)
    return [] if "lag" not in term.values or lead.kind in {other.kind for other in had} else [lead]


def _refitted(searcher, beside, leads, scales, pool, start=None) -> list[Term]:
    """Refits of leads that have strong evidence."""
    terms = pool.map(lambda lead: refitted(searcher, beside, lead, NAME, scales, start), leads)
    return [t for t in terms if t is not None and evidence_over(t.fit, beside) > MIN_EVIDENCE]
