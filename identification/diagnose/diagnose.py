"""Close the loop: residual, missing effect, augmented model, error before and after."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from identification.assessment.pairs import agreed_order, exchangeable
from identification.assessment.prediction import Prediction, predict
from identification.assessment.reading_noise import ReadingNoise
from identification.diagnose.crossval import HeldOut, cross_validated, falls, folds, gained, rises, thirds
from identification.diagnose.distinguish import Distinguishability, distinguishability
from identification.diagnose.experiment import discriminating_experiment
from identification.diagnose.following import beyond, speed_shapes, thrust_shapes
from identification.diagnose.guess import Guess, best_guess
from identification.diagnose.initial import InitialModel, exportable, from_given, from_identification
from identification.diagnose.judgement import SLOW, STRONG, Smallest
from identification.diagnose.lack import Lack, with_turning
from identification.diagnose.learned.learn import Attempt, Learned, learn
from identification.diagnose.locate import locate
from identification.diagnose.search.candidates import Candidate, candidates
from identification.diagnose.search.fits import Fit, Searcher
from identification.diagnose.search.refits import evidence_over, refitted, screened
from identification.diagnose.selection import Judge, Selection, alternatives, nearest, select, without
from identification.diagnose.verdict import unnamed, verdict
from identification.fit.coordinates import CHANNELS, slowest
from identification.fit.experiment import Experiment
from identification.fit.noise import BLOCKS_A_TIME, Noise, blocks, independent, noise_from
from identification.fit.tachometer import Tachometer
from identification.fit.uncertainty import WIDEST, disagreement
from identification.gate.finding import Finding
from identification.gate.gate import Passed, passed
from identification.identify import Identification, off_bounds
from identification.logger import Logger
from identification.logger_fit import as_logged
from identification.roles import Fitted, Unseen, roles
from identification.static.at_rest import Knowledge
from vpp_fmu.campaign import Campaign
from vpp_fmu.kernel.plant import LIBRARY, plant
from vpp_fmu.kernel.types import Effect, Model
from vpp_fmu.native import Simulator
from vpp_fmu.native.memory import give_back
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig

CHANGED = ("attributed", "family", "partly", "learned")
"""Verdicts that put effects into the model."""


UNEXPLAINED = ("partly", "unexplained")
"""Verdicts that leave something unexplained, and come with a best guess."""


CLEARING = 3
"""Candidates of which the best one's residual tells the noise."""


