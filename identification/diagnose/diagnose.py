"""Diagnose a campaign: find the effects that the base model needs, add them, and compare the errors before and after."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from threadpoolctl import threadpool_limits

from identification.assessment.prediction import predict
from identification.diagnose.acceptance import Judge
from identification.diagnose.crossval import HeldOut
from identification.diagnose.diagnosis import Diagnosis
from identification.diagnose.distinguish import distinguishability
from identification.diagnose.effort import Effort
from identification.diagnose.experiment import discriminating_experiment
from identification.diagnose.guess import Guess, best_guess
from identification.diagnose.initial_model import (
    InitialModel,
    fitted_base,
    from_given,
    from_identification,
    with_slow_noise,
)
from identification.diagnose.judgement import FORM, MAJORITY, MIN_EVIDENCE, Smallest
from identification.diagnose.lack_of_fit import LackOfFit
from identification.diagnose.learned.learn import NAME, Attempt, Learned, better_than, learn, remains_beside
from identification.diagnose.locate import locate
from identification.diagnose.search.candidates import candidates
from identification.diagnose.search.fits import Fit
from identification.diagnose.search.refits import evidence_over
from identification.diagnose.selection import Selection, nearest, without
from identification.diagnose.stages import Stage, joined, lack_of, searched, selection_of, verdict_of
from identification.diagnose.validation import (
    CHANGED,
    NAMED,
    NOTHING_LEFT,
    UNEXPLAINED,
    Replacement,
    at_supported_thresholds,
    validated,
    worse_than_noise,
)
from identification.fit.coordinates import slowest
from identification.fit.uncertainty import NORMAL_95
from identification.gate.finding import Finding
from identification.gate.gate import Passed, passed
from identification.identify import off_bounds
from identification.logger import SIGNIFICANT, Logger
from identification.logger_fit import as_logged
from identification.logs.commands import FILE as SPEED_MAP
from identification.logs.speed_map import read_speed_map
from identification.roles import Fitted, Unseen, roles
from vpp_fmu.campaign import Campaign
from vpp_fmu.digits import number
from vpp_fmu.kernel.learned import PORTS
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.kernel.types import Effect
from vpp_fmu.native.memory import give_back
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig

if TYPE_CHECKING:
    from identification.power.diagnose import PowerDiagnosis

LATE = ("reading_delay", "sensor_lag")
"""Effects that read the thrust later than the speed."""

DELAYS = ("row_clock", "reading_delay", "speed_reading_delay", "speed_delay", "pitch_delay")
"""Effects that an estimate of the logger has itself."""


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
    `smallest_speed` [rpm]: minimum sizes of interest. `thorough`: terms of unknown form are learned if lack of fit remains, and
    compared with the named effects. `budget` [s]: no further step of the search begins after this time; the result then depends
    on the machine's speed. BadInput if the campaign has no record to fit.

    The logger is estimated first, beside the base model, which a missing effect may bias; then again beside the effects that
    are found. If it differs significantly, these are fitted with it, and the campaign is searched once more if this may give a
    simpler set.
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
        found = _searched(task, as_logged(gate, *present, each=pool.map))
        found = _with_logger_beside(task, gate, present[0] if present else (), found)
        done = _concluded(task, found)
        if done.learned and found.logger.rows:
            done = _with_logger_beside_term(task, gate, present[0] if present else (), done)
        return replace(done, not_tried=tuple(effort.not_tried), power=_power(done))


def _with_logger_beside(task: "_Task", gate: Passed, kept: Iterable[str], found: "_Searched") -> "_Searched":
    """The search, or a simpler one with the logger that is estimated beside the effects found. `gate`: the records before any
    correction; `kept`: effects of a given model."""
    final, effort, library = found.selection().final, task.effort, {e.name for e in task.library}
    named = [n for n in final.effects if n in library and n not in DELAYS]
    # A lag of the thrust may come from a logger that was estimated without the other effects, or the other way round.
    for beside in dict.fromkeys((tuple(n for n in named if n not in LATE), tuple(named))):
        if not beside or not effort.allows(f"another logger beside {' + '.join(beside)}"):
            continue
        effort.stage("logger")
        again = as_logged(gate, [*kept, *beside], task.library, final.values, task.pool.map)
        errors = SIGNIFICANT if len(beside) == len(final.effects) else NORMAL_95
        if not again.logger.agrees_with(found.logger, errors):
            return _simpler(found, _searched(task, again, found.stages))
    return found


def _with_logger_beside_term(task: "_Task", gate: Passed, kept: Iterable[str], done: Diagnosis) -> Diagnosis:
    """The diagnosis, or the one with the logger that is estimated beside its learned term, if that predicts held-out data
    better. Beside the base model, an offset of the logger may stand in for the term: one that follows the rate of the pitch
    hastens the thrust, as an offset does."""
    fit, term, effort = done.final, done.learned.term, task.effort
    beside, pinned = [n for n in fit.effects if n not in DELAYS], {term.effect.full(n) for n in term.lead.pinned}
    if not effort.allows(f"another logger beside {' + '.join(beside)}"):
        return done
    effort.stage("logger")
    again = as_logged(gate, [*kept, *beside], term.library, fit.values, task.pool.map, pinned)
    if again.logger.agrees_with(done.logger):
        return done
    return min(done, _concluded(task, _searched(task, again)), key=lambda d: d.held_out_after.rmse_thrust)


def _power(found: Diagnosis) -> "PowerDiagnosis | None":
    """The diagnosis of power, beside the final model; None for a plant without power."""
    parameters = found.parameters(found.final)
    if "power" not in {y.name for y in parameters.model.outputs}:
        return None
    from identification.power.diagnose import diagnose_power  # noqa: PLC0415 most campaigns measure no power

    records, unseen = {one.name: one.record for one in found.fitted}, found.unseen and found.unseen.record
    return diagnose_power(records, unseen, parameters, found.noise.block)


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
    `at`: the start of the search; `judge`: of all channels; `base`, `final`: the identified and the validated model."""

    gate: Passed
    at: InitialModel
    groups: Sequence[Sequence[Fitted]]
    unseen: Unseen | None
    judge: Judge
    stages: Sequence[Stage]
    base: Fit
    final: Fit
    refuted: str

    @property
    def logger(self) -> Logger:
        return self.gate.logger

    @property
    def held_out_after(self) -> HeldOut:
        return self.judge.held_out(self.final)

    @property
    def word(self) -> str:
        """The verdict. If validation refutes the selected set: whether something is missing."""
        if not self.refuted:
            return verdict_of(self.stages)
        return "unexplained" if any(s.lacks for s in self.stages) else "none"

    def selection(self, stages: Sequence[Stage] | None = None) -> Selection:
        return selection_of(self.judge.searcher, self.judge.base, self.stages if stages is None else stages)

    def validated(self, stages: Sequence[Stage]) -> "_Searched":
        """The same with these stages, their effects validated together."""
        found, partly = self.selection(stages).final, verdict_of(stages) == "partly"
        if found is self.judge.base:
            return replace(self, stages=stages, final=self.base, refuted="")
        final, why = self.shipped(self.base, self.judge.base, found, [s.accepted for s in stages], partly)
        return replace(self, stages=stages, final=final, refuted=why)

    def less(self, k: int, effect: str, why: str) -> "_Searched":
        """The same without an effect of stage k, which is refused for a reason."""
        return self.validated([*self.stages[:k], self.stages[k].less(effect, why), *self.stages[k + 1 :]])

    def shipped(self, present: Fit, beside: Fit, found: Fit, parts: Sequence[Fit], partly: bool = False) -> tuple[Fit, str]:
        """(final model, why held-out data refute `found`, fitted beside another set, in place of the `present` model). `parts`:
        the fits of the stages."""
        return validated(self.judge, self.at.knowledge, self.unseen, present, beside, found, parts, partly)


