"""The twin of an identified rig: its priors, residual band and adapted parameters, and one update per tick beside the rig."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from scipy.special import stdtrit

from hil.safety.faults import FaultKind
from hil.twin.band import Band
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.kernel.scales import Scales
from vpp_fmu.kernel.twin.model import adapted_by_default, plausible_change, twin
from vpp_fmu.kernel.twin.noises import WITHIN
from vpp_fmu.kernel.twin.prediction import BROUGHT, SAMPLE_TIME
from vpp_fmu.kernel.twin.watch import threshold, watched
from vpp_fmu.native.stepper import Stepper
from vpp_fmu.parameters import Estimate, ParameterSet

FALSE_ALARMS = 0.01
"""Most false alarms per hour."""

CERTAIN = 2.0
"""Least change of an adapted parameter that counts, in standard deviations; one test in 20 exceeds it by chance."""


def twin_of(
    parameters: ParameterSet,
    band: Band,
    adapted: Sequence[str] | None = None,
    where: str = "twin",
    sample_time: float | None = None,
) -> ParameterSet:
    """The twin's model with its parameters: those of the plant, their standard deviations as priors, and the band's noises.

    The prior of a parameter that was not estimated is its plausible change. The same holds for lags: an estimate is valid for
    one kind of motion, and a real motor or actuator has another lag for each kind. `sample_time` s: between readings (default:
    the loop of the rig). BadInput, with `where`, for an unknown name in `adapted`.
    """
    parameters = _widened(parameters.without_power)
    values, names = parameters.values, [p.name for p in parameters.model.parameters]
    for name in adapted or ():
        if name not in names:
            raise BadInput(where, "--adapt", name, f"one of {', '.join(names)}")
    adapted = tuple(adapted or adapted_by_default(values))
    model, shows = twin(parameters.model, adapted, sample_time or SAMPLE_TIME), watched(parameters.model, adapted)
    # Few degrees of freedom: scale the model error so that 1.96 standard deviations cover 95 %, as Student's t does.
    steady = band.steady * float(stdtrit(band.freedom, 0.975)) / WITHIN
    noises = {"white": band.white, "slow": band.slow, "slow_time": band.slow_time, "steady": steady, "moving": band.moving}
    noises["threshold"] = threshold(FALSE_ALARMS, len(shows), model.values()["sample_time"])
    found, allowed = values | noises, {p.name: p for p in model.parameters}
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


def _widened(parameters: ParameterSet) -> ParameterSet:
    """The plant with the effects that each twin includes, switched off if they are added."""
    model, order = parameters.model, {e.name: k for k, e in enumerate(LIBRARY)}
    effects, scales = list(model.effects), Scales().with_values(parameters.values)
    for e in (e.sized(scales) for e in LIBRARY if e.name in BROUGHT and e.name not in model.optional):
        before = [k for k, other in enumerate(effects) if order.get(other.name, -1) < order[e.name]]
        effects.insert(max(before) + 1, e)
    return replace(parameters, model=replace(model, effects=tuple(effects)))


class Alarm(NamedTuple):
    """An alarm at `time` [s], the parameter whose change is the likeliest `direction` (None: of no parameter), and that in
    words."""

    time: float
    direction: str | None
    cause: str


class Twin:
    """The twin of `twin_of`, in this process; `outputs`: names of the values that `update` returns.

    `adapted`: by the parameter's name, in the order of the outputs, its value at the `start`, a plausible `change`, `unit` and
    `description`. `alarms`: those since the start. `residual` [N] and `alarmed`: of the last update. `on_alarm`: the fault that
    an alarm causes (None: it is only noted).
    """

    def __init__(self, own: ParameterSet, dt: float = SAMPLE_TIME, on_alarm: FaultKind | None = None):
        self.outputs = tuple(y.name for y in own.model.outputs)
        self.units = {y.name: y.unit for y in own.model.outputs}
        values, parts = own.values, {p.name: p for p in own.model.parameters}
        names = [y.removeprefix("adapted.") for y in self.outputs if y.startswith("adapted.")]
        self.adapted = {
            n: {"start": values[n], "change": values[f"change.{n}"], "unit": parts[n].unit, "description": parts[n].description}
            for n in names
        }
        self._inputs = {u.name: u.start for u in own.model.inputs}
        self._shown = [self.outputs.index(name) for name in ("residual", "alarm", "direction")]
        self._stepper, self._dt, self._time = Stepper(own.model, own.values), dt, 0.0
        self.alarms: list[Alarm] = []
        self.on_alarm = on_alarm

    def start(self, t: float, omega_ref: float, beta_ref: float, thrust: float, omega: float) -> None:
        """Start at t [s] from a settled rig: its commands [rpm, deg] and readings [N, rpm]."""
        self._stepper.start(self._given(omega_ref, beta_ref, thrust, omega))
        self._time, self._before, self.residual, self.alarmed = t, None, 0.0, False
        self.alarms.clear()

    def update(self, t: float, omega_ref: float, beta_ref: float, thrust: float, omega: float) -> list[float]:
        """Outputs for the readings [N, rpm] at t [s], just before these commands [rpm, deg] act. Missed ticks are computed with
        the previous commands and readings."""
        for _ in range(round((t - self._time) / self._dt) - 1 if self._before else 0):
            self._stepper.step(self._before, self._dt)
        self._before, self._time = self._given(omega_ref, beta_ref, thrust, omega), t
        outputs = self._stepper.step(self._before, self._dt)
        self.residual, alarm, direction = (outputs[k] for k in self._shown)
        if alarm > 0.5 and not self.alarmed:
            name = [None, *self.adapted][round(direction)]
            like = "like no change of one parameter"
            if name:
                like = f"most like a change of {name}, {self.adapted[name]['description']}"
            self.alarms.append(Alarm(t, name, f"the rig is not its model, {self.residual:+.2f} N now, {like}"))
        self.alarmed = alarm > 0.5
        return outputs

    def summary(self) -> dict:
        """Entries of hil.json before a run."""
        known = {"false_alarms_per_hour": FALSE_ALARMS, "certain": CERTAIN}
        return known | {"units": self.units, "adapted": self.adapted}

    def _given(self, omega_ref: float, beta_ref: float, thrust: float, omega: float) -> list[float]:
        read = {"omega_ref": omega_ref, "beta_ref": beta_ref, "thrust": thrust, "omega": omega}
        return [*(self._inputs | read).values()]