@dataclass(frozen=True)
class Diagnosis:
    """What a campaign's residual was traced to.

    `quality`: what the gate found in the files, and in the fit of the identification. `logger`: the one that the records were
    corrected for. `base`: the model without any further
    effect, as it was identified. `final`: the one that ships. `given`: the model that was brought, as it was brought; None
    where the campaign was identified first. `before`, `after`: what base and set lack. `held_out_before`, `held_out_after`:
    cross-validation of the model before and of the one that ships. `unseen`: the validation record, opened when the model
    stood. `refuted`: why what was found does not ship, in words; "" where it does. `attempt`: at a term of no list, where no
    effect explains all. `best_guess`: the best candidate where something stays unexplained; None elsewhere, and where no
    candidate is left.
    """

    campaign: Campaign
    quality: tuple[Finding, ...]
    logger: Logger
    identification: Identification | None
    given: ParameterSet | None
    rig: Rig
    fitted: tuple[Fitted, ...]
    base: Fit
    noise: Noise
    reading_noise: ReadingNoise
    selection: Selection
    verdict: str
    before: Lack
    after: Lack
    apart: Distinguishability
    location: Mapping
    experiment: Record
    final: Fit
    held_out_before: HeldOut
    held_out_after: HeldOut
    unseen: Unseen | None
    refuted: str
    attempt: Attempt
    best_guess: Guess | None

    @property
    def learned(self) -> Learned | None:
        """The term of no list that ships."""
        return self.attempt.learned

    @property
    def left_out(self) -> tuple[str, ...]:
        """Effects that are there and do not ship, for nothing says that their start is another record's too."""
        if self.verdict not in CHANGED or self.refuted or self.learned:
            return ()
        return tuple(name for name in self.selection.final.effects if name not in self.final.effects)

    @property
    def fits(self) -> dict[str, Fit]:
        """The models to show: before and after where effects ship, else the only one."""
        return {"before": self.base, "after": self.final} if self.final.effects else {"model": self.base}

    @property
    def shown(self) -> Record:
        """The record to show: the unseen one where there is one, else the first that was fitted."""
        return self.unseen.record if self.unseen is not None else self.fitted[0].record

    @property
    def shown_name(self) -> str:
        """Of the record to show."""
        return self.unseen.name if self.unseen is not None else self.fitted[0].name

    def parameters(self, fit: Fit) -> ParameterSet:
        """A fit's parameters as a set that exports; a channel's lags that nothing tells apart stand with the slower first."""
        source = {"made_by": "vpp diagnose", "campaign": self.campaign.folder.name, "verdict": self.verdict}
        first = self.fitted[0].record
        source |= {"record_seconds": float(first.time[-1]), "sample_period": first.period, "rig": self.rig.summary()}
        source["logger"] = self.logger.summary()
        renamed = self.renamed(fit)
        values, std = ({renamed.get(n, n): v for n, v in each.items()} for each in (fit.values, fit.std()))
        return ParameterSet(exportable(fit.problem.model), source=source).replaced(values, std)

    def renamed(self, fit: Fit) -> dict[str, str]:
        """Names that a fit's lags are written under, where they are not its own."""
        return agreed_order(fit.problem.model, fit.values, self.fitted[0].record)

    @property
    def std(self) -> dict[str, float | None]:
        """Standard deviations of the parameters of the model that ships, under the names that they are written under."""
        renamed = self.renamed(self.final)
        return {renamed.get(n, n): std for n, std in self.final.std().items()}

    @property
    def lag_order(self) -> dict[str, str]:
        """For each channel, in words, what the order of its two lags rests on in the model that ships."""
        fit, record = self.final, self.fitted[0].record
        free = {u: exchangeable(fit.problem.model, fit.values, record, u) for u in CHANNELS}
        return {u: "exchangeable, the slower first" if same else "told by the data" for u, same in free.items()}

    def prediction(self, fit: Fit, record: Record) -> Prediction:
        """A fit's open-loop response to a record."""
        return predict(fit.problem.model, fit.values, record)

    def errors(self, fit: Fit) -> tuple[float, float | None]:
        """(thrust [N], speed [rpm]) rms on the unseen record, else cross-validated, of the base or the final model."""
        if self.unseen is not None:
            shown = self.prediction(fit, self.unseen.record)
            return shown.rmse_thrust, shown.rmse_omega
        held = self.held_out_before if fit is self.base else self.held_out_after
        return held.rmse_thrust, held.rmse_omega

    @property
    def explained(self) -> float | None:
        """Share of the thrust error beyond the noise that the final model removes, by `errors`; None where there is none."""
        before, after = (self.errors(fit)[0] ** 2 for fit in (self.base, self.final))
        beyond = before - self.noise.floor**2
        return (before - after) / beyond if self.final.effects and beyond > 0.0 else None


