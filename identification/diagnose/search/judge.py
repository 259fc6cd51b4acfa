"""What counts as evidence, and what the judgement of an effect rests on.

Every effect of a set is judged in the presence of the others: the set against the set without it. Evidence on the fitted
records ranks (BIC on whitened residuals); records that no fit has seen only refuse, channel by channel, since a clean speed
signal could buy an effect that worsens the thrust.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from identification.diagnose.evidence.whitened import Evidence, Experiment, Score
from identification.diagnose.search.fits import PLACES_ALONG, Fit
from identification.worth.quality import rmse
from vpp_fmu.native import Simulator

ENOUGH_BIC = 10.0
"""Difference of BIC that counts as very strong (Kass and Raftery, 1995)."""

ALIKE = 10.0
"""Effects whose BIC differs by less fit the data alike: only beyond it is evidence very strong (Kass and Raftery, 1995)."""

ENOUGH_HELD_OUT = 3.0
"""Log-likelihood that unseen records must gain in some channel, and may at most lose in none."""

WORTH, BESIDE = 0.008, 0.002
"""Share of what a set explains that each of its effects must explain, in a channel where another of the set acts and in one of
its own: a slightly wrong form of one leaves such a remainder, which a second, superfluous name would take."""

CHANNEL = {"pitch": "beta", "speed": "omega", "supply": "omega"}
"""The channel between whose lags an effect may stand, by the words of its name."""

SPILL = 0.5
"""Share of a gain in thrust that speed may lose: a thrust that fits weighs more, and the shared constants move towards it."""


NUISANCE = {"rotor_vibration": 0.05}
"""Effects that every rig has a little of, and the share of the noise's power from which one is worth a name."""


def channels(name: str) -> set[str]:
    """The channels whose lags an effect of this name may stand between; those of no such word change the thrust."""
    return {CHANNEL[word] for word in name.split("_") if word in CHANNEL} or {"thrust"}


@dataclass(frozen=True)
class Seen:
    """A fit on records it was not fitted to: score, and thrust and speed errors on the rows as they are [N], [rpm]."""

    score: Score
    rmse_thrust: float
    rmse_omega: float | None


def seen(fit: Fit, experiments: Sequence[Experiment], changes: Mapping[str, float] | None = None) -> Seen:
    """How a fit does on unseen experiments, with `changes` to its values."""
    simulator, values = Simulator(fit.evidence.model), {**fit.values, **(changes or {})}
    score = Evidence(fit.evidence.model, experiments, values, ()).score({}, simulator)
    thrust, omega = [], []
    for e in experiments:
        outputs = simulator.simulate(values, e.record.columns, e.record.steps)
        thrust.append(outputs[:, 0] - e.record["thrust"])
        omega += [outputs[:, 1] - e.record["omega"]] if "omega" in e.record else []
    return Seen(score, rmse(np.concatenate(thrust)), rmse(np.concatenate(omega)) if omega else None)


def best_place(fit: Fit, experiments: Sequence[Experiment]) -> tuple[dict[str, float], Seen]:
    """Of `Fit.places` the one that does best for unseen thrust, and how it does."""
    tried = [(place, seen(fit, experiments, place)) for place in fit.places]
    return min(tried, key=lambda pair: pair[1].score.squares["thrust"])


def seen_at_best(fit: Fit, experiments: Sequence[Experiment]) -> Seen:
    """How a fit does on unseen experiments where what it leaves open does best."""
    return best_place(fit, experiments)[1]


def placed(fit: Fit, experiments: Sequence[Experiment]) -> Fit:
    """The fit with what the fitted records leave open where unseen experiments want it, if they do."""
    place, there = best_place(fit, experiments)
    if there.score.gain(seen(fit, experiments).score)["thrust"] < ENOUGH_HELD_OUT:
        return fit
    for along, (low, high) in fit.left_open:
        name, rate = next(iter(along.items()))
        if at := (place.get(name, fit.values[name]) - fit.values[name]) / rate:
            step = (high - low) / (PLACES_ALONG - 1)
            place = place | _closest(fit, experiments, along, max(low, at - step), min(high, at + step))
    ends = {n: (min(low, place[n]), max(high, place[n])) for n, (low, high) in fit.thresholds.items()}
    values = {**fit.values, **place}
    score = fit.evidence.score(values, Simulator(fit.evidence.model))
    return replace(fit, values=values, score=score, thresholds=ends)


