"""The search in stages: first what is wrong with the speed, in the speed alone; then what is wrong with the thrust, given the
speed. Without a measured speed there is one stage.

Speed readings are precise: in one likelihood with the thrust they would pull its parameters away wherever the model of the
speed is not exact, and either channel could refuse what is plain in the other.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.diagnose.acceptance import Judge
from identification.diagnose.effort import Effort
from identification.diagnose.given_speed import given_speed, with_given_speed, with_speed_of
from identification.diagnose.initial_model import (
    InitialModel,
    always_on,
    fitted_base,
    noise_beside,
    prepared,
    with_lower_noise,
    with_noise,
)
from identification.diagnose.judgement import MIN_EVIDENCE, Judgement, Smallest
from identification.diagnose.lack_of_fit import LackOfFit, with_rotor_order
from identification.diagnose.search.candidates import Candidate
from identification.diagnose.search.fits import Fit, Searcher
from identification.diagnose.selection import Selection, select, without
from identification.diagnose.validation import CHANGED, unnamed, verdict
from identification.fit.noise import Noise
from identification.logger import SIGNIFICANT
from identification.roles import Fitted
from vpp_fmu.kernel.effects.measured_speed import AHEAD, WITHIN
from vpp_fmu.kernel.types import Effect
from vpp_fmu.native import Simulator
from vpp_fmu.native.memory import give_back
from vpp_fmu.record import Record

PITCH = ("tau_beta_1", "tau_beta_2")

AGAIN = "speed and thrust again, with the pitch that was found"
"""Name of a step of the search."""


@dataclass(frozen=True)
class Stage:
    """The search in some channels. `at`: its start; `options`: candidates; `groups`: the fitted records; `before`, `after`:
    lack of fit of the base, and of the selected set with its nuisances. `corroborated`: effects of the speed improve the
    thrust, too."""

    at: InitialModel
    groups: Sequence[Sequence[Fitted]]
    options: Sequence[Candidate]
    judge: Judge
    selection: Selection
    before: LackOfFit
    after: LackOfFit
    corroborated: bool = False

    @property
    def name(self) -> str:
        """ "speed", or "thrust" where the speed is known or was not measured."""
        return "speed" if self.at.channels == ("omega",) else "thrust"

    @property
    def word(self) -> str:
        """The verdict on these channels. Effects that explain less than half, but are corroborated, are a partial one."""
        found = self.selection
        word = verdict(found.base, found.final, self.before, self.after, found.family)
        return "partly" if word == "unexplained" and found.final.effects and self.corroborated else word

    @property
    def lacks(self) -> bool:
        """Whether something is missing if validation refutes the selected set: there is lack of fit, without or with it. In the
        speed the set itself shows it; in a single record of the thrust, slow noise may look like an effect."""
        found = "unexplained" in (unnamed(self.before), unnamed(self.after))
        return found or bool(self.name == "speed" and self.accepted.effects)

    @property
    def speed_ahead(self) -> float:
        """How far the known speed leads that of the rotor, s; 0 where it is not significant, or no speed is known."""
        fit = self.selection.whole
        share = fit.values.get(AHEAD, 0.0)
        significant = abs(share) > SIGNIFICANT * (fit.std().get(AHEAD) or 0.0)
        return share * max(float(one.record[WITHIN][0]) for group in self.groups for one in group) if significant else 0.0

    @property
    def accepted(self) -> Fit:
        """The selected set, if it explains most of the lack of fit; else the base."""
        return self.selection.final if self.word in CHANGED else self.selection.base

    def with_rival(self, effect: str, name: str, family: Mapping[str, Fit], why: str = "") -> "Stage":
        """The stage with a rival in the place of an effect, and its `family`. `why`: the effect is refused."""
        selection = self.selection
        fit = selection.final if name == effect else selection.rivals[effect][name]
        judgements, refused = selection.judgements, selection.refused
        if name != effect:
            judgements = {n: self.judge(n, fit, without(self.judge.searcher, selection.base, fit, n)) for n in fit.effects}
            refused = {**refused, effect: replace(selection.judgements[effect], refused=(why,))} if why else refused
        rivals = {e: fits for e, fits in selection.rivals.items() if e != effect} | {name: dict(family)}
        return self.with_final(fit, judgements, refused=refused, rivals=rivals)

    def less(self, effect: str, why: str) -> "Stage":
        """The stage without an effect, which is refused for a reason."""
        selection = self.selection
        rest = without(self.judge.searcher, selection.base, selection.final, effect)
        judgements = {n: j for n, j in selection.judgements.items() if n != effect}
        refused = {**selection.refused, effect: replace(selection.judgements[effect], refused=(why,))}
        return self.with_final(rest, judgements, refused=refused, rivals={n: {} for n in judgements})

    def on(
        self, groups: Sequence[Sequence[Fitted]], runs: Sequence[Record], at: InitialModel, speed_error: float = 0.0
    ) -> "Stage":
        """The same selection, fitted to records of another speed or logger, with their own noise."""
        old, selection = self.judge.searcher, self.selection
        searcher, base = with_noise(groups, at, old, selection.base, old.experiments[0].noise)
        noise = noise_beside(groups, at, old.experiments[0].noise, searcher.again(selection.whole))
        searcher, base = with_noise(groups, at, searcher, base, noise)
        judge = Judge(searcher, base, self.judge.smallest, runs, speed_error)
        final, whole = (searcher.again(fit) if fit.effects else base for fit in (selection.final, selection.whole))
        judgements = {n: judge(n, final, without(searcher, base, final, n)) for n in final.effects}
        rivals = {n: {name: searcher.again(fit) for name, fit in fits.items()} for n, fits in selection.rivals.items()}
        found = replace(selection, base=base, final=final, whole=whole, judgements=judgements, rivals=rivals)
        before, after = (with_rotor_order(judge.lack(fit), fit) for fit in (base, whole))
        return replace(self, at=at, groups=groups, judge=judge, selection=found, before=before, after=after)

    def with_final(self, final: Fit, judgements: Mapping[str, Judgement], **changes) -> "Stage":
        """The stage with another selected set."""
        found = replace(self.selection, final=final, whole=final, judgements=dict(judgements), **changes)
        return replace(self, selection=found, after=with_rotor_order(self.judge.lack(final), final))


def searched(
    groups: Sequence[Sequence[Fitted]],
    runs: Sequence[Record],
    at: InitialModel,
    options: Sequence[Candidate],
    smallest: Smallest,
    effort: Effort,
    pool,
    map_error: float = 0.0,
    found: Sequence[Stage] = (),
) -> list[Stage]:
    """The stages of a search: of the speed and of the thrust; of the thrust alone if no speed was measured. `runs`: step
    responses; `map_error` [rpm]: rms error of the map that gave the speed commands. If an effect of the speed takes the pitch,
    the speed is searched again with the pitch of the second stage. `found`: the stages with another logger; no new search where
    it would find no simpler set."""
    if not any("omega" in one.record and np.isfinite(one.record["omega"]).any() for group in groups for one in group):
        again = [s.on(groups, runs, at) for s in found]
        return again if _no_simpler(found, again) else [_stage(groups, runs, at, 0.0, options, smallest, effort, pool)]
    own, others = ([c for c in options if c.effect.in_speed == in_speed] for in_speed in (True, False))

    def of_speed(at: InitialModel, known: Stage | None = None) -> Stage:
        at = at.of_channels("omega", library=at.library, values={})
        return known.on(groups, [], at) if known else _stage(groups, [], at, 0.0, own, smallest, effort, pool, " of the speed")

    def known_from(first: Fit) -> InitialModel:
        """The start of the thrust's search. Effects that delay the readings of speed and of thrust are part of it. So is a
        shift of the known speed, within the uncertainty of its instants: it would look like an effect."""
        both = _keeping(at, first, lambda e: "thrust" in e.reading)
        both = replace(both, names=(*both.names, AHEAD), first={**both.first, AHEAD: 0.0})
        return both.of_channels("thrust", library=with_given_speed(both.library), values=first.values)

    def misfit(fit: Fit, readings: bool, noise: Noise, beside: Fit | None = None) -> float:
        """Half the deviance of the thrust, given the speed of a fit; without effects of its own, or with those of a fit."""
        searcher, base = fitted_base(with_speed_of(groups, fit, readings)[0], known_from(fit), noise, at.values)
        return 0.5 * (searcher.again(beside) if beside and beside.effects else base).deviance

    def by_thrust(speed: Stage) -> Stage:
        """The stage as the thrust prefers it. A late speed and a late reading of it are the same to the speed. The model of its
        sensor is approximate: an effect that is smaller than the sensor's uncertainty, where the speed shows no lack of fit
        without it, must improve the thrust, too."""
        noise, judge = speed.judge.searcher.experiments[0].noise, speed.judge
        for effect, rivals in list(speed.selection.rivals.items()):
            fits = {effect: speed.selection.final, **rivals}
            if len({next(e.reading for e in at.library if e.name == name) for name in fits}) < 2:
                continue
            misfits = {name: misfit(fit, True, noise) for name, fit in fits.items()}
            least = min(misfits.values())
            best = next(name for name in fits if misfits[name] <= least + MIN_EVIDENCE)
            family = {n: fit for n, fit in fits.items() if n != best and misfits[n] <= least + MIN_EVIDENCE}
            speed = speed.with_rival(effect, best, family)
        for effect, judged in list(speed.selection.judgements.items()):
            final = speed.selection.final
            rest = without(judge.searcher, speed.selection.base, final, effect)
            small = judge.within_sensor(judged) and not judge.lack(rest).significant
            if small and misfit(rest, False, noise) < misfit(final, False, noise) + MIN_EVIDENCE:
                speed = speed.less(effect, "it is smaller than the speed sensor's uncertainty, and does not improve the thrust")
        return speed

    def checked(speed: Stage, thrust: Stage) -> list[Stage]:
        """Both stages; whether the effects of the speed improve the thrust that its model predicts."""
        noise, found, own = thrust.judge.searcher.experiments[0].noise, speed.selection, thrust.selection.final
        gain = misfit(found.base, False, noise, own) - misfit(found.final, False, noise, own) if found.final.effects else 0.0
        return [replace(speed, corroborated=gain > MIN_EVIDENCE), thrust]

    def of_thrust(speed: Stage) -> Stage:
        return _stage(*of_known(speed), others, smallest, effort, pool, " of the thrust")

    def of_known(speed: Stage) -> tuple[list[list[Fitted]], list[Record], InitialModel, float]:
        first, noise = speed.selection.whole, speed.judge.searcher.experiments[0].noise
        # If the thrust does not follow what the readings show beyond the model, that is an error of the readings.
        readings = misfit(first, True, noise) <= misfit(first, False, noise) + MIN_EVIDENCE
        given = [record for run in runs for record in given_speed([run], first, readings)[0]]
        known, error = with_speed_of(groups, first, readings)
        return known, given, known_from(first), max(error, map_error)

    def with_pitch_of(thrust: Stage, speed: Stage) -> InitialModel:
        """The start of the speed's search with the pitch of the thrust's. Where the speed takes the pitch, its precise readings
        tell the lags of the pitch better than the thrust: they are free."""
        there = _keeping(at, thrust.selection.whole, lambda e: e.channels == ("beta",), PITCH)
        return replace(there, further=PITCH) if _takes_pitch(speed.selection.whole) else there

    if found:
        speed = by_thrust(of_speed(with_pitch_of(found[1], found[0]), found[0]))
        thrust = found[1].on(*of_known(speed))
        if _no_simpler(found, (speed, thrust)):
            return checked(speed, thrust)
    speed = by_thrust(of_speed(at))
    thrust = of_thrust(speed)
    if not _takes_pitch(speed.selection.whole) or not effort.allows(AGAIN):
        return checked(speed, thrust)
    again = by_thrust(of_speed(with_pitch_of(thrust, speed)))
    return checked(again, of_thrust(again))


def _no_simpler(found: Sequence[Stage], again: Sequence[Stage]) -> bool:
    """Whether another search would find no simpler set: the effects found are all accepted `again` with another logger, and
    leave no lack of fit with one of both."""
    accepted = all(not j.refused for s in again for j in s.selection.judgements.values())
    return accepted and any(each and not any(s.after.significant for s in each) for each in (found, again))


def _stage(groups, runs, at, speed_error, options, smallest, effort, pool, words: str = "") -> Stage:
    effort.stage(f"noise{words}")
    searcher, base = prepared(groups, at, options, pool)
    judge = Judge(searcher, base, smallest, runs, speed_error)
    give_back()

    def clearer(judge: Judge, fit: Fit) -> Judge | None:
        there = with_lower_noise(groups, at, judge.searcher, judge.base, fit)
        return there and Judge(*there, smallest, runs, speed_error)

    judge, found = select(judge, options, clearer, effort, pool, words)
    give_back()
    before, after = (with_rotor_order(judge.lack(fit), fit) for fit in (judge.base, found.whole))
    return Stage(at, groups, options, judge, found, before, after)


def _takes_pitch(fit: Fit) -> bool:
    """Whether the fitted speed depends on the pitch."""
    simulator = Simulator(fit.problem.model, PITCH)
    return any(simulator.sensitivities(fit.values, *e.record.run)[1][:, 1].any() for e in fit.problem.experiments)


def _keeping(at: InitialModel, fit: Fit, keep: Callable[[Effect], bool], names: Sequence[str] = ()) -> InitialModel:
    """The start of a search with some effects of a fit as part of the base; with them, and with base parameters `names`, at the
    values of the fit."""
    kept = {e.name for e in fit.problem.model.effects if e.name in fit.effects and keep(e)}
    library = tuple(always_on(e) if e.name in kept else e for e in at.library)
    own = {n: v for n, v in fit.values.items() if n in names or n.split(".")[0] in kept}
    return replace(at, library=library, refinement=replace(at.refinement, values={**at.values, **own}))


def joined(searcher: Searcher, base: Fit, fits: Sequence[Fit]) -> Fit:
    """The effects of a fit of each stage together, all parameters refitted to all channels."""
    fits = [fit for fit in fits if fit.effects]
    if not fits:
        return base
    values, forms, order = dict(base.values), {}, dict(base.slow_first)
    for fit in fits:
        own = (*fit.problem.coordinates.names, *fit.free, *fit.forms)
        values |= {n: v for n, v in fit.values.items() if n in own or n.split(".")[0] in fit.effects}
        forms |= fit.forms
        order |= fit.slow_first
    effects, free = ([x for fit in fits for x in part(fit)] for part in (lambda f: f.effects, lambda f: f.free))
    found = searcher.fit(effects, forms, free, values, order, thorough=False)
    return replace(found, idle=any(fit.idle for fit in fits))


def selection_of(searcher: Searcher, base: Fit, stages: Iterable[Stage]) -> Selection:
    """The selections of all stages as one of all channels."""
    stages = list(stages)
    final = joined(searcher, base, [s.accepted for s in stages])
    parts = [s.selection for s in stages]
    judgements = {n: j for part in parts for n, j in part.judgements.items() if n in final.effects}
    refused = {n: j for part in parts for n, j in part.refused.items()}
    rounds = [each for part in parts for each in part.rounds]
    rivals = {n: fits for part in parts for n, fits in part.rivals.items() if n in final.effects}
    return Selection(base, final, final, judgements, rounds, refused, rivals)


def verdict_of(stages: Iterable[Stage]) -> str:
    """The verdict on all channels: the weaker one."""
    words = {s.word for s in stages}
    if words & {"partly", "unexplained"}:
        return "partly" if words & {"partly", "attributed", "family"} else "unexplained"
    return next((word for word in ("family", "attributed") if word in words), "none")


def lack_of(stages: Sequence[Stage], when: str) -> LackOfFit:
    """Lack of fit "before" or "after" of all stages."""
    *speed, thrust = (getattr(s, when) for s in stages)
    if not speed:
        return thrust
    own = {n: getattr(speed[0], n) for n in ("speed", "thrust_equivalent", "speed_rpm", "least_speed")}
    return replace(thrust, **own)
