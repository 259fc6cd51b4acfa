"""Close the loop: residual, missing effect, augmented model, error before and after."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

from threadpoolctl import threadpool_limits

from identification.assessment.pairs import agreed_order, exchangeable
from identification.assessment.prediction import Prediction, predict
from identification.assessment.reading_noise import ReadingNoise
from identification.diagnose.acceptance import Judge
from identification.diagnose.crossval import HeldOut
from identification.diagnose.distinguish import Distinguishability, distinguishability
from identification.diagnose.experiment import discriminating_experiment
from identification.diagnose.guess import Guess, best_guess
from identification.diagnose.initial_model import (
    InitialModel,
    exportable,
    from_given,
    from_identification,
    prepared,
    with_lower_noise,
)
from identification.diagnose.judgement import MIN_EVIDENCE, Smallest
from identification.diagnose.lack_of_fit import LackOfFit, with_rotor_order
from identification.diagnose.learned.learn import Attempt, Learned, learn
from identification.diagnose.locate import locate
from identification.diagnose.search.candidates import candidates
from identification.diagnose.search.fits import Fit
from identification.diagnose.search.refits import evidence_over
from identification.diagnose.selection import Selection, nearest, select
from identification.diagnose.validation import CHANGED, next_valid_alternative, unnamed, validated, verdict
from identification.fit.coordinates import CHANNELS, slowest
from identification.fit.noise import Noise
from identification.gate.finding import Finding
from identification.gate.gate import Passed, passed
from identification.identify import Identification, off_bounds
from identification.logger import Logger
from identification.logger_fit import as_logged
from identification.roles import Fitted, Unseen, roles
from vpp_fmu.campaign import Campaign
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.kernel.types import Effect
from vpp_fmu.native.memory import give_back
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig

UNEXPLAINED = ("partly", "unexplained")
"""Verdicts that leave something unexplained, and come with a best guess."""


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
    before: LackOfFit
    after: LackOfFit
    distinguishability: Distinguishability
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
    searcher, base = prepared(groups, at, options, pool)
    judge = Judge(searcher, base, smallest, gate.campaign.steps)
    searcher.base_score_gain = judge.lack(base).score.gain
    stage("what can be told apart")
    told_apart = distinguishability(base, options, at.library, pool.map)
    give_back()

    def clearer(judge: Judge, fit: Fit) -> Judge | None:
        there = with_lower_noise(groups, at, judge.searcher, judge.base, fit)
        return there and Judge(*there, smallest, gate.campaign.steps)

    judge, selection = select(judge, options, clearer, thorough, pool, stage)
    searcher, base = judge.searcher, judge.base
    give_back()
    before, after = (with_rotor_order(judge.lack(fit), fit) for fit in (base, selection.final))
    word = verdict(base, selection.final, before, after, selection.family)
    identified = base.estimated(at.refinement, at.uncertainty)
    shipped = partial(validated, judge, at.knowledge, unseen)
    final, refuted = identified, ""
    if word in CHANGED:
        final, refuted = shipped(identified, base, selection.final, word == "partly")
    if refuted and (
        others := next_valid_alternative(selection, refuted, judge, base, before, partial(shipped, identified, base))
    ):
        (selection, after, final), refuted = others, ""
        word = verdict(base, selection.final, before, after, selection.family)
    lacks = before if refuted else after
    word = unnamed(before) if refuted else word  # what was found is not it
    attempt = Attempt()
    if thorough and word in UNEXPLAINED and lacks.significant:
        besides = [base, selection.final] if word == "partly" else [base]

        def learned_beside(beside: Fit) -> Attempt:
            return learn(searcher, beside, smallest, at.rig.scales, gate.campaign.steps, pool, stage)

        attempt, final = _learned(learned_beside, besides, judge, final, shipped)
    if attempt.learned:
        word, refuted, selection = "learned", "", _with(selection, attempt.learned)
        after = with_rotor_order(judge.lack(selection.final), selection.final)
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
        distinguishability=told_apart,
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
        term, leaves = attempt.learned.term.fit, judge.lack(attempt.learned.term.fit).significant
        if beside is not known and (evidence_over(term, known) <= MIN_EVIDENCE or leaves):
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