def diagnose(
    campaign: Campaign,
    library: Iterable[Effect] = LIBRARY,
    workers: int = 2,
    seed: int = 0,
    stage: Callable[[str], None] = lambda text: None,
    given: ParameterSet | None = None,
    smallest: float | None = None,
    smallest_speed: float | None = None,
    records: Mapping[str, Record] | None = None,
    accept: Iterable[str] = (),
    thorough: bool = True,
) -> Diagnosis:
    """Trace a campaign's residual to what the model lacks. `stage` is told what begins.

    The model is identified from the campaign first, or it is `given`, its effects part of the base. Fitted are the open-loop
    record, its repeat and further `records`; the validation record is opened when the model stands. `smallest` [N],
    `smallest_speed` [rpm]: least sizes of interest. `thorough`: where what was tried leaves something, more candidates are
    refitted, and a term of no list is looked for. BadInput where the campaign has no record to fit.

    The logger is estimated first, beside the base model. A missing effect may bias that estimate: where effects are found
    beside a logger that is not the contract's, it is estimated once more beside them, and if it differs, the campaign is
    diagnosed with it, too.
    """
    # The fits run side by side: threads in each would only fight.
    with threadpool_limits(1), ThreadPoolExecutor(workers) as pool:
        stage("quality")
        gate = passed(campaign, records, accept)
        library = tuple(library)
        present = (given.model.optional, library, given.values) if given else ()
        run = partial(_diagnosed, campaign, library, pool, seed, stage, given, Smallest(smallest, smallest_speed), thorough)
        stage("logger")
        first = as_logged(gate, *present)
        found = run(first)
        known = [e.name for e in library]
        named = [name for name in found.selection.final.effects if name in known]
        if first.logger.plain or not named:
            return found
        stage("logger")
        kept = given.model.optional if given else ()
        again = as_logged(gate, [*kept, *named], library, found.selection.final.values)
        if again.logger.agrees_with(first.logger):
            return found
        return min(found, run(again), key=lambda one: one.held_out_after.rmse_thrust)


def _diagnosed(
    campaign: Campaign,
    library: tuple[Effect, ...],
    pool: ThreadPoolExecutor,
    seed: int,
    stage: Callable[[str], None],
    given: ParameterSet | None,
    smallest: Smallest,
    thorough: bool,
    gate: Passed,
) -> Diagnosis:
    """The diagnosis of a campaign whose records have passed the `gate`, corrected for its logger."""
    stage("identify")
    groups, unseen = roles(gate.campaign, gate.further)
    fitted = tuple(one for group in groups for one in group)
    if given:
        at = from_given(gate.campaign, given, library, [one.record for one in fitted])
    else:
        at = from_identification(campaign, gate, library, seed)
    options = candidates(at.library, [one.record for one in fitted])
    stage("noise")
    give_back()
    searcher, base = _prepared(groups, at, options, pool)
    judge = Judge(searcher, base, smallest, gate.campaign.steps)
    searcher.lacking = judge.lack(base).score.gain
    stage("what can be told apart")
    apart = distinguishability(base, options, at.library, pool.map)
    give_back()

    def clearer(judge: Judge, fit: Fit) -> Judge | None:
        there = _clearer(groups, at, judge.searcher, judge.base, fit)
        return there and Judge(*there, smallest, gate.campaign.steps)

    judge, selection = select(judge, options, clearer, thorough, pool, stage)
    searcher, base = judge.searcher, judge.base
    give_back()
    before, after = (with_turning(judge.lack(fit), fit) for fit in (base, selection.final))
    word = verdict(base, selection.final, before, after, selection.family)
    identified = base.estimated(at.refinement, at.uncertainty)
    shipped = partial(_shipped, judge, at.knowledge, unseen)
    final, refuted = identified, ""
    if word in CHANGED:
        final, refuted = shipped(identified, base, selection.final, word == "partly")
    if refuted and (others := _not_refuted(selection, refuted, judge, base, before, partial(shipped, identified, base))):
        (selection, after, final), refuted = others, ""
        word = verdict(base, selection.final, before, after, selection.family)
    lacks = before if refuted else after
    word = unnamed(before) if refuted else word  # what was found is not it
    attempt = Attempt()
    if thorough and word in UNEXPLAINED and lacks.found:
        besides = [base, selection.final] if word == "partly" else [base]

        def learned_beside(beside: Fit) -> Attempt:
            return learn(searcher, beside, smallest, at.rig.scales, gate.campaign.steps, pool, stage)

        attempt, final = _learned(learned_beside, besides, judge, final, shipped)
    if attempt.learned:
        word, refuted, selection = "learned", "", _with(selection, attempt.learned)
        after = with_turning(judge.lack(selection.final), selection.final)
    experiment, guess = discriminating_experiment(_timed(at, final), seed, fitted[0].record.period), None
    if word in UNEXPLAINED:
        tried = partial(nearest, judge, selection, options, pool)
        guess = best_guess(judge, selection, (before, after), refuted, word == "partly", tried, experiment)
    shown = predict(final.problem.model, final.values, fitted[0].record)
    return Diagnosis(
        campaign=campaign,
        quality=at.identification.quality if at.identification else gate.findings,
        logger=gate.logger,
        identification=at.identification,
        given=given,
        rig=at.rig,
        fitted=fitted,
        base=identified,
        noise=searcher.experiments[0].noise,
        reading_noise=at.noise,
        selection=selection,
        verdict=word,
        before=before,
        after=after,
        apart=apart,
        location=locate([one.record for one in groups[0]], shown.thrust, shown.omega, shown.beta),
        experiment=experiment,
        final=final,
        held_out_before=judge.held_out(identified),
        held_out_after=judge.held_out(final),
        unseen=unseen,
        refuted=refuted,
        attempt=attempt,
        best_guess=guess,
    )


