"""From a search's outcome to a verdict: attributed, family, partly, unexplained, none."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from identification.diagnose.evidence import Experiment
from identification.diagnose.explainable import error_power, noise_power, shared_power
from identification.diagnose.judge import judge, seen
from identification.diagnose.search import Fit, Searcher
from identification.diagnose.stepwise import Selection, without
from vpp_fmu.campaign import Campaign
from vpp_fmu.native import Simulator

NOTHING = 0.02
"""Share of the noise's power below which repeatable error is not worth a name."""

ATTRIBUTED = 0.9
"""Share of the explainable error that a named set must remove on unseen data; a surrogate removes a fifth to a half."""

NEARLY = 0.8
"""The same where the fitted records hold nothing more: the noise of unseen data blurs the share of a small error."""

ALIKE = 6.0
"""Effects whose BIC differs by less fit the data equally well (Kass and Raftery: below 'strong')."""


@dataclass(frozen=True)
class Left:
    """Repeatable thrust error of a fit below 10 Hz, as a share of the noise's power, with its standard error."""

    share: float
    error: float

    @property
    def anything(self) -> bool:
        """Whether there is something to explain."""
        return self.share > max(NOTHING, 2.0 * self.error)


class Remainder:
    """What a fit leaves unexplained, on the fitted records and on unseen ones."""

    def __init__(self, campaign: Campaign, held: list[Experiment], floor: float):
        self._record, self._repeat, self._held, self._floor = campaign.open_loop, campaign.repeat, held, floor

    def left(self, fit: Fit) -> Left:
        """Of the fitted records. Without a repeat, what exceeds the noise estimate."""
        predicted = _thrust(fit, self._record)
        if self._repeat is not None:
            power, error = shared_power(self._record, self._repeat, predicted)
        else:
            power, error = error_power(self._record, predicted) - self.noise, 0.1 * self.noise
        return Left(power / self._floor**2, error / self._floor**2)

    def explained(self, base: Fit, final: Fit) -> float | None:
        """Share of the explainable thrust error on unseen data that `final` removes; None where there is none to speak of."""
        before, after = (sum(error_power(e.record, _thrust(f, e.record)) for e in self._held) for f in (base, final))
        explainable = before - len(self._held) * self.noise
        if explainable < 2 * NOTHING * self._floor**2 * len(self._held):
            return None
        return float((before - after) / explainable)

    @property
    def noise(self) -> float:
        """Noise power below 10 Hz, N^2."""
        if self._repeat is not None:
            return noise_power(self._record, self._repeat)
        return 0.2 * self._floor**2


def _thrust(fit: Fit, record) -> np.ndarray:
    return Simulator(fit.evidence.model).simulate(fit.values, record.columns, record.steps)[:, 0]


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
            if (
                other.bic() - final.bic() < ALIKE
                and not judge(tried.candidate.name, other, rest, seen(other, held), seen(rest, held)).refused
            ):
                names.append(tried.candidate.name)
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


def verdict(selection: Selection, remainder: Remainder, family: Mapping[str, list[str]]) -> tuple[str, float | None, Left]:
    """(verdict, share of the explainable error removed on unseen data, what is left on the fitted records)."""
    left = remainder.left(selection.final)
    if not selection.final.effects:
        return ("unexplained" if left.anything else "none"), None, left
    explained = remainder.explained(selection.base, selection.final)
    whole = not left.anything if explained is None else explained >= (ATTRIBUTED if left.anything else NEARLY)
    if not whole:
        return "partly", explained, left
    return ("family" if any(family.values()) else "attributed"), explained, left