def _simpler(one: _Searched, other: _Searched) -> _Searched:
    """The one with fewer effects, if these explain everything and more effects do not, or if its held-out mean square error
    exceeds that of the other by at most the share FORM."""
    few, many = sorted((one, other), key=lambda s: (len(s.final.effects), s.word != "none", s.held_out_after.rmse_thrust))
    if few.word in NAMED and many.word not in NAMED:
        return few
    powers = [found.held_out_after.rmse_thrust**2 for found in (few, many)]
    return few if powers[0] <= (1.0 + FORM) * powers[1] else many


def _started(task: _Task, gate: Passed) -> tuple[list[list[Fitted]], Unseen | None, InitialModel]:
    """(the fitted records, the unseen one, the start of the search) of a campaign that passed the `gate`."""
    task.effort.stage("identify")
    groups, unseen = roles(gate.campaign, gate.further)
    if task.given:
        records = [one.record for group in groups for one in group]
        return groups, unseen, from_given(gate.campaign, task.given.without_power, task.library, records)
    return groups, unseen, from_identification(task.campaign, gate, task.library, task.seed)


def _searched(task: _Task, gate: Passed, known: Sequence[Stage] = ()) -> _Searched:
    """Search a campaign whose records passed the `gate`, corrected for its logger. `known`: its stages with another logger."""
    groups, unseen, at = _started(task, gate)
    records = [one.record for group in groups for one in group]
    options, runs = candidates(at.library, records), gate.campaign.steps
    map_error, speed_map = 0.0, gate.campaign.folder / SPEED_MAP
    if speed_map.exists():
        # The misfit of a fitted map differs from level to level, as that of a resolution does.
        options, map_error = [c for c in options if c.name != "speed_command_resolution"], read_speed_map(speed_map).rms
    give_back()
    stages = searched(groups, runs, at, options, task.smallest, task.effort, task.pool, map_error, known)
    if ahead := stages[-1].speed_ahead:  # the readings are as much earlier than their sensor says
        sensor = replace(gate.logger.sensor, delay=gate.logger.sensor.delay - ahead)
        gate = replace(gate, logger=replace(gate.logger, sensor=sensor)).changed(Logger(sensor=sensor).applied)
        groups, unseen, at = _started(task, gate)
    noises = [s.judge.searcher.experiments[0].noise for s in stages]
    searcher, base = fitted_base(groups, at, replace(noises[-1], speed=noises[0].speed), at.values, agreed=True)
    searcher.points = max(s.judge.searcher.points for s in stages)
    judge = Judge(searcher, base, task.smallest, runs)
    task.effort.stage("validate")
    identified = base.estimated(at.refinement, at.uncertainty)
    found = _Searched(gate, at, groups, unseen, judge, stages, identified, identified, "").validated(stages)
    while found.refuted and task.effort.allows("other effects in place of the refuted"):
        if (other := _other(found)) is None:
            break
        found = other
    return found


