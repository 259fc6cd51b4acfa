"""Diagnose a campaign: find the effects that the base model needs, add them, and compare the errors before and after."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

from threadpoolctl import threadpool_limits

from identification.assessment.pairs import agreed_order, exchangeable
from identification.assessment.prediction import Prediction, predict
from identification.assessment.reading_noise import ReadingNoise
from identification.diagnose.acceptance import Judge
from identification.diagnose.crossval import HeldOut
from identification.diagnose.distinguish import Distinguishability, distinguishability
from identification.diagnose.effort import Effort
from identification.diagnose.experiment import discriminating_experiment
from identification.diagnose.guess import Guess, best_guess
from identification.diagnose.initial_model import (
    InitialModel,
    exportable,
    from_given,
    from_identification,
    prepared,
    with_lower_noise,
    with_slow_noise,
)
from identification.diagnose.judgement import FORM, MIN_EVIDENCE, Smallest
from identification.diagnose.lack_of_fit import LackOfFit, with_rotor_order
from identification.diagnose.learned.learn import Attempt, Learned, learn
from identification.diagnose.locate import locate
from identification.diagnose.search.candidates import Candidate, candidates
from identification.diagnose.search.fits import Fit
from identification.diagnose.search.refits import evidence_over
from identification.diagnose.selection import Selection, nearest, select, without_weakest
from identification.diagnose.validation import CHANGED, next_valid_alternative, unnamed, validated, verdict
from identification.fit.coordinates import CHANNELS, slowest
from identification.fit.noise import Noise
from identification.gate.finding import Finding
from identification.gate.gate import Passed, passed
from identification.identify import Identification, off_bounds
from identification.logger import SIGNIFICANT, Logger
from identification.logger_fit import as_logged, likely_loggers
from identification.power.diagnose import PowerDiagnosis, diagnose_power
from identification.roles import Fitted, Unseen, roles
from vpp_fmu.campaign import Campaign
from vpp_fmu.digits import number
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.kernel.types import Effect
from vpp_fmu.native.memory import give_back
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig

SHIFTS = ("row_clock", "reading_delay", "sensor_lag", "speed_delay", "pitch_delay")
"""Effects that shift a response in time, as an offset of the logger does."""

LATE = (*SHIFTS, "inflow_lag", "pitch_rate_feedthrough")
"""Effects that resemble a wrong offset. The last two do more: an offset is estimated both without and beside them."""

OTHERS = 2
"""Maximum number of other loggers with which a campaign is diagnosed."""

MOST_OF_LOGGER = 100.0
"""Evidence of effects (nats) from which no other logger is tried: ten times the difference of loggers not distinguished."""

UNEXPLAINED = ("partly", "unexplained")
"""Verdicts with an unexplained lack of fit; a best guess is added."""


@dataclass(frozen=True)
class Diagnosis:
    """Result of a diagnosis.

    `quality`: findings of the gate in the files, and in the fit of the identification. `logger`: the logger for which the
    records are corrected. `base`: the identified model, without further effects. `final`: the exported model. `given`: the
    given model before any fit; None if the campaign was identified first. `before`, `after`: lack of fit of the base and of the
    selected set. `held_out_before`, `held_out_after`: cross-validation of base and final model. `unseen`: the validation
    record, used only after the model is final. `refuted`: why validation refutes the selected set, else "". `attempt`: the
    search for a learned term, if no effect explains the lack of fit. `best_guess`: the best candidate if the lack of fit is not
    explained; None otherwise, or without candidates. `not_tried`: steps for which the time budget did not suffice. `power`:
    diagnosis of the electrical power, None without.
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
    not_tried: tuple[str, ...]
    power: PowerDiagnosis | None = None

    @property
    def learned(self) -> Learned | None:
        """The learned term of the final model."""
        return self.attempt.learned

    @property
    def left_out(self) -> tuple[str, ...]:
        """Accepted effects that are not in the final model, because their start value is specific to a record."""
        if self.verdict not in CHANGED or self.refuted or self.learned:
            return ()
        return tuple(name for name in self.selection.final.effects if name not in self.final.effects)

    @property
    def fits(self) -> dict[str, Fit]:
        """The models to show: before and after if effects are added, else the only one."""
        return {"before": self.base, "after": self.final} if self.final.effects else {"model": self.base}

    @property
    def shown(self) -> Record:
        """The record to show: the unseen one, else the first fitted one."""
        return self.unseen.record if self.unseen is not None else self.fitted[0].record

    @property
    def shown_name(self) -> str:
        """Name of the record to show."""
        return self.unseen.name if self.unseen is not None else self.fitted[0].name

    def parameters(self, fit: Fit) -> ParameterSet:
        """A fit's parameters as a set for export; exchangeable lags of a channel have the slower one first."""
        source = {"made_by": "vpp diagnose", "campaign": self.campaign.folder.name, "verdict": self.verdict}
        first = self.fitted[0].record
        source |= {"record_seconds": float(first.time[-1]), "sample_period": first.period, "rig": self.rig.summary()}
        source["logger"] = self.logger.summary()
        renamed = self.renamed(fit)
        values, std = ({renamed.get(n, n): v for n, v in each.items()} for each in (fit.values, fit.std()))
        found = ParameterSet(exportable(fit.problem.model), source=source).replaced(values, std)
        start = self.given or (self.identification and self.identification.parameters)
        return found.with_power_of(start) if start else found

    def renamed(self, fit: Fit) -> dict[str, str]:
        """Names under which a fit's lags are written, if they differ from its own."""
        return agreed_order(fit.problem.model, fit.values, self.fitted[0].record)

    @property
    def std(self) -> dict[str, float | None]:
        """Standard errors of the parameters of the final model, by the names under which they are written."""
        renamed = self.renamed(self.final)
        return {renamed.get(n, n): std for n, std in self.final.std().items()}

    @property
    def lag_order(self) -> dict[str, str]:
        """By channel, in words: how the order of its two lags in the final model is determined."""
        fit, record = self.final, self.fitted[0].record
        free = {u: exchangeable(fit.problem.model, fit.values, record, u) for u in CHANNELS}
        return {u: "exchangeable, the slower first" if same else "identified from the data" for u, same in free.items()}

    def prediction(self, fit: Fit, record: Record) -> Prediction:
        """Open-loop response of a fit to a record."""
        return predict(fit.problem.model, fit.values, record)

    def errors(self, fit: Fit) -> tuple[float, float | None]:
        """(thrust [N], speed [rpm]) rms on the unseen record, else cross-validated, of the base or the final model."""
        if self.unseen is not None:
            shown = self.prediction(fit, self.unseen.record)
            return shown.rmse_thrust, shown.rmse_omega
        held_out = self.held_out_before if fit is self.base else self.held_out_after
        return held_out.rmse_thrust, held_out.rmse_omega

    @property
    def explained(self) -> float | None:
        """Share of the mean square thrust error beyond the noise that the final model removes; None if there is none."""
        before, after = (self.errors(fit)[0] ** 2 for fit in (self.base, self.final))
        beyond = before - self.noise.floor**2
        return (before - after) / beyond if self.final.effects and beyond > 0.0 else None


