"""Which effects are missing: add the best, refit all, repeat; then every effect must stand in the presence of the others."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial

from identification.diagnose.evidence.whitened import Experiment
from identification.diagnose.search.candidates import Candidate
from identification.diagnose.search.explainable import Left
from identification.diagnose.search.fits import Fit, Searcher
from identification.diagnose.search.further import elsewhere
from identification.diagnose.search.judge import (
    ALIKE,
    ENOUGH_BIC,
    ENOUGH_HELD_OUT,
    Judgement,
    judge,
    placed,
    seen_at_best,
    trifling,
)
from identification.diagnose.search.rounds import Tried, added, deeper, first_round, key, simplified

MOST = 3
"""Effects that one diagnosis may name; with more, the data of one campaign cannot tell sets apart."""

ROUNDS = 5
"""Rounds of refits after which the search takes what stands: where nothing fits, more of them only take time."""

SETTLED = 1.0
"""BIC that a set may gain when it is refitted without the latest candidate, from where that had brought it."""

START = 0.2
"""Share of the explainable error, of thrust or of speed, that the first effect must remove for more to be looked for beside it:
the best comes first, and where it is not much the rest are surrogates too."""

RECONSIDERED = 2
"""Refused effects, the best first, that are looked at once more at the end."""


@dataclass
class Selection:
    """What a search found: the base, the final fit, its judgements by effect, and all that was tried, round by round.

    `placed`: parameters that the fitted records left open and an unseen record told.
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
        found.rounds = [known[key(fit)] for fit in path if key(fit) in known]
        stage("judge")
        found.final, found.judgements, dropped = _backward(searcher, path[-1], held, base, pool)
        found.refused = {n: j for n, j in {**refused, **banned}.items() if n not in found.final.effects}
        if not dropped:
            break
        banned.update(dropped)
        found.refused.update(dropped)
    _reconsider(searcher, found, [t for tried in known.values() for t in tried], held, left, pool)
    told = placed(found.final, held)
    found.placed = tuple(n for n in told.free if told.values[n] != found.final.values[n])
    found.final = told
    return found


def _reconsider(searcher: Searcher, found: Selection, tried: Sequence[Tried], held, left, pool) -> None:
    """Once more what was refused before the others were there: what hid behind them may stand beside them."""
    for name in sorted(found.refused, key=lambda n: -found.refused[n].delta_bic)[:RECONSIDERED]:
        if not 0 < len(found.final.effects) < MOST or not left(found.final).anything:
            return
        fitted = [t for t in tried if t.candidate.name == name and t.fit is not None]
        if not fitted:  # beside a set that has been settled since
            continue
        best = max(fitted, key=lambda t: t.delta_bic)
        start = {**found.final.values, **{n: best.fit.values[n] for n in best.candidate.free}}
        fuller = added(searcher, found.final, best.candidate, start, found.final.slow_first)
        fuller = simplified(searcher, best.candidate, fuller, held)
        kept, judgements, dropped = _backward(searcher, fuller, held, found.base, pool)
        if not dropped:
            found.final, found.judgements = kept, judgements
            del found.refused[name]


def _forward(searcher, base, options, held, left, pool, known, stage) -> tuple[list[Fit], dict[str, Judgement]]:
    """(fits along the way, the base first; what did not stand where it was best).

    The base is always tried: the gates are stricter than any look at its residual, and see what is below its noise.
    """
    path, refused = [base], {}
    while len(path) <= MOST:
        anything = len(path) == 1 or left(path[-1]).anything
        usable = options if anything else elsewhere(searcher, base, path[-1], options, pool)
        if not usable:
            break
        here = key(path[-1])
        if here not in known:
            stage(f"try {len(usable)} candidates" + "".join(f" + {name}" for name in path[-1].effects))
            known[here] = first_round(searcher, path[-1], usable, held, pool)
        best, failed = _best([t for t in known[here] if t.candidate in usable], path[-1], held, base)
        if best is None and failed:  # what hides behind surrogates may promise less than they do
            known[here] = deeper(searcher, path[-1], known[here], held, pool)
            best, failed = _best([t for t in known[here] if t.candidate in usable], path[-1], held, base)
        if best is None:
            refused |= failed
            break
        rest = without(searcher, best.fit, best.candidate.name) if len(path) > 1 else path[-1]
        if rest.bic() < path[-1].bic() - SETTLED:  # what was gained is not the candidate's: the set itself was not at its best
            path[-1] = rest
            del known[here]
            continue
        refused |= failed
        path.append(best.fit)
        if len(path) == 2 and max(left(best.fit).gone(left(base)), _gone_of_speed(base, best.fit)) < START:
            break
    return path, refused


def _gone_of_speed(base: Fit, fit: Fit) -> float:
    """Share of the squares in speed that a fit takes off; where no repeat tells what of them is noise, the least it can be."""
    before, now = (f.score.squares.get("omega") for f in (base, fit))
    return 1.0 - now / before if before else 0.0


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
        judged = judge(t.candidate.name, t.fit, beside, with_it, without_it, base, complete=False)
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
    here = effects, tuple(forms.items()), free, tuple(fit.slow_first.items())
    if here not in searcher.subsets:
        found = searcher.fit(effects, forms, free, fit.values, fit.slow_first)
        if found.thresholds:  # over their whole range the search may leave the place that the others brought them to
            found = min(found, searcher.fit(effects, forms, free, fit.values, fit.slow_first, thorough=False), key=Fit.bic)
        searcher.subsets[here] = found
    return searcher.subsets[here]
