"""Close the loop: residual, missing effect, augmented model, error before and after."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from identification.diagnose.crossval import Held
from identification.diagnose.distinguish import Distinguishability, distinguishability
from identification.diagnose.evidence.noise import BLOCKS_A_TIME, Noise, blocks, noise_from
from identification.diagnose.evidence.whitened import Experiment
from identification.diagnose.experiment import discriminating_experiment
from identification.diagnose.following import beyond, speed_shapes, thrust_shapes
from identification.diagnose.judgement import SLOW, STRONG
from identification.diagnose.lack import Lack, lack_of_fit
from identification.diagnose.learned.learn import Attempt, Learned, learn
from identification.diagnose.locate import locate
from identification.diagnose.roles import Fitted, Unseen, roles
from identification.diagnose.search.candidates import Candidate, candidates
from identification.diagnose.search.fits import Fit, Searcher
from identification.diagnose.search.refits import evidence_over, looks, refitted
from identification.diagnose.selection import Judge, Selection, select
from identification.diagnose.starting import LOOSEST, Starting, disagreement, exportable, from_given, from_identification
from identification.diagnose.uncertainty import standard_deviations
from identification.diagnose.verdict import verdict
from identification.fit.coordinates import CHANNELS
from identification.fit.tachometer import Tachometer
from identification.gate.finding import Finding
from identification.gate.gate import passed
from identification.identify import Identification, off_bounds, slowest
from identification.worth.pairs import agreed_order, exchangeable
from identification.worth.prediction import Prediction, predict
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


CLEARING = 3
"""Candidates of which the best one's residual tells the noise."""


@dataclass(frozen=True)
class Diagnosis:
    """What a campaign's residual was traced to.

    `quality`: what the gate found in the files, and in the fit of the identification. `base`: the model without any further
    effect, on the same likelihood as all others. `given`: the model that was brought, as it was brought; None where the
    campaign was identified first. `before`, `after`: what base and set lack. `held_before`, `held_after`: cross-validation of
    the model before and of the one that ships. `unseen`: the validation record, opened when the model stood. `refuted`: why
    what was found does not ship, in words; "" where it does. `attempt`: at a term of no list, where no effect explains all.
    """

    campaign: Campaign
    quality: tuple[Finding, ...]
    identification: Identification | None
    given: ParameterSet | None
    rig: Rig
    fitted: tuple[Fitted, ...]
    base: Fit
    noise: Noise
    selection: Selection
    verdict: str
    before: Lack
    after: Lack
    apart: Distinguishability
    location: Mapping
    experiment: Record
    held_before: Held
    held_after: Held
    unseen: Unseen | None
    refuted: str
    attempt: Attempt

    @property
    def learned(self) -> Learned | None:
        """The term of no list that ships."""
        return self.attempt.learned

    @property
    def final(self) -> Fit:
        """The model that ships: with the effects that stand and have not been refuted, else the base."""
        return self.selection.final if self.verdict in CHANGED else self.base

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
        renamed = self.renamed(fit)
        values = {renamed.get(n, n): v for n, v in fit.values.items()}
        doubt = standard_deviations(fit, renamed)
        return ParameterSet(exportable(fit.evidence.model), source=source).replaced(values, doubt)

    def renamed(self, fit: Fit) -> dict[str, str]:
        """Names that a fit's lags are written under, where they are not its own."""
        return agreed_order(fit.evidence.model, fit.values, self.fitted[0].record)

    @property
    def doubt(self) -> dict[str, float | None]:
        """Standard deviations of the parameters of the model that ships, under the names that they are written under."""
        return standard_deviations(self.final, self.renamed(self.final))

    @property
    def lag_order(self) -> dict[str, str]:
        """For each channel, in words, what the order of its two lags rests on in the model that ships."""
        fit, record = self.final, self.fitted[0].record
        free = {u: exchangeable(fit.evidence.model, fit.values, record, u) for u in CHANNELS}
        return {u: "exchangeable, the slower first" if same else "told by the data" for u, same in free.items()}

    def prediction(self, fit: Fit, record: Record) -> Prediction:
        """A fit's open-loop response to a record."""
        return predict(fit.evidence.model, fit.values, record)

    def errors(self, fit: Fit) -> tuple[float, float | None]:
        """(thrust [N], speed [rpm]) rms on the unseen record, else cross-validated, of the base or the final model."""
        if self.unseen is not None:
            shown = self.prediction(fit, self.unseen.record)
            return shown.rmse_thrust, shown.rmse_omega
        held = self.held_before if fit is self.base else self.held_after
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
    records: Mapping[str, Record] | None = None,
    accept: Iterable[str] = (),
) -> Diagnosis:
    """Trace a campaign's residual to what the model lacks. `stage` is told what begins.

    The model is identified from the campaign first, or it is `given`, its effects part of the base. Fitted are the open-loop
    record, its repeat and further `records`; the validation record is opened when the model stands. `smallest` [N]: the least
    size of interest. BadInput where the campaign has no record to fit.
    """
    with (
        threadpool_limits(1),
        ThreadPoolExecutor(workers) as pool,
    ):  # the fits run side by side: threads in each would only fight
        stage("identify")
        gate = passed(campaign, records, accept)
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
        judge = Judge(searcher, base, smallest)
        least = judge.least()
        before = lack_of_fit(base, least)
        searcher.lacking = before.score.gain
        stage("what can be told apart")
        apart = distinguishability(base, options, at.library, pool.map)
        give_back()
        selection = select(searcher, base, options, judge, lambda fit: lack_of_fit(fit, least).found, pool, stage)
        give_back()
        after = lack_of_fit(selection.final, least)
        word = verdict(base, selection.final, before, after, selection.family)
        refuted = _refuted(judge, base, selection.final, unseen) if word in CHANGED else ""
        word = "unexplained" if refuted else word  # what was found is not it
        attempt = Attempt()
        if word in ("unexplained", "partly"):
            beside = selection.final if word == "partly" else base
            attempt = learn(searcher, beside, smallest, at.rig.scales, gate.campaign.steps, pool, stage)
            attempt = attempt.confirmed(lambda fit: _refuted(judge, beside, fit, unseen))
        if attempt.learned:
            word, refuted, selection = "learned", "", _with(selection, attempt.learned)
            after = lack_of_fit(selection.final, least)
        final = selection.final if word in CHANGED else base
        shown = predict(final.evidence.model, final.values, fitted[0].record)
        return Diagnosis(
            campaign=campaign,
            quality=at.identification.quality if at.identification else gate.findings,
            identification=at.identification,
            given=given,
            rig=at.rig,
            fitted=fitted,
            base=base,
            noise=searcher.experiments[0].noise,
            selection=selection,
            verdict=word,
            before=before,
            after=after,
            apart=apart,
            location=locate([one.record for one in groups[0]], shown.thrust, shown.omega, shown.beta),
            experiment=discriminating_experiment(_timed(at, final), seed, fitted[0].record.period),
            held_before=judge.held(base),
            held_after=judge.held(final),
            unseen=unseen,
            refuted=refuted,
            attempt=attempt,
        )


