"""Which effects are missing: add the best, refit all, repeat; then every effect must stand in the presence of the others."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product

import numpy as np

from identification.diagnose.candidates import Candidate
from identification.diagnose.evidence import Experiment
from identification.diagnose.explainable import Left
from identification.diagnose.judge import (
    ALIKE,
    BESIDE,
    CHANNEL,
    ENOUGH_BIC,
    ENOUGH_HELD_OUT,
    NUISANCE,
    Judgement,
    channels,
    judge,
    placed,
    seen_at_best,
    trifling,
)
from identification.diagnose.linearised import Linearised
from identification.diagnose.look import Looks, Seen
from identification.diagnose.search import Fit, Searcher
from vpp_fmu.native import Simulator

MOST = 3
"""Effects that one diagnosis may name; with more, the data of one campaign cannot tell sets apart."""

ROUNDS = 5
"""Rounds of refits after which the search takes what stands: where nothing fits, more of them only take time."""

REFITTED = 8
"""Candidates of a round that are refitted in full; the look before ranks the right one among the first few."""

REORDERED = 3
"""Of these, the best, refitted with a channel's lags in the other order too: a double pole hides which comes first."""

SOME = 0.1
"""Share of what the best candidate promises that others must promise to be refitted where none of the first ones stands."""

START = 0.2
"""Share of the explainable error, of thrust or of speed, that the first effect must remove for more to be looked for beside it:
the best comes first, and where it is not much the rest are surrogates too."""

RECONSIDERED = 2
"""Refused effects, the best first, that are looked at once more at the end."""

FURTHER = 10.0
"""Log-likelihood that one more candidate must gain for a set to be near the truth only; and at least the share BESIDE of what
the set itself gained, since no form is exact."""

CONFIRMED = 3
"""Candidates beside a final set, the most promising ones, that are refitted to see whether they gain so much."""


@dataclass(frozen=True)
class Tried:
    """A candidate in one round: what the look promised and, where it was refitted, what came of it."""

    candidate: Candidate
    beside: tuple[str, ...]
    fall: float
    fit: Fit | None = None
    delta_bic: float | None = None


@dataclass
class Selection:
    """What a search found: the base, the final fit, its judgements by effect, and all that was tried, round by round.

    `placed`: thresholds that the fitted records left open and an unseen record told.
    """

    base: Fit
    final: Fit
    judgements: dict[str, Judgement] = field(default_factory=dict)
    rounds: list[list[Tried]] = field(default_factory=list)
    refused: dict[str, Judgement] = field(default_factory=dict)
    placed: tuple[str, ...] = ()


def select(
    searcher: Searcher,
    base: Fit,
    options: Iterable[Candidate],
    held: Sequence[Experiment],
    left: Callable[[Fit], Left],
    pool: ThreadPoolExecutor,
    stage: Callable[[str], None] = lambda text: None,
) -> Selection:
    """Search up to MOST effects. `held`: experiments that no fit sees. `left(fit)`: what it leaves to explain.

    Where that is nothing, a candidate may still promise much beside the fit: noise hides a small effect's power, not its shape.
    An effect that the presence of others makes superfluous is banned and the search repeated without it, so that a surrogate
    does not hide the effect behind it. The result does not depend on the number of workers in `pool`.
    """
    options = list(options)
    found = Selection(base, base)
    known: dict[tuple, list[Tried]] = {}
    banned: dict[str, Judgement] = {}
    while len(known) < ROUNDS:
        usable = [c for c in options if c.name not in banned]
        path, refused = _forward(searcher, base, usable, held, left, pool, known, stage)
        found.rounds = [known[_key(fit)] for fit in path if _key(fit) in known]
        stage("judge")
        found.final, found.judgements, dropped = _backward(searcher, path[-1], held, base, pool)
        found.refused = {n: j for n, j in {**refused, **banned}.items() if n not in found.final.effects}
        if not dropped:
            break
        banned.update(dropped)
        found.refused.update(dropped)
    _reconsider(searcher, found, [t for tried in known.values() for t in tried], held, left, pool)
    told = placed(found.final, held)
    found.placed = tuple(n for n in told.thresholds if told.values[n] != found.final.values[n])
    found.final = told
    return found


