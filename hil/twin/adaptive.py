"""What makes an identified plant an adaptive twin of its rig: the band of its residuals, how well it is known, what is watched."""

from collections.abc import Sequence

from scipy.stats import t

from hil.twin.band import Band
from vpp_fmu.kernel.ops import NUMBERS
from vpp_fmu.kernel.plant import BETA_REF, OMEGA_REF
from vpp_fmu.kernel.twin import WITHIN, adapted_by_default, plausible_change, sums, threshold, twin, watched
from vpp_fmu.kernel.types import start
from vpp_fmu.parameters import Estimate, ParameterSet

BORNE = 2.5
"""Standard deviations of the model's own steady error that half of a change which is watched for must exceed: a sum of
log-likelihood ratios falls while what there is stays below half of what it looks for, and 3 in 1000 places are further off."""

FALSE_ALARMS = 0.01
"""An hour, at most, while nothing changes."""


def adaptive(
    parameters: ParameterSet, band: Band, adapted: Sequence[str] | None = None, false_alarms: float = FALSE_ALARMS
) -> ParameterSet:
    """The twin's model with its parameters: the plant's by name, their standard deviations as the prior, the band's noises.

    `parameters`: of a plant with the effects that `vpp_fmu.kernel.twin.BROUGHT` names. What was not estimated is known to no
    more than a plausible change. KeyError names an adapted parameter that the plant has not.
    """
    values = parameters.values
    adapted = tuple(adapted or adapted_by_default(values))
    model = twin(parameters.model, adapted)
    # Known from few degrees of freedom, the model's error is larger than it was seen to be, for the same share of 95 %.
    steady = band.steady * float(t.isf(0.025, band.freedom)) / WITHIN
    noises = {"white": band.white, "slow": band.slow, "slow_time": band.slow_time, "steady": steady, "moving": band.moving}
    sample_time = model.values()["sample_time"]
    found = values | noises | {"threshold": threshold(false_alarms, sums(len(watched(parameters.model, adapted))), sample_time)}
    allowed = {p.name: p for p in model.parameters}
    for name in adapted:
        size = plausible_change(parameters.model, name, values[name])
        slope = abs(_settled_slope(parameters, name, 1e-3 * size))
        change = max(size, 2.0 * BORNE * steady / slope) if slope > 0.0 else size
        estimate = parameters.estimates.get(name)
        known = 0.0 if estimate is None or estimate.std is None or slope == 0.0 else estimate.std
        prior = known or size
        for kind, value in (("change", change), ("prior", prior)):
            own = allowed[f"{kind}.{name}"]
            found[own.name] = min(max(value, own.minimum), own.maximum)
    known = {name: e.std for name, e in parameters.estimates.items()}
    estimates = {name: Estimate(value, known.get(name), allowed[name].unit) for name, value in found.items()}
    return ParameterSet(model, estimates, parameters.source)


def _settled_slope(parameters: ParameterSet, name: str, step: float) -> float:
    """N for each unit of a parameter, settled in the middle of the rig's range; next to 0 for what only acts on the way."""
    rig, model = parameters.rig, parameters.model
    at = {OMEGA_REF.name: 0.5 * sum(rig.speed), BETA_REF.name: 0.5 * sum(rig.pitch)}
    inputs = model.measured_inputs | at

    def thrust(value: float) -> float:
        values = parameters.values | {name: value}
        return float(start(model, NUMBERS, inputs, values)[0]["thrust"])

    value = parameters.values[name]
    slope = (thrust(value + step) - thrust(value - step)) / (2.0 * step)
    return slope if abs(slope) * step > 1e-9 * parameters.values["thrust_scale"] else 0.0