def _other(found: _Searched) -> _Searched | None:
    """The search without an effect that is too small, where that refutes the set; else with the best rival of an effect that
    held-out data refute, if they do not refute the rival, too; else without the effect of least evidence; None if it has only
    one. The fitted data did not distinguish the rivals: further valid ones form its family."""
    judged = {(k, n): j for k, s in enumerate(found.stages) for n, j in s.selection.judgements.items()}
    for k, name in judged if len(judged) > 1 else ():
        if found.refuted == NOTHING_LEFT.format(name):
            return found.less(k, name, found.refuted)
    pairs = [
        (k, effect, name) for k, s in enumerate(found.stages) for effect, fits in s.selection.rivals.items() for name in fits
    ]
    valid: list[tuple[int, str, str, _Searched]] = []
    for k, effect, name in sorted(pairs, key=lambda p: found.stages[p[0]].selection.rivals[p[1]][p[2]].bic()):
        other = found.stages[k].with_rival(effect, name, {}, found.refuted)
        tried = found.validated([*found.stages[:k], other, *found.stages[k + 1 :]])
        if not tried.refuted and tried.word in CHANGED:
            valid.append((k, effect, name, tried))
    if valid:
        (k, effect, name, best), *rest = valid
        family = {n: tried.stages[k].selection.final for i, e, n, tried in rest if (i, e) == (k, effect)}
        best.stages[k].selection.rivals[name] = family
        return best
    if len(judged) < 2:
        return None
    k, weakest = min(judged, key=lambda each: judged[each].evidence)
    return found.less(k, weakest, found.refuted)