def _reconsider(searcher: Searcher, found: Selection, tried: Sequence[Tried], held, left, pool) -> None:
    """Once more what was refused before the others were there: what hid behind them may stand beside them."""
    for name in sorted(found.refused, key=lambda n: -found.refused[n].delta_bic)[:RECONSIDERED]:
        if not 0 < len(found.final.effects) < MOST or not left(found.final).anything:
            return
        fitted = [t for t in tried if t.candidate.name == name and t.fit is not None]
        best = max(fitted, key=lambda t: t.delta_bic)
        start = {**found.final.values, **{n: best.fit.values[n] for n in best.candidate.free}}
        fuller = _with(searcher, found.final, best.candidate, start, found.final.slow_first)
        fuller = _simplified(searcher, best.candidate, fuller, held)
        kept, judgements, dropped = _backward(searcher, fuller, held, found.base, pool)
        if not dropped:
            found.final, found.judgements = kept, judgements
            del found.refused[name]


def _key(fit: Fit) -> tuple:
    return tuple(sorted(fit.effects)), tuple(sorted(fit.forms.items()))


def _forward(searcher, base, options, held, left, pool, known, stage) -> tuple[list[Fit], dict[str, Judgement]]:
    """(fits along the way, the base first; what did not stand where it was best).

    The base is always tried: the gates are stricter than any look at its residual, and see what is below its noise.
    """
    path, refused = [base], {}
    while len(path) <= MOST:
        anything = len(path) == 1 or left(path[-1]).anything
        usable = options if anything else _elsewhere(searcher, base, path[-1], options, pool)
        if not usable:
            break
        key = _key(path[-1])
        if key not in known:
            stage(f"try {len(usable)} candidates" + "".join(f" + {name}" for name in path[-1].effects))
            known[key] = _round(searcher, path[-1], usable, held, pool)
        best, failed = _best([t for t in known[key] if t.candidate in usable], path[-1], held, base)
        if best is None and failed:  # what hides behind surrogates may promise less than they do
            known[key] = _deeper(searcher, path[-1], known[key], held, pool)
            best, failed = _best([t for t in known[key] if t.candidate in usable], path[-1], held, base)
        refused |= failed
        if best is None:
            break
        path.append(best.fit)
        if len(path) == 2 and left(best.fit).gone(left(base)) < START:
            break
    return path, refused


def _best(tried: Sequence[Tried], beside: Fit, held, base: Fit) -> tuple[Tried | None, dict[str, Judgement]]:
    """(of the refitted candidates that stand beside a fit the best, what is better and does not stand).

    Of those that fit alike, unseen thrust decides, then simplicity.
    """
    fitted = [t for t in tried if t.fit is not None and t.delta_bic > ENOUGH_BIC and not trifling(t.fit)]
    without_it, standing, refused = seen_at_best(beside, held), [], {}
    for t in sorted(fitted, key=lambda t: -t.delta_bic):
        if standing and t.delta_bic <= standing[0][0].delta_bic - ALIKE:
            break
        with_it = seen_at_best(t.fit, held)
        judged = judge(t.candidate.name, t.fit, beside, with_it, without_it, base)
        if judged.refused:
            refused.setdefault(t.candidate.name, judged)
        else:
            standing.append((t, with_it.score))
    if not standing:
        return None, refused
    least = min((score for _, score in standing), key=lambda score: score.squares["thrust"])
    alike = [t for t, score in standing if least.gain(score)["thrust"] < ENOUGH_HELD_OUT]
    return max(alike, key=_simplest), refused


def _simplest(tried: Tried) -> tuple:
    """Of what fits alike, the one with the fewest parameters, and rather one that is simple than one that was made so."""
    shed = len([n for n in tried.candidate.free if n in tried.fit.free]) < len(tried.candidate.free)
    return not tried.fit.idle, -len(tried.fit.free), not shed, tried.delta_bic


def _round(searcher: Searcher, fit: Fit, options: Sequence[Candidate], held, pool) -> list[Tried]:
    """All candidates beside a fit, those that promise most refitted."""
    looked = [Tried(c, fit.effects, at.fall) for c, at in _looks(searcher, fit, options, pool)]
    return _deeper(searcher, fit, looked, held, pool)


