"""From a search's outcome to a verdict: attributed, family, partly, unexplained, none."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from identification.diagnose.evidence import Experiment
from identification.diagnose.explainable import shared_power, shared_speed, slow_residual
from identification.diagnose.judge import ALIKE, ENOUGH_HELD_OUT, judge, seen_at_best
from identification.diagnose.noise import BAND, Noise
from identification.diagnose.search import Fit, Searcher
from identification.diagnose.stepwise import Selection, Tried, without
from vpp_fmu.campaign import Campaign
from vpp_fmu.native import Simulator

NOTHING = 0.02
"""Share of the noise's power below which repeatable error is not worth a name."""

NOTHING_IN_SPEED = 0.1
"""The same for speed: how a tachometer holds and rounds repeats, and no model of it is exact."""

ATTRIBUTED = 0.9
"""Share of the explainable error that a named set must remove on unseen data; a surrogate removes a fifth to a half."""

DRIFT = 0.1
"""Share by which the noise may differ from rest to motion, where no repeat tells."""

CONTRADICTED = 2.0
"""Standard errors of the share by which it must fall short of that where the fitted records hold nothing more: the noise of
unseen data blurs the share of a small error."""

RICHER = 0.99
"""Level of the likelihood ratio that a rival with more parameters must pass: else it only contains the simpler effect."""

SAME = 0.1
"""Difference of the deviance below which two fits are one model under two names."""

PARTLY = 0.5
"""Share from which a set that is not the whole is worth a name and a place in the model."""


@dataclass(frozen=True)
class Left:
    """Repeatable error of a fit below 10 Hz, as a share of the noise's power; of thrust, and of speed.

    `error`: standard error of the thrust's where nothing is left: neighbouring means share noise, three tell as much as one.
    """

    share: float
    error: float
    speed: float = 0.0

    @property
    def anything(self) -> bool:
        """Whether there is something to explain."""
        return self.share > max(NOTHING, 2.0 * self.error) or self.speed > NOTHING_IN_SPEED


@dataclass(frozen=True)
class Explained:
    """Share of the explainable thrust error on unseen data that a set removes, with the standard error that noise gives it."""

    share: float
    error: float


class Remainder:
    """What a fit leaves unexplained, on the fitted records and on unseen ones."""

    def __init__(self, campaign: Campaign, held: list[Experiment], noise: Noise):
        self._record, self._repeat, self._held, self._noise = campaign.open_loop, campaign.repeat, held, noise

    def left(self, fit: Fit) -> Left:
        """Of the fitted records. Without a repeat, what exceeds the noise estimate."""
        thrust, speed = _predicted(fit, self._record)
        scale, error = self._noise.floor**2, self._noise.slow * np.sqrt(3.0 * BAND / self._record.time[-1])
        if self._repeat is None:
            power = float(np.mean(slow_residual(self._record, thrust) ** 2)) - self._noise.slow
            return Left(power / scale, max(error, DRIFT * self._noise.slow) / scale)
        power = shared_power(self._record, self._repeat, thrust)
        turning = "omega" in self._record and "omega" in self._repeat
        return Left(power / scale, error / scale, shared_speed(self._record, self._repeat, speed) if turning else 0.0)

    def explained(self, base: Fit, final: Fit) -> Explained | None:
        """What `final` removes of the error of `base`; None where there is none to speak of.

        A threshold counts where it does best of `Fit.places`.
        """
        slow, before = self._noise.slow, self._unseen(base)
        after = min((self._unseen(final, place) for place in final.places), key=lambda residual: np.mean(residual**2))
        explainable = float(np.mean(before**2)) - slow
        if explainable < 2 * NOTHING * self._noise.floor**2:
            return None
        removed = float(np.mean(before**2) - np.mean(after**2))
        # Mean squares of noise scatter, and products of noise with the model's error. Three means tell as much as one.
        one, level = 3.0 / len(before), 3.0 * BAND / self._record.time[-1]
        of_removed = 4.0 * np.mean((before - after) ** 2) * slow * one
        of_explainable = 2.0 * slow**2 * (one + level) + 4.0 * explainable * slow * one
        return Explained(removed / explainable, float(np.sqrt(of_removed + ATTRIBUTED**2 * of_explainable)) / explainable)

    def _unseen(self, fit: Fit, changes: Mapping[str, float] | None = None) -> np.ndarray:
        """Residual [N] on unseen records below 10 Hz, of a fit with `changes` to its values."""
        return np.concatenate([slow_residual(e.record, _predicted(fit, e.record, changes)[0]) for e in self._held])


def _predicted(fit: Fit, record, changes: Mapping[str, float] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Thrust [N] and speed [rpm], each (rows,), of a fit with `changes` to its values."""
    values = {**fit.values, **(changes or {})}
    return tuple(Simulator(fit.evidence.model).simulate(values, record.columns, record.steps).T[:2])


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
    near: Callable[[Fit], bool],
) -> tuple[str, Explained | None, Left]:
    """(verdict, share of the explainable error of `base` removed on unseen data, what is left on the fitted records).

    `near(fit)`: whether one of the remaining candidates gains much beside a fit.
    """
    final = selection.final
    left = remainder.left(final)
    if not final.effects:
        return ("unexplained" if left.anything else "none"), None, left
    explained = remainder.explained(base, final)
    named = "family" if any(family.values()) else "attributed"
    if not _whole(explained, left, remainder.left(base)):
        return ("partly" if explained is None or explained.share >= PARTLY else "unexplained"), explained, left
    return ("partly" if near(final) else named), explained, left


def _whole(explained: Explained | None, left: Left, before: Left) -> bool:
    """Whether a set is the whole explanation."""
    if not left.anything:
        return explained is None or explained.share + CONTRADICTED * explained.error >= ATTRIBUTED
    if left.speed > NOTHING_IN_SPEED and left.speed > (1.0 - ATTRIBUTED) * before.speed:
        return False
    return explained is not None and explained.share >= ATTRIBUTED