def _timed(at: Starting, final: Fit) -> Rig:
    """The rig with the time scale of the model that ships: what was missing may have bent the lags of the identification."""
    return at.rig.timed(slowest(off_bounds(final.evidence.model, final.values, at.first), at.names))


def _with(selection: Selection, learned: Learned) -> Selection:
    """A selection whose final set is that beside which a term was learned, and the term."""
    kept, name = learned.beside.effects, learned.term.effect.name
    judgements = {n: j for n, j in selection.judgements.items() if n in kept} | {name: learned.judgement}
    family = {n: others for n, others in selection.family.items() if n in kept}
    return replace(selection, final=learned.term.fit, judgements=judgements, family=family)


def _refuted(judge: Judge, base: Fit, final: Fit, unseen: Unseen | None) -> str:
    """Why a final model must not take the base's place: it predicts thrust worse where it was not fitted. Judged once."""
    before, after = judge.held(base).rmse_thrust, judge.held(final).rmse_thrust
    if after > before and judge.held(final).gain(judge.held(base))["thrust"] < 0.0:
        return f"cross-validated thrust error rises from {before:.4g} to {after:.4g} N"
    if unseen is not None:
        shown = [predict(fit.evidence.model, fit.values, unseen.record).rmse_thrust for fit in (base, final)]
        if shown[1] > shown[0]:
            return f"thrust error on {unseen.name}.csv rises from {shown[0]:.4g} to {shown[1]:.4g} N"
    return ""


