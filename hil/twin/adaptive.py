"""Build an adaptive twin from an identified plant: priors, residual band, tested parameters; and run it with the rig."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from scipy.special import stdtrit

from hil.twin.band import Band
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.kernel.scales import Scales
from vpp_fmu.kernel.twin import BROUGHT, WITHIN, adapted_by_default, plausible_change, sums, threshold, twin, watched
from vpp_fmu.kernel.twin.prediction import SAMPLE_TIME
from vpp_fmu.native.stepper import Stepper
from vpp_fmu.parameters import Estimate, ParameterSet

FALSE_ALARMS = 0.01
"""Most false alarms per hour."""

CERTAIN = 2.0
"""Least change of an adapted parameter that counts, in standard deviations; one test in 20 exceeds it by chance."""


def adaptable(parameters: ParameterSet, where: str, adapted: Sequence[str] | None = None) -> ParameterSet:
    """The plant with the effects that each twin includes, switched off if they are added. BadInput, with `where`, for an
    unknown name in `adapted`."""
    parameters = parameters.without_power
    model = parameters.model
    brought = tuple(e for e in LIBRARY if e.name in BROUGHT and e.name not in model.optional)
    order = {e.name: k for k, e in enumerate(LIBRARY)}
    sized = tuple(e.sized(Scales().with_values(parameters.values)) for e in brought)
    effects = list(model.effects)
    for e in sized:
        before = [k for k, other in enumerate(effects) if order.get(other.name, -1) < order[e.name]]
        effects.insert(max(before) + 1, e)
    wider = replace(model, effects=tuple(effects))
    names = [p.name for p in wider.parameters]
    for name in adapted or ():
        if name not in names:
            raise BadInput(where, "--adapt", name, f"one of {', '.join(names)}")
    return replace(parameters, model=wider)


def adaptive(
    parameters: ParameterSet,
    band: Band,
    adapted: Sequence[str] | None = None,
    false_alarms: float = FALSE_ALARMS,
    sample_time: float | None = None,
) -> ParameterSet:
    """The twin's model with its parameters: those of the plant, their standard deviations as priors, and the band's noises.

    `parameters`: from `adaptable`. The prior of a parameter that was not estimated is its plausible change. The same holds for
    lags: an estimate is valid for one kind of motion, and a real motor or actuator has another lag for each kind. `sample_time`
    s: between readings (default: the loop of the rig). KeyError: the plant does not have an adapted parameter.
    """
    values = parameters.values
    adapted = tuple(adapted or adapted_by_default(values))
    model = twin(parameters.model, adapted, sample_time or SAMPLE_TIME)
    # Few degrees of freedom: scale the model error so that 1.96 standard deviations cover 95 %, as Student's t does.
    steady = band.steady * float(stdtrit(band.freedom, 0.975)) / WITHIN
    noises = {"white": band.white, "slow": band.slow, "slow_time": band.slow_time, "steady": steady, "moving": band.moving}
    sample_time = model.values()["sample_time"]
    found = values | noises | {"threshold": threshold(false_alarms, sums(len(watched(parameters.model, adapted))), sample_time)}
    allowed, shows = {p.name: p for p in model.parameters}, watched(parameters.model, adapted)
    for name in adapted:
        size = plausible_change(parameters.model, name, values[name])
        estimate = parameters.estimates.get(name)
        prior = estimate.std if estimate and name in shows else None
        for kind, value in (("change", size), ("prior", prior or size)):
            own = allowed[f"{kind}.{name}"]
            found[own.name] = min(max(value, own.minimum), own.maximum)
    known = {name: e.std for name, e in parameters.estimates.items()}
    estimates = {name: Estimate(value, known.get(name), allowed[name].unit) for name, value in found.items()}
    return ParameterSet(model, estimates, parameters.source)


TRIED = 200
"""Steps before a run whose median gives the twin's computing time per tick."""


@dataclass(frozen=True)
class Adapted:
    """An adapted parameter: its initial value and a plausible change, in its unit."""

    start: float
    change: float
    unit: str
    description: str


class Adaptive:
    """The twin of `adaptive`, in this process; `outputs`: names of the values that `update` returns.

    `adapted`: adapted parameters by name, in the order of the outputs. `alarms`: (time [s], cause) of each; `microseconds`:
    computing time of a step.
    """

    def __init__(self, twin: ParameterSet, dt: float):
        self.outputs = tuple(y.name for y in twin.model.outputs)
        self.units = {y.name: y.unit for y in twin.model.outputs}
        values, parts = twin.values, {p.name: p for p in twin.model.parameters}
        self.adapted = {
            name: Adapted(values[name], values[f"change.{name}"], parts[name].unit, parts[name].description)
            for name in (y.removeprefix("adapted.") for y in self.outputs if y.startswith("adapted."))
        }
        self._causes = ("no parameter", *self.adapted)
        self._inputs = [u.start for u in twin.model.inputs]
        self._at = [[u.name for u in twin.model.inputs].index(name) for name in ("omega_ref", "beta_ref", "thrust", "omega")]
        self._alarm, self._points = self.outputs.index("alarm"), self.outputs.index("direction")
        self._stepper, self._dt, self._time = Stepper(twin.model, twin.values), dt, 0.0
        self.alarms: list[tuple[float, str]] = []
        self.microseconds = self._measured_time()

    def start(self, t: float, omega_ref: float, beta_ref: float, thrust: float, omega: float) -> None:
        """Start at t [s] from a settled rig: its commands [rpm, deg] and readings [N, rpm]."""
        self._stepper.start(self._given(omega_ref, beta_ref, thrust, omega))
        self._time, self._before, self._alarmed = t, None, False
        self.alarms.clear()

    def update(self, t: float, omega_ref: float, beta_ref: float, thrust: float, omega: float) -> list[float]:
        """Outputs for the readings [N, rpm] at t [s], just before these commands [rpm, deg] act. Missed ticks are computed with
        the previous commands and readings."""
        for _ in range(round((t - self._time) / self._dt) - 1 if self._before else 0):
            self._stepper.step(self._before, self._dt)
        self._before, self._time = self._given(omega_ref, beta_ref, thrust, omega), t
        outputs = self._stepper.step(self._before, self._dt)
        if outputs[self._alarm] > 0.5 and not self._alarmed:
            self.alarms.append((t, self._causes[int(outputs[self._points])]))
        self._alarmed = outputs[self._alarm] > 0.5
        return outputs

    def _given(self, *values: float) -> list[float]:
        given = list(self._inputs)
        for place, value in zip(self._at, values, strict=True):
            given[place] = value
        return given

    def _measured_time(self) -> float:
        took = []
        self.start(0.0, 4000.0, 4.0, 5.0, 4000.0)
        for k in range(1, TRIED + 1):
            began = time.perf_counter()
            self.update(k * self._dt, 4000.0, 4.0, 5.0, 4000.0)
            took.append(time.perf_counter() - began)
        return 1e6 * sorted(took)[TRIED // 2]
