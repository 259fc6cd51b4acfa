"""Where a diagnosis starts: at an identification of the campaign, or at a model that someone brings.

A model that is brought has its own effects; they become part of the base, which no candidate replaces and nothing drops.
Its smooth parameters are fitted to the campaign all the same: else an effect would be credited with what stale parameters
cost. Thresholds and forms stay as they are given.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from identification.assessment.prediction import predict
from identification.assessment.reading_noise import ReadingNoise, reading_noise
from identification.diagnose.command_shapes import regress_out, speed_shapes, thrust_shapes
from identification.diagnose.judgement import MIN_EVIDENCE, SLOW
from identification.diagnose.search.candidates import Candidate
from identification.diagnose.search.fits import Fit, Searcher
from identification.diagnose.search.refits import evidence_over, refitted, screened
from identification.fit.experiment import Experiment
from identification.fit.noise import BLOCKS_A_TIME, Noise, blocks, independent, noise_from
from identification.fit.refine import BASE_PARAMETERS, Refinement, refine
from identification.fit.tachometer import Tachometer
from identification.fit.uncertainty import WIDEST, Uncertainty, disagreement
from identification.gate.gate import Passed
from identification.identify import Identification, identify
from identification.roles import Fitted
from identification.static.at_rest import AtRest, Knowledge
from identification.static.static_map import StaticFit, static_fit
from vpp_fmu.campaign import Campaign
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import plant, sized
from vpp_fmu.kernel.types import Effect, Model
from vpp_fmu.native import Simulator
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig


@dataclass(frozen=True)
class AlwaysOn(Effect):
    """An optional effect that a base model has for good; its parameters keep their names. `origin`: as the library has it."""

    origin: Effect | None = None

    def full(self, name: str) -> str:
        """As of the optional effect."""
        return f"{self.name}.{name}"


def always_on(effect: Effect) -> AlwaysOn:
    """The effect as part of every model that is built from a library."""
    own = {f.name: getattr(effect, f.name) for f in fields(Effect)}
    return AlwaysOn(**{**own, "off": None}, origin=effect)


def exportable(model: Model) -> Model:
    """The model with the library's own effects: what is always on is then an effect like any other."""
    return replace(model, effects=tuple(e.origin if isinstance(e, AlwaysOn) else e for e in model.effects))


@dataclass(frozen=True)
class InitialModel:
    """Library, sized for the `rig`, and free base parameters of a search; the `refinement` to start from, with its
    `uncertainty`, and the values before any fit (`first`); what the steady points tell, None where there are none;
    `noise` of one thrust reading; `identification` where all this is from one."""

    library: tuple[Effect, ...]
    names: tuple[str, ...]
    refinement: Refinement
    uncertainty: Uncertainty
    first: Mapping[str, float]
    knowledge: Knowledge | None
    rig: Rig
    noise: ReadingNoise
    identification: Identification | None = None

    @property
    def values(self) -> Mapping[str, float]:
        """Where a search starts."""
        return self.refinement.values


def from_identification(campaign: Campaign, gate: Passed, library: Iterable[Effect], seed: int) -> InitialModel:
    """Start at what an identification of the campaign, and of further records, finds; `gate`: what may be used of them."""
    found = identify(campaign, seed=seed, gate=gate)
    names = tuple(found.refinement.names)
    rig, knowledge = found.parameters.rig, _knowledge(gate.campaign, found.static, found.parameters.values)
    return InitialModel(
        sized(library, rig.scales), names, found.refinement, found.uncertainty, found.start, knowledge, rig, found.noise, found
    )


def from_given(campaign: Campaign, given: ParameterSet, library: Iterable[Effect], fitted: Sequence[Record]) -> InitialModel:
    """Start at a given model, fitted to the `fitted` records. BadInput where a record lacks an input that the model needs."""
    kept = given.model.optional
    for name in (u.name for e in given.model.effects for u in e.inputs if not u.clock):
        for record in (campaign.open_loop, campaign.repeat, campaign.validation):
            if record is not None and name not in record:
                raise BadInput(record.source, f"column {name}", "no such column", f"what {', '.join(kept)} of the model needs")
    library = tuple(always_on(e) if e.name in kept else e for e in sized(library, given.rig.scales))
    model = plant((), library)
    own = [
        e.full(p.name)
        for e in model.effects
        if e.name in kept
        for p in e.parameters
        if not p.choices and p.name not in e.rounds.values()
    ]
    free = [*BASE_PARAMETERS, *own]
    knowledge = _knowledge(campaign, static_fit(campaign, given.values), given.values)
    found = refine(model, fitted, given.values, free, knowledge and knowledge(model, model.values(given.values), free))
    rig = replace(campaign.rig, scales=given.rig.scales)
    noise = reading_noise([predict(model, found.values, record) for record in fitted], campaign.static, found.values)
    return InitialModel(library, found.names, found, found.uncertainty, given.values, knowledge, rig, noise)