def _not_refuted(
    found: Selection, refuted: str, judge: Judge, base: Fit, before: Lack, shipped: Callable[[Fit, bool], tuple[Fit, str]]
) -> tuple[Selection, Lack, Fit] | None:
    """(selection, what it lacks, what ships) of what the fitted data do not tell from what was `refuted`, and which is not.

    What no fit took tells more than they do: the one of most evidence is taken, the others are its family.
    """
    standing, refused = [], {}
    for effect, name, other in alternatives(judge.searcher, found, judge):
        lack = with_turning(judge.lack(other.final), other.final)
        word = verdict(base, other.final, before, lack, other.family)
        if word not in CHANGED:
            continue
        final, why = shipped(other.final, word == "partly")
        if why:
            refused[name] = replace(other.judgements[name], refused=(why,))
        else:
            standing.append((effect, name, other, lack, final))
    if not standing:
        return None
    (effect, name, other, lack, final), *rest = standing
    family = {n: selection.final for e, n, selection, *_ in rest if e == effect}
    refused = {**other.refused, effect: replace(found.judgements[effect], refused=(refuted,)), **refused}
    return replace(other, rivals={**other.rivals, name: family}, refused=refused), lack, final


def _learned(
    learned_beside: Callable[[Fit], Attempt],
    besides: Sequence[Fit],
    judge: Judge,
    present: Fit,
    shipped: Callable[[Fit, Fit, Fit], tuple[Fit, str]],
) -> tuple[Attempt, Fit]:
    """(the attempt at a term of no list, what ships: the `present` model where none stands).

    Effects of the list that explain a part only may be what a wrong list makes of one effect that it lacks: so a term is
    looked for beside the base first, where it must explain more than they do, with less, and leave nothing; then beside them.
    Where a term leaves something, and one of another place or driver explains as much, neither is known to be what is there:
    it predicts what was fitted, and nobody knows what it does elsewhere.
    """
    known, attempt = besides[-1], Attempt()
    for beside in besides:
        attempt = learned_beside(beside)
        if not attempt.learned:
            continue
        term, leaves = attempt.learned.term.fit, judge.lack(attempt.learned.term.fit).found
        if beside is not known and (evidence_over(term, known) <= STRONG or leaves):
            attempt = attempt.but_refuted(f"{' + '.join(known.effects)} of the list explains as much, or not all is explained")
            continue
        if leaves and attempt.learned.elsewhere:
            attempt = attempt.but_refuted("it does not explain all, and a term of another place or driver explains as much")
            continue
        final, why = shipped(present, beside, term)
        if not why:
            return attempt, final
        attempt = attempt.but_refuted(why)
    return attempt, present