def _prepared(groups: Sequence[Sequence[Fitted]], at: Starting, options: Sequence[Candidate], pool) -> tuple[Searcher, Fit]:
    """The search's experiments, and the base fitted to them.

    Where no repeat tells the noise, its colour is estimated anew from what the most promising candidate leaves: in the base's
    own residual what is missing passes for noise, and hides.
    """
    noise = _noise(groups, plant((), at.library), at.values, at.rig)
    searcher, base = _based(groups, at, noise, at.values)
    if noise.verified:
        return searcher, base
    ranked = looks(searcher, base, options, pool)[:CLEARING]
    fits = list(pool.map(lambda pair: refitted(searcher, base, *pair), ranked))
    best = min(fits, key=Fit.bic, default=base)
    if evidence_over(best, base) <= STRONG:
        return searcher, base
    clearer = _noise(groups, best.evidence.model, best.values, at.rig)
    return _based(groups, at, clearer, base.values) if clearer.colour.innovation < noise.colour.innovation else (searcher, base)


def _based(groups: Sequence[Sequence[Fitted]], at: Starting, noise: Noise, values: Mapping[str, float]) -> tuple[Searcher, Fit]:
    """A searcher on experiments of this noise, and the base fitted to them; a run-in that was not settled gets no weight."""
    settled = 5.0 * slowest(at.values, at.names)
    experiments = [Experiment(group, noise) for group in groups]
    knowledge = at.knowledge and at.knowledge.loosened(LOOSEST)

    def fitted(values: Mapping[str, float]) -> tuple[Searcher, Fit]:
        searcher = Searcher(experiments, at.names, knowledge, at.first, at.library)
        return searcher, searcher.fit((), {}, (), values)

    searcher, base = fitted(values)
    skips = [settled if _unsettled(base, k, settled) else 0.0 for k in range(len(experiments))]
    if any(skips):
        experiments = [Experiment(group, noise, skip) for group, skip in zip(groups, skips, strict=True)]
        searcher, base = fitted(base.values)
    if at.knowledge:
        knowledge = at.knowledge.loosened(disagreement(at.knowledge, base))
        searcher, base = fitted(base.values)
    return searcher, base


RUN_IN = 4.0
"""Times by which the mean square of the whitened residual must be larger in the run-in than behind it for the record not to
have started settled; of its 50 or more rows, noise reaches 2 in less than one case in 10^5."""


def _unsettled(base: Fit, number: int, settled: float) -> bool:
    """Whether an experiment's thrust in its first `settled` s is far from the model, and behind it is not."""
    e = base.evidence.experiments[number]
    outputs = base.evidence.simulator.simulate(base.values, e.record.columns, e.record.steps)
    residual, first = e.thrust_residual(outputs[:, 0]), e.thrust_time < settled
    if first.sum() < 2 or (~first).sum() < 10 * first.sum() // 2:
        return False
    return bool(np.mean(residual[first] ** 2) > RUN_IN * np.mean(residual[~first] ** 2))


def _noise(groups: Sequence[Sequence[Fitted]], model: Model, values: Mapping[str, float], rig: Rig) -> Noise:
    """From the differences of records of the same commands, where there are any; else from what a model leaves, less what of it
    follows the commands or is a trend: that is not noise, and a filter that took it for noise would hide it."""
    block = rig.scales.time_scale / BLOCKS_A_TIME
    group = max(groups, key=len)
    outputs = Simulator(model).simulate(values, group[0].record.columns, group[0].record.steps)
    errors = [outputs[:, 0] - one.record["thrust"] for one in group]
    heard = [_heard(one.record, outputs[:, 1]) for one in group]
    if len(group) < 2:
        record = group[0].record
        errors = [beyond(lambda: thrust_shapes(values, record, outputs), blocks(record, block).mean, errors[0])]
        sensor, residual = heard[0]
        if len(residual):

            def heard_shapes() -> Iterator[np.ndarray]:
                return (sensor.shows(s) / sensor.std for s in speed_shapes(values, record, outputs))

            residual = beyond(heard_shapes, lambda readings: readings, residual)
        return noise_from(group[0].record, errors, [residual], block, SLOW, verified=False)
    share = np.sqrt(len(group) / (len(group) - 1.0))
    errors = [(e - np.mean(errors, axis=0)) * share for e in errors]
    (first, one), *others = heard
    between = [(one - np.interp(_times(first), _times(sensor), other)) / np.sqrt(2.0) for sensor, other in others if len(other)]
    return noise_from(group[0].record, errors, between if len(one) else [], block, SLOW, verified=True)


def _heard(record: Record, omega: np.ndarray) -> tuple[Tachometer | None, np.ndarray]:
    """(sensor, residual in units of its uncertainty) of a record's speed readings; none where it has none."""
    if "omega" not in record:
        return None, np.zeros(0)
    sensor = Tachometer(record)
    return sensor, (sensor.shows(omega) - sensor.measured) / sensor.std


def _times(sensor: Tachometer) -> np.ndarray:
    return sensor.rows_time(0.0, 0)[1]