def _deeper(searcher: Searcher, fit: Fit, tried: Sequence[Tried], held, pool) -> list[Tried]:
    """The same with REFITTED more of them refitted, as long as they promise something beside the best."""
    enough = max(SOME * tried[0].fall, ENOUGH_BIC) if tried and tried[0].fit else -np.inf
    chosen = [t for t in tried if t.fit is None and t.fall > enough][:REFITTED]
    at = {c.label: seen for c, seen in _looks(searcher, fit, [t.candidate for t in chosen], pool)}
    refits = list(pool.map(lambda t: _refit(searcher, fit, t.candidate, at[t.candidate.label]), chosen))
    best = sorted(range(len(chosen)), key=lambda k: refits[k].bic())[:REORDERED]
    for k, new in zip(best, pool.map(lambda k: _reordered(searcher, fit, chosen[k].candidate, refits[k]), best), strict=True):
        refits[k] = new
    leaders = {chosen[k].candidate.name: refits[k] for k in sorted(best, key=lambda k: -refits[k].bic())}
    widened = pool.map(lambda k: _widened(searcher, fit, chosen[k].candidate, refits[k], leaders, held), best)
    for k, new in zip(best, widened, strict=True):
        refits[k] = new
    fresh = [replace(t, fit=new, delta_bic=fit.bic() - new.bic()) for t, new in zip(chosen, refits, strict=True)]
    done = {t.candidate.label: t for t in fresh}
    return [done.get(t.candidate.label, t) for t in tried]


def _looks(searcher: Searcher, fit: Fit, options: Iterable[Candidate], pool) -> list[tuple[Candidate, Seen]]:
    """The candidates that are not in a fit, by what a look promises; one look a candidate and fit."""
    fresh = [c for c in options if c.name not in fit.effects]
    seen_there = searcher.looks.setdefault((_key(fit), fit.deviance), {})
    if new := [c for c in fresh if c.label not in seen_there]:
        looks = Looks(fit, searcher.start, searcher.library)
        seen_there.update(zip((c.label for c in new), pool.map(looks.at, new), strict=True))
    return sorted(((c, seen_there[c.label]) for c in fresh), key=lambda pair: -pair[1].fall)


def _elsewhere(searcher: Searcher, base: Fit, fit: Fit, options: Sequence[Candidate], pool) -> list[Candidate]:
    """The candidates in channels that a fit's effects leave alone, where the most promising one of all is there.

    What a slightly wrong form leaves shows in its own channel: there, a second effect would mend the first.
    """
    touched = set().union(*map(channels, fit.effects))
    apart = [c for c in options if touched.isdisjoint(channels(c.name))]
    further = _promising(searcher, base, fit, options, pool)
    return apart if further and further[0][0] in apart else []


def gains_further(searcher: Searcher, base: Fit, fit: Fit, options: Iterable[Candidate], pool) -> bool:
    """Whether a further candidate gains so much beside a fit that the fit is near the truth and not the truth.

    Looks see along straight lines; the most promising are refitted to see what they keep.
    """
    first = _promising(searcher, base, fit, options, pool)[:CONFIRMED]
    fuller = pool.map(lambda pair: _refit(searcher, fit, *pair), first)
    return any(fit.deviance - new.deviance > 2.0 * much(base, fit) for new in fuller)


def _promising(searcher: Searcher, base: Fit, fit: Fit, options: Iterable[Candidate], pool) -> list[tuple[Candidate, Seen]]:
    """The candidates that promise much beside a fit, the best first; without what every rig has a little of."""
    looks = _looks(searcher, fit, options, pool)
    return [(c, at) for c, at in looks if c.name not in NUISANCE and at.fall > much(base, fit)]


def much(base: Fit, fit: Fit) -> float:
    """Log-likelihood that is more than what the right forms leave beside a fit, which are never exact."""
    return max(FURTHER, 0.5 * BESIDE * (base.deviance - fit.deviance))


def _refit(searcher: Searcher, fit: Fit, candidate: Candidate, at: Seen) -> Fit:
    """The candidate beside what is there already."""
    # A threshold that stands in the fit already is scanned nearby here, and over its whole range once this is among the best.
    thorough = not fit.thresholds
    found = _with(searcher, fit, candidate, {**fit.values, **at.values}, at.slow_first, thorough)
    if found.bic() < fit.bic():
        return found
    # The fitted parameters can't have followed as far as a straight line would have it: from where they stand, then.
    own = {n: at.values[n] for n in candidate.free}
    return min(found, _with(searcher, fit, candidate, {**fit.values, **own}, fit.slow_first, thorough), key=Fit.bic)


def _reordered(searcher: Searcher, fit: Fit, candidate: Candidate, refit: Fit) -> Fit:
    """The candidate's refit, or a better one with a channel's lags in the other order."""
    lagged = sorted(channels(candidate.name) & set(CHANNEL.values()))
    orders = [{**refit.slow_first, channel: not refit.slow_first.get(channel, True)} for channel in lagged]
    if candidate.effect.delays:  # they act before both lags
        orders = []
    starts = [*orders, refit.slow_first] if refit.thresholds else orders
    return min([refit, *(_with(searcher, fit, candidate, refit.values, order) for order in starts)], key=Fit.bic)