def _closest(fit: Fit, experiments: Sequence[Experiment], along: Mapping[str, float], low: float, high: float) -> dict:
    """Where along a direction, between two ends, unseen thrust is met best."""

    def squares(t: float) -> float:
        return seen(fit, experiments, fit.moved(along, t)).score.squares["thrust"]

    return fit.moved(along, float(minimize_scalar(squares, bounds=(low, high), method="bounded").x))


@dataclass(frozen=True)
class Judgement:
    """An effect of a set, judged against the set without it. `refused`: reasons in words; none: it stands."""

    effect: str
    delta_bic: float
    held_out_gain: Mapping[str, float]
    refused: tuple[str, ...]

    @property
    def artefact(self) -> str:
        """In words, why this is no physics of the rotor but of how it is measured; empty where it is not.

        What delays or bends the speed must show in the measured speed too; where that gets worse, it is the thrust's reading
        that is late.
        """
        if self.effect.startswith(("sensor_", "stand_")):
            return "in the reading of thrust (load cell, stand, amplifier, logger), not in the thrust itself"
        if self.effect.startswith("speed_") and self.held_out_gain.get("omega", 0.0) < -ENOUGH_HELD_OUT:
            return "thrust shows it and measured speed does not: the logger's thrust is late, not the rotor"
        return ""


def trifling(fit: Fit) -> bool:
    """Whether the last effect of a fit is one that every rig has, and too small here to be named."""
    effect = fit.effects[-1]
    if effect not in NUISANCE:
        return False
    evidence = fit.evidence
    off = {n: v for e in evidence.model.effects if e.name == effect for n, v in ((e.full(n), v) for n, v in e.off.items())}
    simulator, record = Simulator(evidence.model), evidence.experiments[0].record
    shown, quiet = (simulator.simulate({**fit.values, **v}, record.columns, record.steps)[:, 0] for v in ({}, off))
    return rmse(shown - quiet) ** 2 < NUISANCE[effect] * evidence.experiments[0].noise.floor ** 2


def judge(
    effect: str, with_it: Fit, without: Fit, held_with: Seen, held_without: Seen, base: Fit, complete: bool = True
) -> Judgement:
    """Judge one effect. A bound counts only for the effect's own parameters; `base`: the fit without any effect.

    `complete`: the set is the whole explanation. Where more may be missing, a right effect may lose in one channel what another
    one will give back, and only has to gain in all together.
    """
    delta = without.bic() - with_it.bic()
    gain = held_with.score.gain(held_without.score)
    refused = []
    if delta <= ENOUGH_BIC:
        refused.append(f"evidence too weak: BIC falls by {delta:.1f}, {ENOUGH_BIC:g} is asked for")
    if complete or sum(gain.values()) < ENOUGH_HELD_OUT:
        refused += _unseen(gain, held_with, held_without)
    shared = any(channels(effect) & channels(other) for other in with_it.effects if other != effect)
    if (share := _share(with_it, without, base)) < (worth := WORTH if shared else BESIDE):
        refused.append(f"explains {share:.1%} of what the set does, {worth:.1%} is asked for: another's form may leave as much")
    refused += [f"{name} ended on its bound" for name in with_it.at_bound if name.startswith(f"{effect}.")]
    return Judgement(effect, float(delta), gain, tuple(refused))


def _unseen(gain: Mapping[str, float], held_with: Seen, held_without: Seen) -> list[str]:
    """What unseen data have against an effect."""
    found = []
    if max(gain.values()) < ENOUGH_HELD_OUT:
        found.append(f"unseen data gain nothing: log-likelihood {max(gain.values()):.1f}, {ENOUGH_HELD_OUT:g} is asked for")
    if gain["thrust"] < -ENOUGH_HELD_OUT:
        found.append(f"worsens thrust on unseen data: log-likelihood {gain['thrust']:.1f}")
    if gain.get("omega", 0.0) < -max(ENOUGH_HELD_OUT, SPILL * gain["thrust"]):
        found.append(f"worsens speed on unseen data: log-likelihood {gain['omega']:.1f}")
    if held_with.rmse_thrust > 1.005 * held_without.rmse_thrust:
        found.append(f"thrust error on unseen data rises from {held_without.rmse_thrust:.4g} to {held_with.rmse_thrust:.4g} N")
    return found


def _share(with_it: Fit, without: Fit, base: Fit) -> float:
    """Of the fall of the squares from `base`, what is lost without the effect, in the channel that shows it best."""
    shares = [0.0]
    for channel, n in base.score.counts.items():
        least = with_it.score.squares[channel]
        fall = max(base.score.squares[channel], without.score.squares[channel]) - least
        if fall > ENOUGH_BIC * least / n:  # a channel in which nothing falls says nothing
            shares.append((without.score.squares[channel] - least) / fall)
    return max(shares)