def _timed(at: InitialModel, final: Fit) -> Rig:
    """The rig with the time scale of the model that ships: what was missing may have bent the lags of the identification."""
    steps = at.identification.steps if at.identification else None
    told = off_bounds(final.problem.model, final.values, at.first, steps)
    return at.rig.timed(slowest(told, at.names))


def _with(selection: Selection, learned: Learned) -> Selection:
    """A selection whose final set is that beside which a term was learned, and the term."""
    kept, name = learned.beside.effects, learned.term.effect.name
    judgements = {n: j for n, j in selection.judgements.items() if n in kept} | {name: learned.judgement}
    rivals = {n: fits for n, fits in selection.rivals.items() if n in kept}
    return replace(selection, final=learned.term.fit, judgements=judgements, rivals=rivals)


def _shipped(
    judge: Judge, knowledge: Knowledge | None, unseen: Unseen | None, present: Fit, base: Fit, found: Fit, partly: bool = False
) -> tuple[Fit, str]:
    """(what ships, why what was `found` does not take the place of the `present` model, in words; "" where it does).

    An effect that begins where a record found it ships only where the step runs, which have starts of their own, confirm it."""
    for effect in (e for e in found.problem.model.effects if e.name in found.effects):
        if any(p.initial for p in effect.parameters):
            rest = without(judge.searcher, base, found, effect.name)
            if not (judge.runs and falls([], (judge.on_runs(rest) - judge.on_runs(found)).tolist())):
                found = rest
    if found.effects == base.effects:
        return present, ""
    final = _estimated(judge, knowledge, present, found)
    gone = [name for name in final.effects if not judge.matters(name, final)]
    why = NOTHING_LEFT.format(gone[0]) if gone else _refuted(judge, present, base, found, final, unseen, partly)
    return (present, why) if why else (final, "")


NOTHING_LEFT = "of {} nothing is left where it is estimated so that it predicts best what was not fitted"


def _estimated(judge: Judge, knowledge: Knowledge | None, present: Fit, found: Fit) -> Fit:
    """What was found, estimated as it predicts best what no fit saw; left-out folds and step runs choose, and nothing else.

    What the static map tells was made as wide as the records disagreed with it beside the base, for what was missing perhaps:
    it is weighed anew, unless thrust is for certain predicted worse then. Where folds or step runs are predicted worse than by
    the `present` model, an identification's estimates, with more weight on what is slow, take the place if they do better; if
    that does not help, and the effects show on the way alone, those beside the `present` map.
    """
    if knowledge is not None:
        agreed = found.agreed(knowledge)
        old, new = judge.held_out(found).thrust, judge.held_out(agreed).thrust
        times = [e.record.time for e in found.problem.experiments]
        found = found if rises(list(zip(times, old, new, strict=True))) else agreed
    if _worse(judge, found, present):
        again = found.as_identified(knowledge)
        better = judge.held_out(again).rmse_thrust < judge.held_out(found).rmse_thrust
        found = again if better or not _worse(judge, again, present) else found
        if _worse(judge, found, present) and not found.at_rest:
            held = found.with_map_of(present)
            found = held if not _worse(judge, held, present) else found
    return found


def _worse(judge: Judge, fit: Fit, present: Fit) -> bool:
    """Whether folds or step runs are predicted worse by a fit, certain or not."""
    if judge.held_out(fit).rmse_thrust > judge.held_out(present).rmse_thrust:
        return True
    return bool(judge.runs) and float(np.mean(judge.on_runs(fit) - judge.on_runs(present))) > 0.0


