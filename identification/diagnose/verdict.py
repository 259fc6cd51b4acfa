"""From a search's outcome to a verdict: attributed, family, partly, unexplained, none."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from identification.diagnose.evidence import Experiment
from identification.diagnose.explainable import error_power, shared_power, shared_speed
from identification.diagnose.judge import ALIKE, judge, seen
from identification.diagnose.noise import BAND, Noise
from identification.diagnose.search import Fit, Searcher
from identification.diagnose.stepwise import Selection, without
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

NEARLY = 0.6
"""The same where the fitted records hold nothing more: the noise of unseen data blurs the share of a small error."""

RICHER = 10.0
"""Fall of the deviance that a rival with more parameters must bring: else it only contains the simpler effect."""

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
    """Share of the explainable thrust error on unseen data that a set removes, with its standard error."""

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
            power = error_power(self._record, thrust)[0] - self._noise.slow
            return Left(power / scale, max(error, DRIFT * self._noise.slow) / scale)
        power = shared_power(self._record, self._repeat, thrust)
        turning = "omega" in self._record and "omega" in self._repeat
        return Left(power / scale, error / scale, shared_speed(self._record, self._repeat, speed) if turning else 0.0)

    def explained(self, base: Fit, final: Fit) -> Explained | None:
        """What `final` removes of the error of `base`; None where there is none to speak of."""
        (before, _), (after, error) = (self._unseen(fit) for fit in (base, final))
        explainable = before - self._noise.slow
        if explainable < 2 * NOTHING * self._noise.floor**2:
            return None
        return Explained((before - after) / explainable, error / explainable)

    def _unseen(self, fit: Fit) -> tuple[float, float]:
        powers = np.array([error_power(e.record, _predicted(fit, e.record)[0]) for e in self._held])
        return float(powers[:, 0].mean()), float(np.sqrt(np.sum(powers[:, 1] ** 2))) / len(powers)


def _predicted(fit: Fit, record) -> tuple[np.ndarray, np.ndarray]:
    """Thrust [N] and speed [rpm], each (rows,)."""
    return tuple(Simulator(fit.evidence.model).simulate(fit.values, record.columns, record.steps).T[:2])


def rivals(searcher: Searcher, selection: Selection, held) -> dict[str, list[str]]:
    """For each effect of the final set, others that fit as well in its place and stand on unseen data."""
    final, found = selection.final, {}
    for effect in final.effects:
        rest = without(searcher, final, effect) if len(final.effects) > 1 else selection.base
        names = []
        for tried in _close(selection, effect):
            free = [*rest.free, *tried.candidate.free]
            forms = {**rest.forms, **tried.candidate.form}
            start = {**rest.values, **{n: tried.fit.values[n] for n in tried.candidate.free}}
            single = not rest.effects and tried.beside == ()
            other = (
                tried.fit
                if single
                else searcher.fit([*rest.effects, tried.candidate.name], forms, free, start, tried.fit.slow_first)
            )
            richer = len(other.free) > len(final.free)
            alike = other.deviance < final.deviance - RICHER if richer else other.bic() - final.bic() < ALIKE
            if alike and not other.idle:
                judged = judge(tried.candidate.name, other, rest, seen(other, held), seen(rest, held), selection.base)
                names += [] if judged.refused else [tried.candidate.name]
        found[effect] = sorted(set(names))
    return found


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


def verdict(selection: Selection, remainder: Remainder, family: Mapping[str, list[str]]) -> tuple[str, Explained | None, Left]:
    """(verdict, share of the explainable error removed on unseen data, what is left on the fitted records)."""
    left = remainder.left(selection.final)
    if not selection.final.effects:
        return ("unexplained" if left.anything else "none"), None, left
    explained = remainder.explained(selection.base, selection.final)
    enough = ATTRIBUTED if left.anything else NEARLY
    whole = not left.anything if explained is None else explained.share >= enough
    if not whole:
        return ("partly" if explained is None or explained.share >= PARTLY else "unexplained"), explained, left
    return ("family" if any(family.values()) else "attributed"), explained, left
