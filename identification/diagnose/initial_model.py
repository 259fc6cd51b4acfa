"""The initial model of a diagnosis: an identification of the campaign, or a given model.

The effects of a given model become part of the base: they are neither replaced nor dropped. Its smooth parameters are fitted to
the campaign: else effects would compensate outdated parameters. Its thresholds and forms are not changed.
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
from identification.diagnose.search.refits import added, evidence_over, screened
from identification.fit.coordinates import slowest
from identification.fit.experiment import CHANNELS, Experiment
from identification.fit.noise import BLOCKS_A_TIME, Noise, blocks, independent, noise_from
from identification.fit.refine import BASE_PARAMETERS, Refinement, refine
from identification.fit.tachometer import Tachometer
from identification.fit.uncertainty import WIDEST, Uncertainty, disagreement
from identification.gate.gate import Passed
from identification.identify import Identification, identify
from identification.roles import Fitted
from identification.static.at_rest import AtRest, Knowledge
from identification.static.static_map import StaticFit, static_fit
from identification.static.steady import with_steady_points
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
    """An optional effect as a permanent part of the base; its parameters keep their names. `origin`: the library effect."""

    origin: Effect | None = None

    def full(self, name: str) -> str:
        """The full name, as for the optional effect."""
        return f"{self.name}.{name}"


def always_on(effect: Effect) -> AlwaysOn:
    """The effect as part of each model that is built from a library."""
    own = {f.name: getattr(effect, f.name) for f in fields(Effect)}
    return AlwaysOn(**{**own, "off": None}, origin=effect)


def exportable(model: Model) -> Model:
    """The model with the library's effects in place of those that are always on."""
    return replace(model, effects=tuple(e.origin if isinstance(e, AlwaysOn) else e for e in model.effects))


@dataclass(frozen=True)
class InitialModel:
    """The library, scaled for the `rig`, and the `names` of the free base parameters. `refinement`: start values, with their
    `uncertainty`; `first`: values before any fit; `knowledge`: the prior from the steady points, None without any; `noise`: of
    one thrust reading; `identification`: the source of all this, None for a given model; `channels`: those that are fitted;
    `further`: base parameters of other channels that are free, too."""

    library: tuple[Effect, ...]
    names: tuple[str, ...]
    refinement: Refinement
    uncertainty: Uncertainty
    first: Mapping[str, float]
    knowledge: Knowledge | None
    rig: Rig
    noise: ReadingNoise
    identification: Identification | None = None
    channels: tuple[str, ...] = CHANNELS
    further: tuple[str, ...] = ()

    @property
    def values(self) -> Mapping[str, float]:
        """Start values of a search."""
        return self.refinement.values

    @property
    def fitted(self) -> tuple[str, ...]:
        """The base parameters that the fitted channels determine; if thrust alone is fitted, the speed is known."""
        if len(self.channels) > 1:
            return self.names
        speed = self.channels == ("omega",)
        return tuple(n for n in self.names if n.startswith("tau_omega") == speed or n in self.further)

    def of_channels(self, *channels: str, library: Sequence[Effect], values: Mapping[str, float]) -> "InitialModel":
        """The same for fits of some channels alone, with start values."""
        knowledge = self.knowledge if "thrust" in channels else None
        own = {n: values.get(n, v) for n, v in self.values.items()}
        refinement = replace(self.refinement, values=own)
        return replace(self, library=tuple(library), refinement=refinement, knowledge=knowledge, channels=channels)


def from_identification(campaign: Campaign, gate: Passed, library: Iterable[Effect], seed: int) -> InitialModel:
    """Identify the campaign, with further records, to start from; `gate`: the records that passed."""
    found = identify(campaign, seed=seed, gate=gate)
    names = tuple(found.refinement.names)
    rig, knowledge = found.parameters.rig, _knowledge(found.campaign, found.static, found.parameters.values)
    return InitialModel(
        sized(library, rig.scales), names, found.refinement, found.uncertainty, found.start, knowledge, rig, found.noise, found
    )