def _refuted(judge: Judge, shipped: Fit, base: Fit, found: Fit, final: Fit, unseen: Unseen | None, partly: bool = False) -> str:
    """Why a model must not take the place of the one that would ship without it, in words. `found`: the set where its
    likelihood is largest, `final`: as it is to ship.

    On left-out folds both predict thrust worse than the likelihood of `found` does without the effects (`base`), or `final`
    worse than what is `shipped`: for certain on folds or thirds, or in the step runs by more than the folds gain, certain or
    not (they go where the other commands hardly go, and a limit that was hardly reached may spoil some runs and no others), or
    at all in the figure that a report calls after: on the folds, or on the `unseen` record where there is one
    (`_refuted_by`). What explains a part only must carry over to whole thirds of the records, certain or not. Judged once."""
    before, best = judge.held_out(base), min((judge.held_out(fit) for fit in (found, final)), key=lambda h: h.rmse_thrust)
    if best.rmse_thrust > before.rmse_thrust and judge.held_out(found).gain(before)["thrust"] < 0.0:
        return _rises(FOLDED, before.rmse_thrust, best.rmse_thrust)
    for split in (folds, thirds):
        was, now = (judge.held_out(fit) if split is folds else cross_validated(fit, split) for fit in (shipped, final))
        worse = [(e.record.time, *pair) for e, *pair in zip(found.problem.experiments, was.thrust, now.thrust, strict=True)]
        if rises(worse) or (partly and now.rmse_thrust > was.rmse_thrust):
            return _rises(FOLDED, was.rmse_thrust, now.rmse_thrust)
        if partly and split is thirds and not falls(worse, (judge.on_runs(shipped) - judge.on_runs(final)).tolist()):
            return "a part of the explanation, and the thrust error where it was not fitted does not fall for certain"
    was, now = judge.held_out(shipped).rmse_thrust, judge.held_out(final).rmse_thrust
    if judge.runs:
        old, new = judge.on_runs(shipped), judge.on_runs(final)
        if np.mean(new - old) > was**2 - now**2:
            return _rises("thrust error of the step runs", *(float(np.sqrt(np.mean(e))) for e in (old, new)))
    if unseen is None:
        return _rises(FOLDED, was, now) if now > was else ""
    return _refuted_by(unseen, judge.searcher.experiments[0].noise, shipped, final)


def _refuted_by(unseen: Unseen, noise: Noise, shipped: Fit, final: Fit) -> str:
    """Why the unseen record refutes a model, in words: its thrust is predicted worse.

    A speed that was measured may confirm what the thrust's noise hides: where the evidence of both is strong, and that of the
    thrust alone not strong against it, a rise of the thrust's error refutes nothing."""
    was, now = (predict(fit.problem.model, fit.values, unseen.record) for fit in (shipped, final))
    if now.rmse_thrust <= was.rmse_thrust:
        return ""
    gain = gained(noise, was, now)
    if sum(gain.values()) > STRONG and gain["thrust"] > -STRONG:
        return ""
    return _rises(f"thrust error on {unseen.name}.csv", was.rmse_thrust, now.rmse_thrust)


FOLDED = "cross-validated thrust error"


def _rises(what: str, before: float, after: float) -> str:
    return f"{what} rises from {before:.4g} to {after:.4g} N"


def _prepared(groups: Sequence[Sequence[Fitted]], at: InitialModel, options: Sequence[Candidate], pool) -> tuple[Searcher, Fit]:
    """The search's experiments, and the base fitted to them.

    Where no repeat tells the noise, its colour is estimated anew from what the most promising candidate leaves: in the base's
    own residual what is missing passes for noise, and hides.
    """
    noise = _noise(groups, plant((), at.library), at.values, at.names, at)
    searcher, base = _based(groups, at, noise, at.values)
    if noise.verified:
        return searcher, base
    ranked = screened(searcher, base, options, pool)[:CLEARING]
    fits = list(pool.map(lambda pair: refitted(searcher, base, *pair), ranked))
    best = min(fits, key=Fit.bic, default=base)
    found = _clearer(groups, at, searcher, base, best) if evidence_over(best, base) > STRONG else None
    return found or (searcher, base)