def _concluded(task: _Task, found: _Searched) -> Diagnosis:
    """The diagnosis from a search: a term of unknown form is learned if lack of fit remains, and the next experiment chosen."""
    at, judge, final, refuted, word = found.at, found.judge, found.final, found.refuted, found.word
    attempt, with_term, doubts = Attempt(), None, {}
    if word in CHANGED and task.effort.thorough:
        found, doubts = _undoubted(task, found)
        final, refuted = found.final, found.refuted
        word = "partly" if doubts and not refuted else found.word
    missed, identified = "; ".join(doubts.values()), found.base
    selection, before, after = found.selection(), lack_of(found.stages, "before"), lack_of(found.stages, "after")
    open_stages = [s for s in found.stages if (s.lacks if refuted else s.after.significant) or s.name in doubts]
    # A coarse speed sensor hides a lack of fit that the thrust shows.
    unnamed = found.stages[-1] in open_stages and not found.stages[-1].accepted.effects
    tries = [(s, False) for s in open_stages] + [(s, True) for s in found.stages[:-1] if unnamed and s not in open_stages]
    if word == "none":
        identified = final = with_slow_noise(found.groups, at, judge.searcher.experiments[0].noise, found.base)
    if word not in UNEXPLAINED:
        final, missed = _seen_by_validation(found, selection, final)
        if missed:
            word, doubts = "partly" if final.effects else "unexplained", {found.stages[-1].name: missed}
            tries = [(s, True) for s in found.stages]
    if task.effort.thorough and word in UNEXPLAINED:
        attempt, with_term = _unknown_term(task, found, tries, selection)
    if with_term:
        attempt, stage = with_term.attempt, with_term.stage
        lack = stage.judge.lack(attempt.learned.stage_fit)
        own = lack_of([replace(s, after=lack) if s is stage else s for s in found.stages], "after")
        after, identified, final, missed = with_term.joint or own, found.base, with_term.final, with_term.missed
        selection, refuted, doubts = with_term.selection, "", {found.stages[-1].name: missed}
        word = "partly" if missed or (with_term.joint and after.significant) else "learned"
    fitted = tuple(one for group in found.groups for one in group)
    experiment, guess = discriminating_experiment(_timed(at, final), task.seed, fitted[0].record.period), None
    if word in UNEXPLAINED:
        guess = _guessed(task, found, open_stages, experiment)
    task.effort.stage("distinguishable effects")
    distinguishable = distinguishability(judge.base, [c for s in found.stages for c in s.options], at.library, task.pool.map)
    give_back()
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
        noise=judge.searcher.experiments[0].noise,
        reading_noise=at.noise,
        selection=selection,
        verdict=word,
        before=before,
        after=after,
        distinguishability=distinguishable,
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
        channels=_channels(found, with_term, refuted, doubts if missed else ()),
        missed=missed,
    )


def _seen_by_validation(found: _Searched, selection: Selection, final: Fit) -> tuple[Fit, str]:
    """(the final model, with thresholds that the validation record supports; why that record shows that it misses something,
    else "")."""
    if found.unseen is None:
        return final, ""
    judge = found.judge
    worse = partial(worse_than_noise, found.unseen, selection.final, judge.searcher.experiments[0].noise, least=judge.least())
    missed = worse(final)
    if missed and final.effects:
        given = Replacement(judge, found.base, judge.base, selection.final, final, found.unseen, False)
        if (narrowed := at_supported_thresholds(given)) and not worse(narrowed):
            return narrowed, ""
    return final, missed