def diagnose(
    campaign: Campaign,
    library: Iterable[Effect] = LIBRARY,
    workers: int = 2,
    seed: int = 0,
    stage: Callable[[str], None] = lambda text: None,
    progress: Callable[[int, int, str], None] = lambda done, total, best: None,
    given: ParameterSet | None = None,
    smallest: float | None = None,
    smallest_speed: float | None = None,
    records: Mapping[str, Record] | None = None,
    accept: Iterable[str] = (),
    thorough: bool = True,
    budget: float | None = None,
) -> Diagnosis:
    """Find the effects that the model of a campaign needs. `stage` is called with the name of each stage. `progress` is called
    within a search with the numbers of finished and of all candidates, and the name of the best so far.

    The model is identified from the campaign first, or it is `given`, its effects part of the base. The open-loop record, its
    repeat and further `records` are fitted; the validation record is used only after the model is final. `smallest` [N],
    `smallest_speed` [rpm]: minimum sizes of interest. `thorough`: if lack of fit remains, more candidates are refitted, and a
    term of unknown form is learned. `budget` [s]: no further step of the search begins after this time; the result then depends
    on the machine's speed. BadInput if the campaign has no record to fit.

    The logger is estimated first, beside the base model. Unless the verdict is then none, other loggers that are not
    distinguished from it are tried, too. A missing effect may bias this estimate. So the logger is estimated again beside the
    effects that are found. If it differs significantly, the campaign is diagnosed with it, too; if a found effect resembles an
    offset, a difference of one standard error suffices.
    """
    effort = Effort(budget, thorough, stage, progress)
    # The fits run in parallel, each with one thread of linear algebra.
    with threadpool_limits(1), ThreadPoolExecutor(workers) as pool:
        stage("quality")
        gate = passed(campaign, records, accept)
        library = tuple(library)
        present = (given.without_power.model.optional, library, given.without_power.values) if given else ()
        task = _Task(campaign, library, pool, seed, effort, given, Smallest(smallest, smallest_speed))
        stage("logger")
        likely = likely_loggers(gate, *present, each=pool.map)
        found = _searched(task, next(likely))
        for other in islice(likely, OTHERS) if _may_be_loggers(found) else ():
            if found.verdict == "none" or not effort.allows("another logger"):
                break
            if _missing(again := _searched(task, other)) < _missing(found):
                found = _simpler(found, again)
        known, kept = [e.name for e in library], given.without_power.model.optional if given else ()
        before: list[str] | None = None
        for resembling in (LATE, SHIFTS):
            named = [name for name in found.selection.final.effects if name in known]
            beside = [name for name in named if name not in resembling]
            if not named or beside == before or not effort.allows(f"another logger beside {' + '.join(named)}"):
                continue
            stage("logger")
            before, again = beside, as_logged(gate, [*kept, *beside], library, found.selection.final.values, pool.map)
            if not again.logger.agrees_with(found.logger, 1.0 if set(named) & set(LATE) else SIGNIFICANT):
                found = _simpler(found, _searched(task, again))
        done = _concluded(task, found)
        return replace(done, not_tried=tuple(effort.not_tried), power=_power(done))