def _widened(searcher: Searcher, fit: Fit, candidate: Candidate, refit: Fit, others: Mapping[str, Fit], held) -> Fit:
    """The candidate's refit, or a better one from a special case's fit or with a size on that was left off; without idle sizes.

    `others`: fits of other effects in its place.
    """
    fits = [refit]
    for name, shared in candidate.effect.contains.items():
        if special := others.get(name):
            same = {candidate.effect.full(own): special.values[f"{name}.{its}"] for own, its in shared.items()}
            fits.append(_with(searcher, fit, candidate, {**special.values, **candidate.off, **same}, special.slow_first))
    return _simplified(searcher, candidate, _revived(searcher, candidate, min(fits, key=Fit.bic)), held)


def _revived(searcher: Searcher, candidate: Candidate, fit: Fit) -> Fit:
    """The fit, or a better one in which the last effect's sizes that it left off are on: off may be a minimum of its own."""
    axes = {n: [candidate.off[n], *candidate.axis(n)] for n in candidate.sizes if fit.values[n] == candidate.off[n]}
    if not axes or len(candidate.sizes) == 1:
        return fit
    about, simulator = Linearised.of(fit.evidence, fit.solution), Simulator(fit.evidence.model)
    points = [dict(zip(axes, values, strict=True)) for values in product(*axes.values())]
    costs = [about.cost(simulator, point) for point in points]
    if costs[0] - min(costs) < 1.0:  # the first is the fit as it is
        return fit
    start = {**fit.values, **points[int(np.argmin(costs))]}
    free = dict.fromkeys([*fit.free, *candidate.free])
    revived = searcher.fit(fit.effects, fit.forms, list(free), start, fit.slow_first, thorough=False)
    return min(fit, revived, key=Fit.bic)


def _simplified(searcher: Searcher, candidate: Candidate, fit: Fit, held) -> Fit:
    """The fit less those sizes of the candidate, its last effect, that tell too little: they would spoil other commands.

    Unless unseen commands miss one: a limit that falls with pitch looks constant where it was met at one pitch only.
    """
    while True:
        sizes = [n for n in candidate.sizes if n in fit.free]
        fewer = []
        for name in sizes if len(sizes) > 1 else ():
            start, free = {**fit.values, name: candidate.off[name]}, [n for n in fit.free if n != name]
            fewer.append(searcher.fit(fit.effects, fit.forms, free, start, fit.slow_first, thorough=False))
        best = min([fit, *fewer], key=Fit.bic)
        if best is fit or seen_at_best(fit, held).score.gain(seen_at_best(best, held).score)["thrust"] >= ENOUGH_HELD_OUT:
            return fit
        fit = replace(best, idle=fit.idle)


def _with(searcher, fit, candidate, start, order, thorough=True) -> Fit:
    effects, forms = [*fit.effects, candidate.name], {**fit.forms, **candidate.form}
    return searcher.fit(effects, forms, [*fit.free, *candidate.free], start, order, thorough)


def _backward(searcher: Searcher, final: Fit, held, base: Fit, pool) -> tuple[Fit, dict[str, Judgement], dict[str, Judgement]]:
    """Drop the weakest effect that does not stand, until all do: (fit, judgements, what was dropped)."""
    dropped: dict[str, Judgement] = {}
    while final.effects:
        held_with = seen_at_best(final, held)
        rest = dict(zip(final.effects, pool.map(partial(without, searcher, final), final.effects), strict=True))
        judgements = {e: judge(e, final, fit, held_with, seen_at_best(fit, held), base) for e, fit in rest.items()}
        weak = [j for j in judgements.values() if j.refused]
        if not weak:
            return final, judgements, dropped
        weakest = min(weak, key=lambda j: j.delta_bic)
        dropped[weakest.effect] = weakest
        final = rest[weakest.effect]
    return final, {}, dropped


def without(searcher: Searcher, fit: Fit, effect: str) -> Fit:
    """The fit of the same set less one effect; once per set."""
    own = f"{effect}."
    effects = tuple(e for e in fit.effects if e != effect)
    forms = {n: v for n, v in fit.forms.items() if not n.startswith(own)}
    free = tuple(n for n in fit.free if not n.startswith(own))
    key = effects, tuple(forms.items()), free, tuple(fit.slow_first.items())
    if key not in searcher.subsets:
        searcher.subsets[key] = searcher.fit(effects, forms, free, fit.values, fit.slow_first)
    return searcher.subsets[key]