def _clearer(
    groups: Sequence[Sequence[Fitted]], at: InitialModel, searcher: Searcher, base: Fit, fit: Fit
) -> tuple[Searcher, Fit] | None:
    """(searcher, base) on the noise that a fit leaves, where that is clearer than the noise so far; None where it is not, or
    where a repeat has told the noise, of which no model is a part."""
    noise = searcher.experiments[0].noise
    if noise.verified:
        return None
    found = _noise(groups, fit.problem.model, fit.values, fit.problem.coordinates.names, at)
    if not found.clearer_than(noise):
        return None
    again, base = _based(groups, at, found, base.values)
    again.points, again.lacking = searcher.points, searcher.lacking
    return again, base


def _based(
    groups: Sequence[Sequence[Fitted]], at: InitialModel, noise: Noise, values: Mapping[str, float]
) -> tuple[Searcher, Fit]:
    """A searcher on experiments of this noise, and the base fitted to them."""
    experiments = [Experiment(group, noise) for group in groups]

    def fitted(values: Mapping[str, float], factor: float) -> tuple[Searcher, Fit]:
        searcher = Searcher(experiments, at.names, at.knowledge, at.first, at.library, factor)
        return searcher, searcher.fit((), {}, (), values)

    searcher, base = fitted(values, WIDEST)
    if at.knowledge and (told := base.told(at.knowledge)):
        searcher, base = fitted(base.values, disagreement(told, base.uncertainty))
    return searcher, base


def _noise(
    groups: Sequence[Sequence[Fitted]], model: Model, values: Mapping[str, float], names: Sequence[str], at: InitialModel
) -> Noise:
    """From the differences of records of the same commands, where there are any; else from what a model leaves, whose `names`
    were fitted, less what of it follows the commands or is a trend: that is not noise, and a filter that took it for noise
    would hide it."""
    block, std = at.rig.scales.time_scale / BLOCKS_A_TIME, at.noise.std
    group = max(groups, key=len)
    if len(group) < 2:
        return _noise_left(group[0], model, values, names, block, std)
    outputs = Simulator(model).simulate(values, *group[0].record.run)
    errors = [outputs[:, 0] - one.record["thrust"] for one in group]
    share = np.sqrt(len(group) / (len(group) - 1.0))
    errors = [(e - np.mean(errors, axis=0)) * share for e in errors]
    (first, one), *others = [_heard(one.record, outputs[:, 1]) for one in group]
    between = [(one - np.interp(first.times, sensor.times, other)) / np.sqrt(2.0) for sensor, other in others if len(other)]
    return noise_from(group[0].record, errors, between if len(one) else [], block, SLOW, std, verified=True)


def _noise_left(
    one: Fitted, model: Model, values: Mapping[str, float], names: Sequence[str], block: float, std: float
) -> Noise:
    """Of a single record."""
    record, mean = one.record, blocks(one.record, block).mean
    white = replace(independent(1.0), block=block)
    outputs, fitted = Experiment([one], white).sensitivities(Simulator(model, names), values)
    error = outputs[:, 0] - record["thrust"]
    moved = np.zeros((len(mean(error)), len(names)))
    moved[np.isfinite(mean(error))] = fitted["thrust"]
    error, taken = beyond(lambda: thrust_shapes(values, record, outputs), mean, error, moved)
    sensor, residual = _heard(record, outputs[:, 1])
    heard = None
    if len(residual):

        def heard_shapes() -> Iterator[np.ndarray]:
            return (sensor.shows(s) / sensor.std for s in speed_shapes(values, record, outputs))

        residual, heard = beyond(heard_shapes, lambda readings: readings, residual, fitted["omega"])
    return noise_from(record, [error], [residual], block, SLOW, std, verified=False, taken=(taken, heard))


def _heard(record: Record, omega: np.ndarray) -> tuple[Tachometer | None, np.ndarray]:
    """(sensor, residual in units of its uncertainty) of a record's speed readings; none where it has none."""
    if "omega" not in record:
        return None, np.zeros(0)
    sensor = Tachometer(record)
    return sensor, (sensor.shows(omega) - sensor.measured) / sensor.std