def _power(found: Diagnosis) -> PowerDiagnosis | None:
    """The diagnosis of power, beside the final model."""
    records, unseen = {one.name: one.record for one in found.fitted}, found.unseen and found.unseen.record
    return diagnose_power(records, unseen, found.parameters(found.final), found.noise.block)


@dataclass(frozen=True)
class _Task:
    """Inputs of a diagnosis that do not depend on the logger."""

    campaign: Campaign
    library: tuple[Effect, ...]
    pool: ThreadPoolExecutor
    seed: int
    effort: Effort
    given: ParameterSet | None
    smallest: Smallest


@dataclass(frozen=True)
class _Searched:
    """A campaign, corrected for one logger and searched for effects of the library: a `Diagnosis` before a term is learned.
    `at`: the start of the search. `options`: the candidates. `shipped(present, base, found, partly)`: validation."""

    gate: Passed
    at: InitialModel
    groups: Sequence[Sequence[Fitted]]
    unseen: Unseen | None
    options: Sequence[Candidate]
    judge: Judge
    distinguishability: Distinguishability
    selection: Selection
    verdict: str
    before: LackOfFit
    after: LackOfFit
    base: Fit
    final: Fit
    refuted: str
    shipped: Callable[..., tuple[Fit, str]]

    @property
    def logger(self) -> Logger:
        return self.gate.logger

    @property
    def held_out_after(self) -> HeldOut:
        return self.judge.held_out(self.final)


def _may_be_loggers(found: _Searched) -> bool:
    """Whether another logger may explain the effects or the lack of fit. Loggers that are not distinguished differ by few nats,
    also in records longer than those of the logger's estimate."""
    selection = found.selection
    return found.verdict != "none" and evidence_over(selection.final, selection.base) < MOST_OF_LOGGER


def _missing(found: _Searched) -> tuple[int, bool]:
    """(number of effects, whether the verdict is not none). The diagnosis with the smaller value is preferred."""
    return len(found.final.effects), found.verdict != "none"


def _simpler(one: _Searched, other: _Searched) -> _Searched:
    """The one with fewer effects, if its held-out mean square error exceeds that of the other by at most the share FORM."""
    few, many = sorted((one, other), key=lambda found: (*_missing(found), found.held_out_after.rmse_thrust))
    powers = [found.held_out_after.rmse_thrust**2 for found in (few, many)]
    return few if powers[0] <= (1.0 + FORM) * powers[1] else many