def from_given(campaign: Campaign, given: ParameterSet, library: Iterable[Effect], fitted: Sequence[Record]) -> InitialModel:
    """Fit a given model to the `fitted` records, to start from. BadInput if a record has no column for one of its inputs."""
    kept = given.model.optional
    for name in (u.name for e in given.model.effects for u in e.inputs if not u.clock):
        for record in (campaign.open_loop, campaign.repeat, campaign.validation):
            if record is not None and name not in record:
                raise BadInput(
                    record.source, f"column {name}", "no such column", f"a column for each input of {', '.join(kept)}"
                )
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
    settled = with_steady_points(campaign, slowest(given.values, given.values))
    knowledge = _knowledge(settled, static_fit(settled, given.values), given.values)
    found = refine(model, fitted, given.values, free, knowledge and knowledge(model, model.values(given.values), free))
    rig = replace(campaign.rig, scales=given.rig.scales)
    noise = reading_noise([predict(model, found.values, record) for record in fitted], campaign.static, found.values)
    return InitialModel(library, found.names, found, found.uncertainty, given.values, knowledge, rig, noise)


def _knowledge(campaign: Campaign, static: StaticFit | None, scales: Mapping[str, float]) -> Knowledge | None:
    """The prior from the steady points, normalised by `scales`."""
    return AtRest(campaign.static, static, scales) if static is not None else None


CLEARING = 3
"""Candidates that are refitted to estimate the noise from the residual of the best one."""


def prepared(groups: Sequence[Sequence[Fitted]], at: InitialModel, options: Sequence[Candidate], pool) -> tuple[Searcher, Fit]:
    """(searcher with the experiments, base fitted to them).

    Without a repeat record the noise colour is estimated again from the residual of the most promising candidate. The residual
    of the base would count a missing effect as noise.
    """
    noise = _noise(groups, plant((), at.library), at.values, at.names, at)
    searcher, base = fitted_base(groups, at, noise, at.values)
    if noise.verified:
        return searcher, base
    ranked = screened(searcher, base, options, pool)[:CLEARING]

    def refitted(pair) -> Fit:
        candidate, seen = pair
        return added(searcher, base, candidate, {**base.values, **seen.values}, base.slow_first)

    best = min(pool.map(refitted, ranked), key=Fit.bic, default=base)
    found = with_lower_noise(groups, at, searcher, base, best) if evidence_over(best, base) > MIN_EVIDENCE else None
    return found or (searcher, base)


def with_lower_noise(
    groups: Sequence[Sequence[Fitted]], at: InitialModel, searcher: Searcher, base: Fit, fit: Fit
) -> tuple[Searcher, Fit] | None:
    """(searcher, base) with the noise estimated from the residual of a fit, if that is lower than the present estimate; None if
    not, or with a repeat record, whose noise estimate needs no model."""
    noise = searcher.experiments[0].noise
    if noise.verified:
        return None
    found = noise_beside(groups, at, noise, fit)
    return with_noise(groups, at, searcher, base, found) if found.clearer_than(noise, at.channels) else None


def noise_beside(groups: Sequence[Sequence[Fitted]], at: InitialModel, noise: Noise, fit: Fit) -> Noise:
    """The noise of the fitted channels, estimated from the residual of a fit or from repeated records; else the present one."""
    found = _noise(groups, fit.problem.model, fit.values, fit.problem.coordinates.names, at)
    return replace(noise, speed=found.speed) if at.channels == ("omega",) else found


def with_noise(
    groups: Sequence[Sequence[Fitted]], at: InitialModel, searcher: Searcher, base: Fit, noise: Noise
) -> tuple[Searcher, Fit]:
    """(searcher, base) with another noise."""
    again, base = fitted_base(groups, at, noise, base.values)
    again.points = searcher.points
    return again, base


def with_slow_noise(groups: Sequence[Sequence[Fitted]], at: InitialModel, noise: Noise, base: Fit) -> Fit:
    """The base, estimated again if the thrust has slow noise. With independent noise it trusts the slow part of a record too
    much, and the steady points too little.

    Only for a base without a missing effect: without a repeat record, all of its residual counts as noise."""
    record = max(groups, key=len)[0].record
    if not noise.verified:
        outputs = Simulator(base.problem.model).simulate(base.values, *record.run)
        speed = _speed_residual(record, outputs[:, 1])[1]
        noise = noise_from(record, [outputs[:, 0] - record["thrust"]], [speed], noise.block, SLOW, noise.floor, verified=False)
    return fitted_base(groups, at, noise, base.values, agreed=True)[1] if noise.colour.corner else base


