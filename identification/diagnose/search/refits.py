"""One round of the search: screen all candidates beside a fit, refit the most promising, and improve the best of these."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from identification.diagnose.judgement import MIN_EVIDENCE
from identification.diagnose.search.candidates import Candidate
from identification.diagnose.search.fits import Fit, Searcher
from identification.diagnose.search.screening import Screening, ScreeningResult
from vpp_fmu.native.memory import give_back

REFITTED = (6, 3)
"""Effects to refit in the first round and in later ones, the most promising first. As many again are refitted if none is
accepted and a lack of fit remains."""

SAME_RESPONSE = 1e-6
"""Difference of two responses, in noise standard deviations, that counts as rounding."""

REORDERED = 3
"""Best refits that are repeated with the lags of a channel in the other order: a double pole hides the order."""

REACH = 0.5
"""Share of the best evidence that a candidate needs for a refit in another order of lags, form, or special case; share of the
predicted gain below which a refit is repeated from other starts."""


@dataclass(frozen=True)
class CandidateFit:
    """A candidate in one round: the gain that screening predicts and, once it is refitted, the fit and its evidence."""

    candidate: Candidate
    beside: tuple[str, ...]
    likelihood_gain: float
    fit: Fit | None = None
    evidence: float | None = None


def key(fit: Fit) -> tuple:
    """Key of a set of effects: their names and forms."""
    return tuple(sorted(fit.effects)), tuple(sorted(fit.forms.items()))


def evidence_over(fit: Fit, other: Fit) -> float:
    """Penalised log-likelihood ratio of two fits: half the difference of their BIC."""
    return 0.5 * (other.bic() - fit.bic())


def first_round(
    searcher: Searcher, fit: Fit, options: Sequence[Candidate], pool, progress: Callable[[int, int, str], None]
) -> list[CandidateFit]:
    """Screen all candidates beside a fit, and refit the most promising."""
    seen = screened(searcher, fit, options, pool, progress)
    return deeper(searcher, fit, [CandidateFit(c, fit.effects, at.likelihood_gain) for c, at in seen], pool)


def deeper(searcher: Searcher, fit: Fit, tried: Sequence[CandidateFit], pool) -> list[CandidateFit]:
    """Refit the most promising candidates that are not refitted yet, and those that screening cannot distinguish from the best.

    An effect is ranked by its best form; its forms of nearly the same predicted gain are refitted, too.
    """
    count = REFITTED[min(len(fit.effects), len(REFITTED) - 1)]
    predicted: dict[str, float] = {}
    for t in tried:
        if t.fit is None and t.likelihood_gain > MIN_EVIDENCE:
            predicted.setdefault(t.candidate.name, t.likelihood_gain)
    most = max(predicted.values(), default=0.0)
    first = {name: gain for k, (name, gain) in enumerate(predicted.items()) if k < count or gain > most - MIN_EVIDENCE}
    least = {name: max(MIN_EVIDENCE, REACH * gain) for name, gain in first.items()}
    chosen = [t.candidate for t in tried if t.fit is None and t.likelihood_gain >= least.get(t.candidate.name, np.inf)]
    if not chosen:
        return list(tried)
    at = {c.label: seen for c, seen in screened(searcher, fit, chosen, pool)}
    give_back()
    refits = dict(zip(chosen, pool.map(lambda c: refitted(searcher, fit, c, at[c.label]), chosen), strict=True))

    def improve(starts: Iterable[tuple[Candidate, Start]], thorough: bool) -> None:
        """Refit candidates from other starts, in parallel, and keep the better refits."""
        starts = list(starts)
        fits = pool.map(lambda pair: added(searcher, fit, pair[0], *pair[1], thorough), starts)
        for (c, _), new in zip(starts, fits, strict=True):
            refits[c] = min(refits.get(c, new), new, key=Fit.bic)

    leader = min(refits, key=lambda c: refits[c].bic())
    near = {leader.name, *leader.effect.contains}
    others = [t.candidate for t in tried if t.candidate.name in near and t.candidate is not leader and t.fit is None]
    improve(((c, start) for c in others for start in _near(c, leader, refits[leader])), thorough=False)
    best = sorted(refits, key=lambda c: refits[c].bic())[:REORDERED]
    best = [c for c in best if evidence_over(refits[c], fit) >= REACH * evidence_over(refits[best[0]], fit)]
    improve(((c, start) for c in best for start in _reordered(fit, c, refits[c])), thorough=True)
    leaders = {c.name: refits[c] for c in sorted(best, key=lambda c: -refits[c].bic())}
    refits.update(zip(best, pool.map(lambda c: _widened(searcher, fit, c, refits[c], leaders), best), strict=True))
    for wide in best:
        for special, known in list(refits.items()):
            if start := _narrowed(wide, refits[wide], special):
                new = added(searcher, fit, special, start, refits[wide].slow_first, thorough=False)
                refits[special] = min(known, new, key=Fit.bic)
    return [replace(t, fit=new, evidence=evidence_over(new, fit)) if (new := refits.get(t.candidate)) else t for t in tried]


Start = tuple[Mapping[str, float], Mapping[str, bool]]
"""Values that a fit starts from, and the order of the lags."""


def _near(candidate: Candidate, leader: Candidate, there: Fit) -> list[Start]:
    """Starts of another form, or of a special case, of the best effect: its estimates, in both orders of the lags.

    Another form of a large effect may need other lags: with those of the base, screening predicts no gain.
    """
    shared = leader.effect.contains.get(candidate.name, {})
    same = {candidate.effect.full(its): there.values[leader.effect.full(own)] for own, its in shared.items()}
    values = {n: v for n, v in there.values.items() if n not in candidate.form} | candidate.within(candidate.probe | same)
    if candidate.name == leader.name:
        values |= {n: there.values[n] for n in candidate.free}
    flipped = {u: not there.slow_first.get(u, True) for u in candidate.effect.channels}
    swapped = {a: values[b] for u in flipped for a, b in permutations((f"tau_{u}_1", f"tau_{u}_2"))}
    return [(values, there.slow_first), (values | swapped, {**there.slow_first, **flipped})]


def screened(
    searcher: Searcher,
    fit: Fit,
    options: Iterable[Candidate],
    pool,
    progress: Callable[[int, int, str], None] = lambda done, total, best: None,
) -> list[tuple[Candidate, ScreeningResult]]:
    """Candidates that are not in a fit, by predicted gain. Results are cached by fit."""
    fresh = [c for c in options if c.name not in fit.effects]
    cached = searcher.screened.setdefault((key(fit), fit.deviance), {})
    if new := [c for c in fresh if c.label not in cached]:
        at = Screening(fit, searcher.start, searcher.library, biased=searcher.biased(fit)).at
        for done, (c, result) in enumerate(zip(new, pool.map(at, new), strict=True), start=1):
            cached[c.label] = result
            progress(done, len(new), max(new[:done], key=lambda each: cached[each.label].likelihood_gain).label)
    searcher.points = max(searcher.points, sum(seen.points for seen in cached.values()))
    return sorted(((c, cached[c.label]) for c in fresh), key=lambda pair: -pair[1].likelihood_gain)


def refitted(searcher: Searcher, fit: Fit, candidate: Candidate, at: ScreeningResult) -> Fit:
    """Refit with the candidate added, from the point that screening predicts.

    A refit that gains less than REACH of the prediction is in a local minimum: lags of the base replace a missing lead or lag,
    and a small effect does not bring them back. Then each point of the candidate's first grid of shapes is a further start."""
    # A threshold that the fit already has is scanned nearby; its whole range is scanned only for the best candidates.
    thorough = not fit.thresholds
    found = added(searcher, fit, candidate, {**fit.values, **at.values}, at.slow_first, thorough)
    if found.bic() >= fit.bic():
        # The linear prediction of the fitted parameters was too far: start from their values in the fit.
        own = {n: at.values[n] for n in candidate.free}
        found = min(found, added(searcher, fit, candidate, {**fit.values, **own}, fit.slow_first, thorough), key=Fit.bic)
    if 0.5 * (fit.deviance - found.deviance) >= REACH * at.likelihood_gain:
        return found
    starts = [{**fit.values, **shape, **candidate.within(candidate.probe)} for shape in candidate.shapes()]
    others = (added(searcher, fit, candidate, start, fit.slow_first, thorough=False) for start in starts)
    return min([found, *others], key=Fit.bic)