def _searched(task: _Task, gate: Passed) -> _Searched:
    """Search a campaign whose records passed the `gate`, corrected for its logger."""
    task.effort.stage("identify")
    groups, unseen = roles(gate.campaign, gate.further)
    fitted = tuple(one for group in groups for one in group)
    if task.given:
        at = from_given(gate.campaign, task.given.without_power, task.library, [one.record for one in fitted])
    else:
        at = from_identification(task.campaign, gate, task.library, task.seed)
    options = candidates(at.library, [one.record for one in fitted])
    task.effort.stage("noise")
    give_back()
    searcher, base = prepared(groups, at, options, task.pool)
    judge = Judge(searcher, base, task.smallest, gate.campaign.steps)
    searcher.base_score_gain = judge.lack(base).score.gain
    task.effort.stage("distinguishable effects")
    distinguishable = distinguishability(base, options, at.library, task.pool.map)
    give_back()

    def clearer(judge: Judge, fit: Fit) -> Judge | None:
        there = with_lower_noise(groups, at, judge.searcher, judge.base, fit)
        return there and Judge(*there, task.smallest, gate.campaign.steps)

    judge, selection = select(judge, options, clearer, task.effort, task.pool)
    searcher, base = judge.searcher, judge.base
    give_back()
    before = with_rotor_order(judge.lack(base), base)
    identified = base.estimated(at.refinement, at.uncertainty)
    shipped = partial(validated, judge, at.knowledge, unseen)

    def checked(selection: Selection) -> tuple[LackOfFit, str, Fit, str]:
        """(lack of fit, verdict, final model, why it is refuted) of a set."""
        after = with_rotor_order(judge.lack(selection.final), selection.final)
        word = verdict(base, selection.final, before, after, selection.family)
        if word not in CHANGED:
            return after, word, identified, ""
        return after, word, *shipped(identified, base, selection.final, word == "partly")

    after, word, final, refuted = checked(selection)
    while refuted and task.effort.allows("other effects in place of the refuted"):
        if others := next_valid_alternative(selection, refuted, judge, base, before, partial(shipped, identified, base)):
            (selection, after, final), refuted = others, ""
            word = verdict(base, selection.final, before, after, selection.family)
        elif len(selection.final.effects) > len(base.effects) + 1:
            selection = without_weakest(judge, selection, refuted, task.pool)
            after, word, final, refuted = checked(selection)
        else:
            break
    return _Searched(
        gate=gate,
        at=at,
        groups=groups,
        unseen=unseen,
        options=options,
        judge=judge,
        distinguishability=distinguishable,
        selection=selection,
        verdict=unnamed(before) if refuted else word,
        before=before,
        after=after,
        base=identified,
        final=final,
        refuted=refuted,
        shipped=shipped,
    )


def _concluded(task: _Task, found: _Searched) -> Diagnosis:
    """The diagnosis from a search: a term of unknown form is learned if lack of fit remains, and the next experiment chosen."""
    at, judge, selection, after, attempt = found.at, found.judge, found.selection, found.after, Attempt()
    searcher, base, final, refuted, word = judge.searcher, judge.base, found.final, found.refuted, found.verdict
    lack = found.before if refuted else after
    if task.effort.thorough and word in UNEXPLAINED and lack.significant and task.effort.allows("a term of unknown form"):
        besides = [base, selection.final] if word == "partly" else [base]

        def learned_beside(beside: Fit) -> Attempt:
            return learn(searcher, beside, task.smallest, at.rig.scales, found.gate.campaign.steps, task.pool, task.effort)

        attempt, final = _learned(learned_beside, besides, judge, final, found.shipped)
    if attempt.learned:
        word, refuted, selection = "learned", "", _with(selection, attempt.learned)
        after = with_rotor_order(judge.lack(selection.final), selection.final)
    identified = found.base
    if word == "none":
        identified = final = with_slow_noise(found.groups, at, searcher.experiments[0].noise, found.base)
    fitted = tuple(one for group in found.groups for one in group)
    experiment, guess = discriminating_experiment(_timed(at, final), task.seed, fitted[0].record.period), None
    if word in UNEXPLAINED:
        tried = partial(nearest, judge, selection, found.options, task.effort, task.pool)
        guess = best_guess(judge, selection, (found.before, after), refuted, word == "partly", tried, experiment)
    shown = predict(final.problem.model, final.values, fitted[0].record)
    quality = at.identification.quality if at.identification else found.gate.findings
    narrowed = tuple(_narrowed_thresholds(selection.final, final, found.unseen))
    return Diagnosis(
        campaign=task.campaign,
        quality=(*quality, *narrowed),
        logger=found.logger,
        identification=at.identification,
        given=task.given,
        rig=at.rig,
        fitted=fitted,
        base=identified,
        noise=searcher.experiments[0].noise,
        reading_noise=at.noise,
        selection=selection,
        verdict=word,
        before=found.before,
        after=after,
        distinguishability=found.distinguishability,
        location=locate([one.record for one in found.groups[0]], shown.thrust, shown.omega, shown.beta),
        experiment=experiment,
        final=final,
        held_out_before=judge.held_out(identified),
        held_out_after=judge.held_out(final),
        unseen=None if narrowed else found.unseen,
        refuted=refuted,
        attempt=attempt,
        best_guess=guess,
        not_tried=tuple(task.effort.not_tried),
    )