def _undoubted(task: _Task, found: _Searched) -> tuple[_Searched, dict[str, str]]:
    """The search without the effects that stand in for something else; for each stage with such, in words.

    A learned term that fits better in the place of an effect shows that it stands in for one outside the library: a weaker one
    often corrects the law of a stronger one. An effect that is as much needed beside the term stays, as does the strongest one
    of a stage, which explains a part. The instants of the speed readings are uncertain where a learned term is missing in the
    speed: a delay of the thrust with less evidence than that is no finding."""
    doubts: dict[str, str] = {}
    missing = 0.0
    for k in range(len(found.stages)):
        judged = found.stages[k].selection.judgements
        weakest_first = sorted(found.stages[k].accepted.effects, key=lambda name, judged=judged: judged[name].evidence)
        for name in weakest_first:
            stage = found.stages[k]
            if name not in stage.accepted.effects:  # without a weaker effect, those left explain too little
                break
            if k and name in LATE and stage.selection.judgements[name].evidence < missing:
                found = found.less(k, name, "the instants of the speed readings are not known where the speed is not explained")
                continue
            step = f"a learned term in place of {name}"
            if not task.effort.allows(step):
                return found, doubts
            task.effort.stage(step)
            fit = stage.accepted
            rest = without(stage.judge.searcher, stage.selection.base, fit, name)
            if term := better_than(stage.judge, rest, fit, found.at.rig.scales, task.pool):
                missing = evidence_over(term.fit, fit)
                doubts[stage.name] = (
                    f"a learned term at {PORTS[term.lead.port].words} fits better than {name}, by {number(missing, 3)} nats"
                )
                if name != weakest_first[-1] and not remains_beside(term, stage.judge.searcher, rest, fit):
                    found = found.less(k, name, doubts[stage.name])
    return found, doubts


def _channels(found: _Searched, with_term: "_WithTerm | None", refuted: str, doubted: Iterable[str]) -> dict[str, dict]:
    """Verdict and names of effects of each stage. `doubted`: the stages that miss something without a lack of fit."""
    shown = {s.name: {"verdict": s.word, "effects": list(s.accepted.effects)} for s in found.stages}
    if refuted:
        shown = {s.name: {"verdict": "unexplained" if s.lacks else "none", "effects": []} for s in found.stages}
    for stage in shown.values() if with_term and with_term.joint and not with_term.joint.significant else ():
        stage["verdict"] = "none" if stage["verdict"] == "unexplained" else stage["verdict"]
    for name in doubted:
        shown[name]["verdict"] = "partly" if shown[name]["effects"] else "unexplained"
    return shown | ({with_term.stage.name: {"verdict": "learned", "effects": [NAME]}} if with_term else {})


@dataclass(frozen=True)
class _WithTerm:
    """A model with a learned term that may replace the present one. `stage`: in which it was learned; `missed`: why the
    validation record shows that something is missing beside it, else ""; `joint`: lack of fit in all channels beside it, None
    if the stage had a lack of fit itself."""

    attempt: Attempt
    stage: Stage
    final: Fit
    missed: str
    selection: Selection
    joint: LackOfFit | None