def _reordered(fit: Fit, candidate: Candidate, refit: Fit) -> list[Start]:
    """Starts from which a refit may improve: with a channel's lags in the other order."""
    orders = [{**refit.slow_first, u: not refit.slow_first.get(u, True)} for u in candidate.effect.channels]
    if _exchangeable(refit, candidate.effect.channels):
        orders = []
    # A threshold that the fit already had was scanned nearby only.
    return [(refit.values, order) for order in ([*orders, refit.slow_first] if fit.thresholds else orders)]


def _exchangeable(fit: Fit, channels: Iterable[str]) -> bool:
    """Whether exchanging the two lags of each channel leaves the response unchanged."""
    swapped = dict(fit.values)
    for u in channels:
        swapped |= {f"tau_{u}_1": fit.values[f"tau_{u}_2"], f"tau_{u}_2": fit.values[f"tau_{u}_1"]}
    there = fit.problem.residual_at(swapped) - fit.problem.residual_at(fit.values)
    return bool(np.max(np.abs(there[: fit.problem.size]), initial=0.0) < SAME_RESPONSE)


def _widened(searcher: Searcher, fit: Fit, candidate: Candidate, refit: Fit, others: Mapping[str, Fit]) -> Fit:
    """The candidate's refit, or a better one: started from the fit of a special case, or with a size switched on. Superfluous
    sizes are removed.

    `others`: fits of other effects in its place.
    """
    fits = [refit]
    for name, shared in candidate.effect.contains.items():
        if special := others.get(name):
            same = {candidate.effect.full(own): special.values[f"{name}.{its}"] for own, its in shared.items()}
            fits.append(added(searcher, fit, candidate, {**special.values, **candidate.off, **same}, special.slow_first))
    return simplified(searcher, candidate, _revived(searcher, candidate, min(fits, key=Fit.bic)))