def _narrowed_thresholds(before: Fit, after: Fit, unseen: Unseen | None) -> Iterator[Finding]:
    """A finding for each threshold whose interval the validation record narrows."""
    units = {p.name: p.unit for p in after.problem.model.parameters}
    for name, (low, high) in after.thresholds.items():
        (least, most), unit = before.thresholds.get(name, (low, high)), units[name]
        if unseen is not None and (least, most) != (low, high):
            fitted = f"the fitted records leave {number(least, 4)} to {number(most, 4)} {unit} open"
            supported = f"{unseen.name}.csv supports {number(low, 4)} to {number(high, 4)} {unit}, and is no longer unseen"
            cause, source = "few commands near the threshold", unseen.record.source
            yield Finding("narrowed", source, name, after.values[name], unit, f"{fitted}, {supported}", cause)


def _learned(
    learned_beside: Callable[[Fit], Attempt],
    besides: Sequence[Fit],
    judge: Judge,
    present: Fit,
    shipped: Callable[[Fit, Fit, Fit], tuple[Fit, str]],
) -> tuple[Attempt, Fit]:
    """(attempt to learn a term; final model: the `present` one if no term is accepted).

    Effects that explain only a part may approximate one effect outside the library. So a term is learned beside the base first:
    it must have more evidence than they have and leave no lack of fit. Then a term is learned beside them. If lack of fit
    remains, and a term of another port or driver explains as much, both are rejected: they fit these records, but do not
    extrapolate.
    """
    known, attempt = besides[-1], Attempt()
    for beside in besides:
        attempt = learned_beside(beside)
        if not attempt.learned:
            continue
        term, lack_remains = attempt.learned.term.fit, judge.lack(attempt.learned.term.fit).significant
        if beside is not known and (evidence_over(term, known) <= MIN_EVIDENCE or lack_remains):
            attempt = attempt.but_refuted(f"{' + '.join(known.effects)} explains as much, or lack of fit remains")
            continue
        if lack_remains and attempt.learned.elsewhere:
            attempt = attempt.but_refuted("lack of fit remains, and a term at another port or driver explains as much")
            continue
        final, why = shipped(present, beside, term)
        if not why:
            return attempt, final
        attempt = attempt.but_refuted(why)
    return attempt, present


def _timed(at: InitialModel, final: Fit) -> Rig:
    """The rig with the time scale of the final model: the missing effects may have biased the identified lags."""
    steps = at.identification.steps if at.identification else None
    values = off_bounds(final.problem.model, final.values, at.first, steps)
    return at.rig.timed(slowest(values, at.names))


def _with(selection: Selection, learned: Learned) -> Selection:
    """A selection whose final set is the learned term and the effects beside which it was learned."""
    kept, name = learned.beside.effects, learned.term.effect.name
    judgements = {n: j for n, j in selection.judgements.items() if n in kept} | {name: learned.judgement}
    rivals = {n: fits for n, fits in selection.rivals.items() if n in kept}
    return replace(selection, final=learned.term.fit, judgements=judgements, rivals=rivals)