def _unknown_term(
    task: _Task, found: _Searched, tries: Iterable[tuple[Stage, bool]], selection: Selection
) -> tuple[Attempt, _WithTerm | None]:
    """(what was tried; a model with a learned term, None without). `tries`: stages, and whether they have no lack of fit
    themselves. A term there must explain most of that of all channels, and miss nothing on the validation record. A term that
    misses something there counts if no later one misses nothing."""
    attempt, terms, before = Attempt(), [], found.judge.lack(found.judge.base)
    for stage, is_closed in tries:
        if not task.effort.allows("a term of unknown form"):
            break
        here, final = _learned(task, found, stage, found.final)
        attempt = attempt if is_closed or attempt.learned else here
        if not here.learned:
            continue
        with_it = _with(selection, here.learned)
        final, missed = _seen_by_validation(found, with_it, final)
        joint = found.judge.lack(here.learned.term.fit) if is_closed else None
        if joint and (missed or (joint.significant and joint.missing > MAJORITY * before.missing)):
            continue
        terms.append(_WithTerm(here, stage, final, missed, with_it, joint))
        if not missed:
            break
    return attempt, next((term for term in terms if not term.missed), terms[0] if terms else None)


def _guessed(task: _Task, found: _Searched, open_stages: Sequence[Stage], experiment: Record) -> Guess | None:
    """The best guess in the last stage with lack of fit: the thrust, if both have."""
    stage = (open_stages or found.stages)[-1]
    selection, partly = stage.selection, stage.word == "partly" and not found.refuted
    tried = partial(nearest, stage.judge, selection, stage.options, task.effort, task.pool)
    return best_guess(stage.judge, selection, (stage.before, stage.after), found.refuted, partly, tried, experiment)


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


def _learned(task: _Task, found: _Searched, stage: Stage, present: Fit) -> tuple[Attempt, Fit]:
    """(attempt to learn a term in a stage; final model: the `present` one if no term is accepted).

    Effects that explain only a part may approximate one effect outside the library. So a term is learned beside the base first:
    it must have more evidence than they have and leave no lack of fit. Then a term is learned beside them. If lack of fit
    remains, and a term of another port or driver explains as much, both are rejected: they fit these records, but do not
    extrapolate.
    """
    judge, selection, known = stage.judge, stage.selection, stage.accepted
    others = [s.accepted for s in found.stages if s is not stage]
    for beside in [selection.base, known] if known.effects else [selection.base]:
        attempt = learn(judge, beside, found.at.rig.scales, task.pool, task.effort)
        if not attempt.learned:
            continue
        term = attempt.learned.term
        lack_remains = judge.lack(term.fit).significant
        if beside is not known and (evidence_over(term.fit, known) <= MIN_EVIDENCE or lack_remains):
            attempt = attempt.but_refuted(f"{' + '.join(known.effects)} explains as much, or lack of fit remains")
            continue
        if lack_remains and attempt.learned.elsewhere:
            attempt = attempt.but_refuted("lack of fit remains, and a term at another port or driver explains as much")
            continue
        if term.lead.driver == "time" and not (found.unseen or found.judge.runs):
            attempt = attempt.but_refuted("it depends on time, and no record of other commands shows that it holds there")
            continue
        together = joined(term.searcher(found.judge.searcher), found.judge.base, [*others, term.fit])
        without_it = joined(found.judge.searcher, found.judge.base, [*others, beside])
        final, why = found.shipped(present, without_it, together, [*others, term.fit])
        if not why:
            return attempt.joined(together), final
        attempt = attempt.but_refuted(why)
    return attempt, present


def _timed(at: InitialModel, final: Fit) -> Rig:
    """The rig with the time scale of the final model: the missing effects may have biased the identified lags."""
    steps = at.identification.steps if at.identification else None
    values = off_bounds(final.problem.model, final.values, at.first, steps)
    return at.rig.timed(slowest(values, at.names))


def _with(selection: Selection, learned: Learned) -> Selection:
    """A selection whose final set is the learned term and the effects beside it, those of the other stage too."""
    final, name = learned.term.fit, learned.term.effect.name
    judgements = {n: j for n, j in selection.judgements.items() if n in final.effects} | {name: learned.judgement}
    rivals = {n: fits for n, fits in selection.rivals.items() if n in final.effects}
    return replace(selection, final=final, judgements=judgements, rivals=rivals)
