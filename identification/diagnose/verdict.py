"""From a search's outcome to a verdict: attributed, family, partly, unexplained, none."""

from collections.abc import Callable, Mapping

from scipy.stats import chi2

from identification.diagnose.search.explainable import ATTRIBUTED, NOTHING_IN_SPEED, Explained, Left, Remainder
from identification.diagnose.search.fits import Fit, Searcher
from identification.diagnose.search.judge import ALIKE, ENOUGH_HELD_OUT, judge, seen_at_best
from identification.diagnose.search.rounds import Tried
from identification.diagnose.search.stepwise import Selection, without

CONTRADICTED = 2.0
"""Standard errors of the share by which it must fall short of that where the fitted records hold nothing more: the noise of
unseen data blurs the share of a small error."""

RICHER = 0.99
"""Level of the likelihood ratio that a rival with more parameters must pass: else it only contains the simpler effect."""

SAME = 0.1
"""Difference of the deviance below which two fits are one model under two names."""

PARTLY = 0.5
"""Share from which a set that is not the whole is worth a name and a place in the model."""


def rivals(searcher: Searcher, selection: Selection, held) -> dict[str, list[str]]:
    """For each effect of the final set, others that fit as well in its place, and do as well on unseen thrust."""
    final, found = selection.final, {}
    mine = seen_at_best(final, held)
    for effect in final.effects:
        rest = without(searcher, final, effect) if len(final.effects) > 1 else selection.base
        names = set()
        for tried in _close(selection, effect):
            fuller, simpler = tried.candidate.free, tuple(n for n in tried.candidate.free if n in tried.fit.free)
            for free in {fuller, simpler}:
                other = _in_its_place(searcher, rest, tried, free)
                # What sheds parameters may end as the very model that it is compared with.
                special = free == simpler != fuller and abs(other.deviance - final.deviance) < SAME
                if other.idle or special or not _alike(other, final):
                    continue
                theirs = seen_at_best(other, held)
                if mine.score.gain(theirs.score)["thrust"] >= ENOUGH_HELD_OUT:
                    continue
                judged = judge(tried.candidate.name, other, rest, theirs, seen_at_best(rest, held), selection.base)
                names |= set() if judged.refused else {tried.candidate.name}
        found[effect] = sorted(names)
    return found


def _in_its_place(searcher: Searcher, rest: Fit, tried: Tried, free: tuple[str, ...]) -> Fit:
    if not rest.effects and not tried.beside and set(free) == set(tried.fit.free):
        return tried.fit
    start = {**rest.values, **{n: tried.fit.values[n] for n in tried.candidate.free}}
    forms = {**rest.forms, **tried.candidate.form}
    return searcher.fit([*rest.effects, tried.candidate.name], forms, [*rest.free, *free], start, tried.fit.slow_first)


def _alike(other: Fit, final: Fit) -> bool:
    more = len(other.free) - len(final.free)
    if more > 0:
        return final.deviance - other.deviance > chi2.ppf(RICHER, more)
    return other.bic() - final.bic() < ALIKE


def _close(selection: Selection, effect: str):
    """Candidates of the effect's round that came near it."""
    for tried in selection.rounds:
        mine = [t for t in tried if t.candidate.name == effect and t.fit is not None]
        if not mine:
            continue
        best = max(t.delta_bic for t in mine)
        return [
            t
            for t in tried
            if t.fit is not None and t.candidate.name not in selection.final.effects and t.delta_bic > best - 10 * ALIKE
        ]
    return []


def verdict(
    selection: Selection,
    base: Fit,
    remainder: Remainder,
    family: Mapping[str, list[str]],
    further: Callable[[Fit], bool],
) -> tuple[str, Explained | None, Left]:
    """(verdict, share of the explainable error of `base` removed on unseen data, what is left on the fitted records).

    `further(fit)`: whether much is gained beside a fit, by one of the remaining candidates or by what has no name.
    """
    final = selection.final
    left = remainder.left(final)
    if not final.effects:
        return ("unexplained" if left.anything else "none"), None, left
    explained = remainder.explained(base, final)
    named = "family" if any(family.values()) else "attributed"
    if not _whole(explained, left, remainder.left(base)):
        return ("partly" if explained is None or explained.share >= PARTLY else "unexplained"), explained, left
    return ("partly" if further(final) else named), explained, left


def _whole(explained: Explained | None, left: Left, before: Left) -> bool:
    """Whether a set is the whole explanation."""
    if not left.anything:
        return explained is None or explained.share + CONTRADICTED * explained.error >= ATTRIBUTED
    if left.speed > NOTHING_IN_SPEED and left.speed > (1.0 - ATTRIBUTED) * before.speed:
        return False
    return explained is not None and explained.share >= ATTRIBUTED
