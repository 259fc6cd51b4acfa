"""Where a diagnosis starts: at an identification of the campaign, or at a model that someone brings.

A model that is brought has its own effects; they become part of the base, which no candidate replaces and nothing drops.
Its smooth parameters are fitted to the campaign all the same: else an effect would be credited with what stale parameters
cost. Thresholds and forms stay as they are given.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.optimize import brentq

from identification.diagnose.search.fits import Fit
from identification.diagnose.uncertainty import uncertainty_of
from identification.fit.problem import Prior
from identification.fit.refine import BASE_PARAMETERS, refine
from identification.gate.gate import Passed
from identification.identify import Identification, identify
from identification.static.static_map import StaticFit, static_fit
from vpp_fmu.campaign import Campaign
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import plant, sized
from vpp_fmu.kernel.types import Effect, Model
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig

LOOSEST = 100.0
"""How much wider than its own scatter the static map's knowledge is taken at most: nothing is left of it then."""


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
class Starting:
    """Library, sized for the `rig`, and free base parameters of a search, `values` to start from and those before any fit
    (`first`), what the static map tells as it stands; `identification` where that is where the values come from."""

    library: tuple[Effect, ...]
    names: tuple[str, ...]
    values: Mapping[str, float]
    first: Mapping[str, float]
    knowledge: Prior | None
    rig: Rig
    identification: Identification | None = None


def from_identification(campaign: Campaign, gate: Passed, library: Iterable[Effect], seed: int) -> Starting:
    """Start at what an identification of the campaign, and of further records, finds; `gate`: what may be used of them."""
    found = identify(campaign, seed=seed, gate=gate)
    names = tuple(found.refinement.names)
    rig, knowledge = found.parameters.rig, _knowledge(found.static, names)
    return Starting(sized(library, rig.scales), names, found.refinement.values, found.start, knowledge, rig, found)


def from_given(campaign: Campaign, given: ParameterSet, library: Iterable[Effect], fitted: Sequence[Record]) -> Starting:
    """Start at a given model, fitted to the `fitted` records. BadInput where a record lacks an input that the model needs."""
    kept = given.model.optional
    for name in (u.name for e in given.model.effects for u in e.inputs if not u.clock):
        for record in (campaign.open_loop, campaign.repeat, campaign.validation):
            if record is not None and name not in record:
                raise BadInput(record.source, f"column {name}", "no such column", f"what {', '.join(kept)} of the model needs")
    library = tuple(always_on(e) if e.name in kept else e for e in sized(library, given.rig.scales))
    model = plant((), library)
    own = [e.full(p.name) for e in model.effects if e.name in kept for p in e.parameters if not p.choices]
    found = refine(model, fitted, given.values, [*BASE_PARAMETERS, *own])
    static = static_fit(campaign, given.values)
    rig = replace(campaign.rig, scales=given.rig.scales)
    return Starting(library, found.names, found.values, given.values, _knowledge(static, found.names), rig)


def _knowledge(static: StaticFit | None, names: Sequence[str]) -> Prior | None:
    """What the steady points tell of the map."""
    if static is None:
        return None
    kept = [k for k, n in enumerate(static.coefficients) if n in names]
    mean = np.array(list(static.coefficients.values()))[kept]
    chosen = tuple(n for n in static.coefficients if n in names)
    return Prior(chosen, mean, static.covariance[np.ix_(kept, kept)]) if kept else None


def disagreement(told: Prior, fit: Fit) -> float:
    """How much wider knowledge must be for records to agree with it, from 1 to LOOSEST. `fit`: to the records, hardly held by
    it.

    What is missing in a model bends records and steady points, and not alike. The factor f solves d' (C + f^2 S)^-1 d = k, d
    (k,) the differences, C and S the covariances of records and knowledge (Birge, 1932; Mandel and Paule, 1970): where the
    records tell little, knowledge keeps its word.
    """
    doubt, _ = uncertainty_of(fit, {})
    names = [n for n in told.names if n in doubt.names]
    own, its = [doubt.names.index(n) for n in names], [told.names.index(n) for n in names]
    away = doubt.values[own] - told.mean[its]
    records, known = doubt.covariance[np.ix_(own, own)], told.covariance[np.ix_(its, its)]

    def excess(log_factor: float) -> float:
        return float(away @ np.linalg.solve(records + np.exp(2.0 * log_factor) * known, away)) - len(names)

    most = float(np.log(LOOSEST))
    if not names or excess(0.0) <= 0.0:
        return 1.0
    return LOOSEST if excess(most) >= 0.0 else float(np.exp(brentq(excess, 0.0, most)))
