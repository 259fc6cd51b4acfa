"""One round of the search: every candidate beside a fit is refitted from every start, the better third to convergence.

Screening (screening.py) predicts a good start of each candidate. It is a bad filter: a double pole hides a missing lead, and
lags of a biased base hide a limit.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from identification.diagnose.search.candidates import Candidate
from identification.diagnose.search.fits import Fit, Searcher
from identification.diagnose.search.screening import Screening, ScreeningResult
from identification.fit.coordinates import SHORTEST
from vpp_fmu.native.memory import give_back

SAME_RESPONSE = 1e-6
"""Difference of two responses, in noise standard deviations, that counts as rounding."""

CONVERGED, FEWEST = 1.0 / 3.0, 8
"""Share of the candidates, the best after two steps, that are fitted to convergence, and their least number."""

LEADERS = 3
"""Best candidates that are also started from fits of their special cases, and with switched-off sizes on."""


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


def search_round(
    searcher: Searcher, fit: Fit, options: Sequence[Candidate], pool, progress: Callable[[int, int, str], None]
) -> list[CandidateFit]:
    """Refit every candidate beside a fit, from every start: two steps each; then the better third to convergence, a threshold
    after a scan of its whole range. Thresholds that the fit already has are held meanwhile."""
    seen = screened(searcher, fit, options, pool, progress)
    looks = pool.map(lambda pair: _first_look(searcher, fit, *pair), seen)
    best = {c: look for (c, _), look in zip(seen, looks, strict=True) if look is not None}
    give_back()
    ranked = sorted(best, key=lambda c: best[c].bic())
    names = list(dict.fromkeys(c.name for c in ranked))
    count = max(FEWEST, round(CONVERGED * len(names)))
    chosen = [c for c in ranked if c.name in names[:count] or best[c].thresholds.keys() - fit.thresholds.keys()]

    def converged(c: Candidate) -> Fit:
        return added(searcher, fit, c, best[c].values, best[c].slow_first)

    refits = dict(zip(chosen, pool.map(converged, chosen), strict=True))
    leading = sorted(refits, key=lambda c: refits[c].bic())[:LEADERS]
    leaders = {c.name: refits[c] for c in reversed(leading)}
    refits.update(zip(leading, pool.map(lambda c: _widened(searcher, fit, c, refits[c], leaders), leading), strict=True))
    for wide in leading:
        for special, known in list(refits.items()):
            if start := _narrowed(wide, refits[wide], special):
                new = added(searcher, fit, special, start, refits[wide].slow_first)
                refits[special] = min(known, new, key=Fit.bic)
    gains = {c: at.likelihood_gain for c, at in seen}
    return [
        CandidateFit(c, fit.effects, gain, refits.get(c), evidence_over(refits.get(c, best.get(c, fit)), fit))
        for c, gain in gains.items()
    ]


def _first_look(searcher: Searcher, fit: Fit, candidate: Candidate, at: ScreeningResult) -> Fit | None:
    """The best fit of a candidate after two steps from each start; None if all diverge.

    Starts are the point that screening predicts, and those of the candidate. From those where the order of lags matters, the
    same with the other order, and with hardly any second lag: an effect with a lag of its own replaces it."""
    points = [({**fit.values, **values}, fit.slow_first) for values in (at.values, *candidate.starts())]
    looks = [_look(searcher, fit, candidate, *point) for point in points]
    free = _ordered(searcher, candidate)
    acting = [p for p, look in zip(points, looks, strict=True) if look and free and not _exchangeable(look, free)]
    for u in free if acting else ():
        further = [_flipped(u, *point) for point in acting] + [_alone(u, first, *acting[-1]) for first in (True, False)]
        looks += [_look(searcher, fit, candidate, *point) for point in further]
    found = [look for look in looks if look is not None]
    return searcher.counted(min(found, key=lambda look: look.deviance), fit.thresholds) if found else None


def _ordered(searcher: Searcher, candidate: Candidate) -> list[str]:
    """The channels in which a candidate acts and both lags are free: the response may depend on their order."""
    return [u for u in candidate.effect.channels if {f"tau_{u}_1", f"tau_{u}_2"} <= {*searcher.names}]


def _look(searcher: Searcher, fit: Fit, candidate: Candidate, start, order) -> Fit | None:
    """The candidate after two steps or so from a start; None if it diverges."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            found = searcher.look(*_with(fit, candidate), start, order, fit.problem.scale)
    except np.linalg.LinAlgError:
        return None
    return found if np.isfinite(found.deviance) else None


Start = tuple[dict[str, float], dict[str, bool]]
"""Values that a fit starts from, and the order of the lags."""


def _flipped(u: str, values: Mapping[str, float], order: Mapping[str, bool]) -> Start:
    """A start with the lags of a channel in the other order."""
    one, two = f"tau_{u}_1", f"tau_{u}_2"
    return {**values, one: values[two], two: values[one]}, {**order, u: not order.get(u, True)}


def _alone(u: str, slow_first: bool, values: Mapping[str, float], order: Mapping[str, bool]) -> Start:
    """A start with nearly all of a channel's lag in one of its two lags: the outer one if `slow_first`."""
    both = values[f"tau_{u}_1"] + values[f"tau_{u}_2"]
    long, short = both / (1.0 + SHORTEST), both * SHORTEST / (1.0 + SHORTEST)
    lags = (long, short) if slow_first else (short, long)
    return {**values, **dict(zip((f"tau_{u}_1", f"tau_{u}_2"), lags, strict=True))}, {**order, u: slow_first}


def _exchangeable(fit: Fit, channels: Iterable[str]) -> bool:
    """Whether exchanging the two lags of each channel leaves the response unchanged."""
    swapped = dict(fit.values)
    for u in channels:
        swapped |= {f"tau_{u}_1": fit.values[f"tau_{u}_2"], f"tau_{u}_2": fit.values[f"tau_{u}_1"]}
    there = fit.problem.residual_at(swapped) - fit.problem.residual_at(fit.values)
    return bool(np.max(np.abs(there[: fit.problem.size]), initial=0.0) < SAME_RESPONSE)


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
        at = Screening(fit, searcher.library).at
        for done, (c, result) in enumerate(zip(new, pool.map(at, new), strict=True), start=1):
            cached[c.label] = result
            progress(done, len(new), max(new[:done], key=lambda each: cached[each.label].likelihood_gain).label)
    searcher.points = max(searcher.points, sum(seen.points for seen in cached.values()))
    return sorted(((c, cached[c.label]) for c in fresh), key=lambda pair: -pair[1].likelihood_gain)


def _widened(searcher: Searcher, fit: Fit, candidate: Candidate, refit: Fit, others: Mapping[str, Fit]) -> Fit:
    """The candidate's refit, or a better one: with the lags in the other order, started from the fit of a special case, or with
    a size switched on. Superfluous sizes are removed.

    `others`: fits of other effects in its place.
    """
    fits = [refit]
    if (free := _ordered(searcher, candidate)) and not _exchangeable(refit, free):
        fits += [added(searcher, fit, candidate, *_flipped(u, refit.values, refit.slow_first)) for u in free]
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
    """Fit one more candidate, from the values `start` and with the lags in this `order`. Thresholds of the fit are held."""
    return searcher.fit(*_with(fit, candidate), start, order, thorough, fit.thresholds)


def _with(fit: Fit, candidate: Candidate) -> tuple[list[str], dict[str, float], list[str]]:
    """(effects, forms, free parameters) of a fit with one more candidate."""
    return [*fit.effects, candidate.name], {**fit.forms, **candidate.form}, [*fit.free, *candidate.free]