def fitted_base(
    groups: Sequence[Sequence[Fitted]], at: InitialModel, noise: Noise, values: Mapping[str, float], agreed: bool = False
) -> tuple[Searcher, Fit]:
    """(searcher on experiments with this noise, base fitted to them). `agreed`: the prior is as wide as its disagreement with
    the records requires. Else it is as wide as can be: steady points may include a missing effect, which would then fit worse.
    """
    experiments = [Experiment(group, noise, at.channels) for group in groups]

    # A missing effect biases the identified values, and a fit from them may end beside the minimum.
    starts = [values, {**values, **{n: at.first[n] for n in at.fitted}}]

    def fitted(factor: float) -> tuple[Searcher, Fit]:
        searcher = Searcher(experiments, at.fitted, at.knowledge, at.library, factor)
        return searcher, min((searcher.fit((), {}, (), start) for start in starts), key=Fit.bic)

    searcher, base = fitted(WIDEST)
    if agreed and at.knowledge and (prior := base.prior(at.knowledge)):
        starts.append(base.values)
        searcher, base = fitted(disagreement(prior, base.uncertainty))
    return searcher, base


def _noise(
    groups: Sequence[Sequence[Fitted]], model: Model, values: Mapping[str, float], names: Sequence[str], at: InitialModel
) -> Noise:
    """Noise from the differences of repeated records. Without any: from the residual of a model with fitted `names`."""
    block, std = at.rig.scales.time_scale / BLOCKS_A_TIME, at.noise.std
    group = max(groups, key=len)
    if len(group) < 2:
        return _noise_of_residual(group[0], model, values, list(dict.fromkeys([*at.names, *names])), block, std)
    outputs = Simulator(model).simulate(values, *group[0].record.run)
    errors = [outputs[:, 0] - one.record["thrust"] for one in group]
    share = np.sqrt(len(group) / (len(group) - 1.0))
    errors = [(e - np.mean(errors, axis=0)) * share for e in errors]
    speeds = [found for one in group if len((found := _speed_residual(one.record, outputs[:, 1]))[1])]
    between = [(speeds[0][1] - np.interp(speeds[0][0].times, s.times, other)) / np.sqrt(2.0) for s, other in speeds[1:]]
    return noise_from(group[0].record, errors, between, block, SLOW, std, verified=True)


def _noise_of_residual(
    one: Fitted, model: Model, values: Mapping[str, float], names: Sequence[str], block: float, std: float
) -> Noise:
    """Noise from the residual of a single record, after a regression on shapes of the commands and trends. Counted as noise,
    these would hide a missing effect."""
    record, mean = one.record, blocks(one.record, block).mean
    white = replace(independent(1.0), block=block)
    outputs, fitted = Experiment([one], white).sensitivities(Simulator(model, names), values)
    error = outputs[:, 0] - record["thrust"]
    sensitivities = np.zeros((len(mean(error)), len(names)))
    sensitivities[np.isfinite(mean(error))] = fitted["thrust"]
    error, removed = regress_out(lambda: thrust_shapes(values, record, outputs), mean, error, sensitivities)
    sensor, residual = _speed_residual(record, outputs[:, 1])
    speed_removed = None
    if len(residual):

        def shapes_at_sensor() -> Iterator[np.ndarray]:
            return (sensor.shows(s) / sensor.std for s in speed_shapes(values, record, outputs))

        residual, speed_removed = regress_out(shapes_at_sensor, lambda readings: readings, residual, fitted["omega"])
    return noise_from(record, [error], [residual], block, SLOW, std, verified=False, taken=(removed, speed_removed))


def _speed_residual(record: Record, omega: np.ndarray) -> tuple[Tachometer | None, np.ndarray]:
    """(sensor, residual in units of its uncertainty) of a record's speed readings; empty without readings."""
    if "omega" not in record:
        return None, np.zeros(0)
    sensor = Tachometer(record)
    return sensor, (sensor.shows(omega) - sensor.measured) / sensor.std