def _knowledge(campaign: Campaign, static: StaticFit | None, scales: Mapping[str, float]) -> Knowledge | None:
    """What the steady points tell, normalised by these `scales`."""
    return AtRest(campaign.static, static, scales) if static is not None else None


CLEARING = 3
"""Candidates that are refitted to estimate the noise from the residual of the best one."""


def prepared(groups: Sequence[Sequence[Fitted]], at: InitialModel, options: Sequence[Candidate], pool) -> tuple[Searcher, Fit]:
    """(searcher with the experiments, base fitted to them).

    Without a repeat record the noise colour is estimated again from the residual of the most promising candidate: in the
    residual of the base a missing effect passes for noise.
    """
    noise = _noise(groups, plant((), at.library), at.values, at.names, at)
    searcher, base = _based(groups, at, noise, at.values)
    if noise.verified:
        return searcher, base
    ranked = screened(searcher, base, options, pool)[:CLEARING]
    fits = list(pool.map(lambda pair: refitted(searcher, base, *pair), ranked))
    best = min(fits, key=Fit.bic, default=base)
    found = with_lower_noise(groups, at, searcher, base, best) if evidence_over(best, base) > MIN_EVIDENCE else None
    return found or (searcher, base)


def with_lower_noise(
    groups: Sequence[Sequence[Fitted]], at: InitialModel, searcher: Searcher, base: Fit, fit: Fit
) -> tuple[Searcher, Fit] | None:
    """(searcher, base) with the noise estimated from the residual of a fit, if that is lower than the present estimate; None if
    not, and with a repeat record, whose noise estimate needs no model."""
    noise = searcher.experiments[0].noise
    if noise.verified:
        return None
    found = _noise(groups, fit.problem.model, fit.values, fit.problem.coordinates.names, at)
    if not found.clearer_than(noise):
        return None
    again, base = _based(groups, at, found, base.values)
    again.points, again.base_score_gain = searcher.points, searcher.base_score_gain
    return again, base


def _based(
    groups: Sequence[Sequence[Fitted]], at: InitialModel, noise: Noise, values: Mapping[str, float]
) -> tuple[Searcher, Fit]:
    """(searcher on experiments with this noise, base fitted to them)."""
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
    """Noise from the differences of repeated records; without any, from the residual of a model with fitted `names`, regressed
    on shapes of the commands and trends: a filter that took those for noise would hide a missing effect."""
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
    """Noise from the residual of a single record."""
    record, mean = one.record, blocks(one.record, block).mean
    white = replace(independent(1.0), block=block)
    outputs, fitted = Experiment([one], white).sensitivities(Simulator(model, names), values)
    error = outputs[:, 0] - record["thrust"]
    moved = np.zeros((len(mean(error)), len(names)))
    moved[np.isfinite(mean(error))] = fitted["thrust"]
    error, taken = regress_out(lambda: thrust_shapes(values, record, outputs), mean, error, moved)
    sensor, residual = _heard(record, outputs[:, 1])
    heard = None
    if len(residual):

        def heard_shapes() -> Iterator[np.ndarray]:
            return (sensor.shows(s) / sensor.std for s in speed_shapes(values, record, outputs))

        residual, heard = regress_out(heard_shapes, lambda readings: readings, residual, fitted["omega"])
    return noise_from(record, [error], [residual], block, SLOW, std, verified=False, taken=(taken, heard))


def _heard(record: Record, omega: np.ndarray) -> tuple[Tachometer | None, np.ndarray]:
    """(sensor, residual in units of its uncertainty) of a record's speed readings; none where it has none."""
    if "omega" not in record:
        return None, np.zeros(0)
    sensor = Tachometer(record)
    return sensor, (sensor.shows(omega) - sensor.measured) / sensor.std