def _narrowed(candidate: Candidate, fit: Fit, special: Candidate) -> dict[str, float] | None:
    """Values at which a special case equals the candidate's fit; None if there are none."""
    shared = candidate.effect.contains.get(special.name)
    if shared is None or not {n for n in candidate.free if n in fit.free} <= {candidate.effect.full(own) for own in shared}:
        return None
    return fit.values | {special.effect.full(its): fit.values[candidate.effect.full(own)] for own, its in shared.items()}


def _revived(searcher: Searcher, candidate: Candidate, fit: Fit) -> Fit:
    """The fit, or a better one with the last effect's switched-off sizes on: "off" may be a local minimum."""
    axes = {n: [candidate.off[n], *candidate.axis(n)] for n in candidate.sizes if fit.values[n] == candidate.off[n]}
    if not axes or len(candidate.sizes) == 1:
        return fit
    about, simulator = fit.linearised(), fit.problem.simulator
    points = [dict(zip(axes, values, strict=True)) for values in product(*axes.values())]
    costs = about.costs(simulator, points)
    if costs[0] - min(costs) < 1.0:  # the first is the fit itself
        return fit
    start = {**fit.values, **points[int(np.argmin(costs))]}
    free = dict.fromkeys([*fit.free, *candidate.free])
    revived = searcher.fit(fit.effects, fit.forms, list(free), start, fit.slow_first, thorough=False)
    return min(fit, revived, key=Fit.bic)


def simplified(searcher: Searcher, candidate: Candidate, fit: Fit) -> Fit:
    """The fit without those sizes of its last effect, the candidate, that the BIC rejects: they extrapolate badly."""
    while True:
        sizes = [n for n in candidate.sizes if n in fit.free]
        fewer = []
        for name in sizes if len(sizes) > 1 else ():
            start, free = {**fit.values, name: candidate.off[name]}, [n for n in fit.free if n != name]
            fewer.append(searcher.fit(fit.effects, fit.forms, free, start, fit.slow_first, thorough=False))
        best = min([fit, *fewer], key=Fit.bic)
        if best is fit:
            return fit
        fit = replace(best, idle=fit.idle)


def added(searcher: Searcher, fit: Fit, candidate: Candidate, start, order, thorough: bool = True) -> Fit:
    """Fit one more candidate, from the values `start` and with the lags in this `order`."""
    effects, forms = [*fit.effects, candidate.name], {**fit.forms, **candidate.form}
    return searcher.fit(effects, forms, [*fit.free, *candidate.free], start, order, thorough)
