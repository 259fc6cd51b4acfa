"""Where a diagnosis starts: at an identification of the campaign, or at a model that someone brings.

A model that is brought has its own effects; they become part of the base, which no candidate replaces and nothing drops.
Its smooth parameters are fitted to the campaign all the same: else an effect would be credited with what stale parameters
cost. Thresholds and forms stay as they are given.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

from identification.assessment.prediction import predict
from identification.assessment.reading_noise import ReadingNoise, reading_noise
from identification.fit.refine import BASE_PARAMETERS, Refinement, refine
from identification.fit.uncertainty import Uncertainty
from identification.gate.gate import Passed
from identification.identify import Identification, identify
from identification.static.at_rest import AtRest, Knowledge
from identification.static.static_map import StaticFit, static_fit
from vpp_fmu.campaign import Campaign
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import plant, sized
from vpp_fmu.kernel.types import Effect, Model
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
