"""What makes an identified plant an adaptive twin of its rig: the band of its residuals, how well it is known, what is watched;
and that twin beside a rig, a sample a tick."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from scipy.stats import t

from hil.twin.band import Band
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.kernel.scales import Scales
from vpp_fmu.kernel.twin import BROUGHT, WITHIN, adapted_by_default, plausible_change, sums, threshold, twin, watched
from vpp_fmu.kernel.twin.prediction import SAMPLE_TIME
from vpp_fmu.native.stepper import Stepper
from vpp_fmu.parameters import Estimate, ParameterSet

FALSE_ALARMS = 0.01
"""An hour, at most, while nothing changes."""

CERTAIN = 2.0
"""Standard deviations by which an adapted parameter has moved from where it started for that to count: where nothing has
changed one look in 20 finds as much."""


def adaptable(parameters: ParameterSet, where: str, adapted: Sequence[str] | None = None) -> ParameterSet:
    """The parameters for the same plant with the effects that a twin has in any case, off unless they are there. BadInput, told
    of `where`, for a name to be adapted that it doesn't have."""
    model = parameters.model
    brought = tuple(e for e in LIBRARY if e.name in BROUGHT and e.name not in model.optional)
    order = {e.name: k for k, e in enumerate(LIBRARY)}
    sized = tuple(e.sized(Scales().following(parameters.values)) for e in brought)
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
    """The twin's model with its parameters: the plant's by name, their standard deviations as the prior, the band's noises.

    `parameters`: of a plant that has them all (`adaptable`). What was not estimated is known to no more than a plausible
    change; and so are lags, whose standard deviation is that of one kind of motion, while a rig's motor and actuator are no
    lags and answer each kind of motion with another one. `sample_time` s: from reading to reading (default: the rig's loop).
    KeyError names an adapted parameter that the plant has not.
    """
    values = parameters.values
    adapted = tuple(adapted or adapted_by_default(values))
    model = twin(parameters.model, adapted, sample_time or SAMPLE_TIME)
    # Known from few degrees of freedom, the model's error is larger than it was seen to be, for the same share of 95 %.
    steady = band.steady * float(t.isf(0.025, band.freedom)) / WITHIN
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
"""Steps before a run from which the twin's time in a tick is told: their median."""


@dataclass(frozen=True)
class Adapted:
    """A parameter that a twin adapts: its value at the start, and a plausible change of it, in its unit."""

    start: float
    change: float
    unit: str
    description: str


class Adaptive:
    """The twin that `adaptive` made, in this process; `outputs` are the names of what `update` tells.

    `adapted`: what it adapts, by name, in the order of the outputs.
    `alarms`: (time [s], what it points to) of each; `microseconds`: that a step takes on this machine.
    """

    def __init__(self, twin: ParameterSet, dt: float):
        self.outputs = tuple(y.name for y in twin.model.outputs)
        self.units = {y.name: y.unit for y in twin.model.outputs}
        values, parts = twin.values, {p.name: p for p in twin.model.parameters}
        self._first = next(k for k, name in enumerate(self.outputs) if name.startswith("adapted."))
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
        self.microseconds = self._tried()

    def start(self, t: float, omega_ref: float, beta_ref: float, thrust: float, omega: float) -> None:
        """The rig stands settled at t [s] on the commands [rpm, deg]; its readings [N, rpm]."""
        self._stepper.start(self._given(omega_ref, beta_ref, thrust, omega))
        self._time, self._before, self._alarmed = t, None, False
        self.alarms.clear()

    def update(self, t: float, omega_ref: float, beta_ref: float, thrust: float, omega: float) -> list[float]:
        """What it says of the readings [N, rpm] at t [s], just before these commands [rpm, deg] act. Ticks that were missed are
        gone through with the commands and readings before them."""
        for _ in range(round((t - self._time) / self._dt) - 1 if self._before else 0):
            self._stepper.step(self._before, self._dt)
        self._before, self._time = self._given(omega_ref, beta_ref, thrust, omega), t
        told = self._stepper.step(self._before, self._dt)
        if told[self._alarm] > 0.5 and not self._alarmed:
            self.alarms.append((t, self._causes[int(told[self._points])]))
        self._alarmed = told[self._alarm] > 0.5
        return told

    def shown(self, told: Sequence[float]) -> tuple[float, float]:
        """For the live view (`hil.columns.shown_beside`), of what `update` told: 0, or while it alarms 1 and the place of what
        that points to; the first of the adapted parameters."""
        return told[self._alarm] * (1.0 + told[self._points]), told[self._first]

    def _given(self, *values: float) -> list[float]:
        given = list(self._inputs)
        for place, value in zip(self._at, values, strict=True):
            given[place] = value
        return given

    def _tried(self) -> float:
        took = []
        self.start(0.0, 4000.0, 4.0, 5.0, 4000.0)
        for k in range(1, TRIED + 1):
            began = time.perf_counter()
            self.update(k * self._dt, 4000.0, 4.0, 5.0, 4000.0)
            took.append(time.perf_counter() - began)
        return 1e6 * sorted(took)[TRIED // 2]
