"""The parts of a model: parameters, signals, states, effects; and one step of it on any arithmetic.

A model is a chain. Its inputs are signals; each effect in turn reads signals, sets signals, and moves its own states; the
signals at the end are the outputs. An effect never reads another's state, only signals. If other effects may change a state,
its effect publishes the value as a signal, and `State.closed_by` names the signal that is the next value at the end of the
chain. All feedback thus runs through a state and no algebraic loop can form.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any

from vpp_fmu.kernel.scales import Scales

SETTLING = 6
"""Passes through a chain with feedback to settle it: the error of a feedback with gain k is then k^6."""

REAL, INTEGER, BOOLEAN = "Real", "Integer", "Boolean"
"""FMI type of a quantity; within the model all are floats, a Boolean 0 or 1."""

INSTANT = 1e-9
"""Time resolution of the kernel, s. Two events closer than this are one; settling takes one such step."""


@dataclass(frozen=True)
class Signal:
    """A quantity that runs along the chain; as a model's input or output also an FMU variable.

    `scale`: the rig's scale that is its nominal value; "": `nominal` is absolute. `kind`: REAL, INTEGER or BOOLEAN. `clock`: an
    input that is the duration [s] of the present row, which the simulation of a record sets.
    """

    name: str
    unit: str
    description: str
    minimum: float
    maximum: float
    nominal: float = 1.0
    start: float = 0.0
    scale: str = ""
    kind: str = REAL
    clock: bool = False

    def sized(self, scales: Scales) -> "Signal":
        """The signal on a rig of these scales."""
        return replace(self, nominal=scales.absolute(1.0, self.scale)) if self.scale else self


@dataclass(frozen=True)
class Parameter:
    """A constant of the model. `minimum` and `maximum` are the FMU's range and the fit's bounds alike.

    `choices`: the only meaningful values, if the parameter selects a form of the effect; a search tries each.
    `limit_form`: the form of the effect at a bound, if it is valid there; "": an estimate at a bound is a sign of a misfit.
    `scale`: the rig's scale (`Scales.absolute`) that default, bounds and nominal are shares of, as the effect declares them;
    "": they are absolute. `unlimited`: the value, in the unit and on any rig, that means no limit. `kind`: as a
    signal's. `tunable`: an importer may change it while the model runs, between two steps. `initial`: an initial condition,
    which differs between records.
    """

    name: str
    unit: str
    default: float
    minimum: float
    maximum: float
    description: str
    nominal: float = 1.0
    choices: tuple[float, ...] = ()
    limit_form: str = ""
    scale: str = ""
    unlimited: float | None = None
    kind: str = REAL
    tunable: bool = False
    initial: bool = False

    def absolute(self, share: float, scales: Scales) -> float:
        """A declared share as a value on a rig of these scales."""
        return share if share == self.unlimited else scales.absolute(share, self.scale)

    def sized(self, scales: Scales) -> "Parameter":
        """The parameter, as declared, on a rig of these scales."""
        default, minimum, maximum = (self.absolute(share, scales) for share in (self.default, self.minimum, self.maximum))
        distance = "pitch" if self.scale in ("position", "offset") else self.scale
        nominal = scales.absolute(self.nominal, distance)
        return replace(self, default=default, minimum=minimum, maximum=maximum, nominal=nominal)


@dataclass(frozen=True)
class State:
    """A state of an effect.

    `start(ops, signals, parameters)` is its value on settled inputs, from the signals that reach the effect. `closed_by`
    names the signal whose value at the end of the chain is the next state, where the effect's own step does not return it.
    """

    name: str
    unit: str
    description: str
    start: Callable
    closed_by: str | None = None


def no_step(ops: Any, s: Any, x: Any, p: Any, dt: Any) -> tuple[dict, dict]:
    """The step of an effect that only delays an input."""
    return {}, {}


@dataclass(frozen=True)
class Effect:
    """One physical effect.

    `step(ops, s, x, p, dt) -> (signals it sets, its next states)`: signals `s`, own states `x` and own parameters `p` come
    as attributes, dt in s. States and inputs are values at the start of the step, set signals are values at its end.

    `off` holds the parameter values at which the effect is exactly the identity; None: always part of the model. `probe` holds
    a plausible size, for the start of a search and for pictures of the sensitivity. `inputs` are measured quantities that the
    effect needs beside the commands; a model with the effect has them as inputs. `delays` maps an input's name to the parameter
    that is its delay [s]; the schedule applies it exactly, between steps. `rounds` maps an input's name to the parameter to
    whose multiples the input is rounded: the response is discontinuous in it, at values that follow from the input's
    levels. `largest_step` is the longest step [s] at which the discrete form is accurate; None: exact for held inputs
    at any step. `contains` maps the name of an effect that is a special case of this one to their common parameters, own name
    to its name: a search for this one also starts at the fit of that one. `channels`: those of "beta" and "omega" in which it
    acts; none: it changes only the thrust. `reading`: "thrust", "speed" or "thrust and speed", if it changes the reading and
    not the quantity. `common`: for an effect that every rig has a little of, the share of the noise's power from which on it
    is relevant. `declared`: of an effect that was sized for a rig, the effect as its file declares it, in shares of the rig's
    scales. `ahead`: later signals from which its states start, as `settled_<name>`, each with the input that is its first
    guess; "": 0. `outputs`: signals that become outputs of a model with the effect. `says`: the effect as a clause, "the pitch
    servo ignores changes below {half_width}", with the names of parameters in braces; "": the description says it."""

    name: str
    description: str
    step: Callable = no_step
    parameters: tuple[Parameter, ...] = ()
    states: tuple[State, ...] = ()
    off: Mapping[str, float] | None = None
    probe: Mapping[str, float] = field(default_factory=dict)
    inputs: tuple[Signal, ...] = ()
    delays: Mapping[str, str] = field(default_factory=dict)
    rounds: Mapping[str, str] = field(default_factory=dict)
    largest_step: float | None = None
    contains: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    channels: tuple[str, ...] = ()
    reading: str = ""
    common: float = 0.0
    declared: "Effect | None" = None
    ahead: Mapping[str, str] = field(default_factory=dict)
    outputs: tuple[Signal, ...] = ()
    says: str = ""

    def sized(self, scales: Scales) -> "Effect":
        """The effect with absolute numbers for a rig of these scales."""
        own = self.declared or self
        by_name = {p.name: p for p in own.parameters}

        def absolute(shares: Mapping[str, float]) -> dict[str, float]:
            return {name: by_name[name].absolute(share, scales) for name, share in shares.items()}

        return replace(
            self,
            parameters=tuple(p.sized(scales) for p in own.parameters),
            off=None if self.off is None else absolute(own.off or {}),
            probe=absolute(own.probe),
            declared=own,
        )

    def full(self, name: str) -> str:
        """The name outside the effect: unchanged for an effect that is always present, else `<effect>.<name>`."""
        return name if self.off is None else f"{self.name}.{name}"

    @property
    def switched_off(self) -> dict[str, float]:
        """`off` by full names; empty for an effect that is always present."""
        return {self.full(name): value for name, value in (self.off or {}).items()}


@dataclass(frozen=True)
class Model:
    """A chain of effects between named inputs and outputs.

    `sample_time` names the parameter that holds the period [s] of a sampled law; None: the model runs in continuous time.
    `sets` are named sets of parameter values, such as the paper's.
    """

    name: str
    description: str
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    effects: tuple[Effect, ...]
    sample_time: str | None = None
    sets: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters under their full names, in the effects' order."""
        return tuple(replace(p, name=e.full(p.name)) for e in self.effects for p in e.parameters)

    @cached_property
    def states(self) -> tuple[State, ...]:
        """All states under their full names, in the effects' order."""
        return tuple(replace(x, name=e.full(x.name)) for e in self.effects for x in e.states)

    @cached_property
    def delays(self) -> tuple[tuple[str, str], ...]:
        """(input, full name of the parameter that holds it back), one for each delayed input."""
        return tuple((u, e.full(p)) for e in self.effects for u, p in e.delays.items())

    @cached_property
    def links(self) -> tuple[tuple[Effect, str, tuple, tuple, tuple], ...]:
        """For each effect: itself, the prefix of its full names, and (name, full name) of its states and of its parameters;
        (full name, signal) of states that a signal closes. Cached, since making them takes half the time of a step."""
        return tuple(
            (
                e,
                e.full(""),
                tuple((x.name, e.full(x.name)) for x in e.states),
                tuple((p.name, e.full(p.name)) for p in e.parameters),
                tuple((e.full(x.name), x.closed_by) for x in e.states if x.closed_by is not None),
            )
            for e in self.effects
        )

    @cached_property
    def memo(self) -> dict:
        """Derived data of this model, by tool and options: a model is immutable, and tracing one costs more than a run."""
        return {}

    @cached_property
    def measured_inputs(self) -> dict[str, float]:
        """Inputs of effects, with their value if they are not measured."""
        return {u.name: u.start for e in self.effects for u in e.inputs}

    @cached_property
    def optional(self) -> tuple[str, ...]:
        """Names of the optional effects in this model."""
        return tuple(e.name for e in self.effects if e.off is not None)

    def sized(self, scales: Scales) -> "Model":
        """The model for a rig of these scales: bounds, nominal values, and defaults that depend on the rig."""
        inputs, outputs = (tuple(s.sized(scales) for s in signals) for signals in (self.inputs, self.outputs))
        return replace(self, inputs=inputs, outputs=outputs, effects=tuple(e.sized(scales) for e in self.effects))

    def values(self, changes: Mapping[str, float] | None = None) -> dict[str, float]:
        """Parameter values by full name: the defaults with `changes`. KeyError names an unknown parameter."""
        values = {p.name: p.default for p in self.parameters}
        for name, value in (changes or {}).items():
            if name not in values:
                raise KeyError(name)
            values[name] = float(value)
        return values


def compose(model: Model, library: Iterable[Effect], names: Iterable[str]) -> Model:
    """`model` with the permanent and the named effects of `library`, in the library's order."""
    wanted = set(names)
    effects = tuple(e for e in library if e.off is None or e.name in wanted)
    return replace(
        model,
        inputs=model.inputs + tuple(u for e in effects for u in e.inputs),
        outputs=model.outputs + tuple(y for e in effects for y in e.outputs),
        effects=effects,
    )


def step(model: Model, ops: Any, inputs: Mapping, states: Mapping, parameters: Mapping, dt: Any) -> tuple[dict, dict]:
    """One step of the chain under held inputs: (signals at its end, next states), on whatever arithmetic `ops` is.

    `states` and `parameters` have full names. Units are the declarations'; dt in s.
    """
    s = SimpleNamespace(**inputs)
    ahead: dict = {}
    for e, prefix, its_states, its_parameters, _ in model.links:
        own_states = SimpleNamespace(**{name: states[full] for name, full in its_states})
        own_parameters = SimpleNamespace(**{name: parameters[full] for name, full in its_parameters})
        signals, moved = e.step(ops, s, own_states, own_parameters, dt)
        s.__dict__.update(signals)
        for name, value in moved.items():
            ahead[prefix + name] = value
    for *_, closed in model.links:
        for full, signal in closed:
            ahead[full] = getattr(s, signal)
    return vars(s), ahead


def start(model: Model, ops: Any, inputs: Mapping, parameters: Mapping) -> tuple[dict, dict]:
    """The chain settled on `inputs`: (signals, states).

    Each state starts from the signals that reach its effect; a step of INSTANT of the effect then gives the signals behind
    it. From a settled state every exact form stays where it is to the bit. If effects start from later signals (`ahead`), this
    is repeated with the signals of the last pass.
    """
    guesses = {name: inputs[guess] if guess else 0.0 for e in model.effects for name, guess in e.ahead.items()}
    for _ in range(SETTLING if guesses else 0):
        signals, _ = _started(model, ops, inputs, guesses, parameters)
        guesses = {name: signals[name] for name in guesses}
    return _started(model, ops, inputs, guesses, parameters)


def _started(model: Model, ops: Any, inputs: Mapping, ahead: Mapping, parameters: Mapping) -> tuple[dict, dict]:
    s = SimpleNamespace(**inputs, **{f"settled_{name}": value for name, value in ahead.items()})
    states: dict = {}
    for e in model.effects:
        p = SimpleNamespace(**{q.name: parameters[e.full(q.name)] for q in e.parameters})
        own = {x.name: x.start(ops, s, p) for x in e.states}
        signals, _ = e.step(ops, s, SimpleNamespace(**own), p, INSTANT)
        s.__dict__.update(signals)
        states.update((e.full(name), value) for name, value in own.items())
    if model.sample_time is not None:
        s.__dict__.update((output.name, output.start) for output in model.outputs)
    return vars(s), states


def largest_step(model: Model, ops: Any, parameters: Mapping) -> Any:
    """The longest step [s] that all active effects allow; infinite if all are exact."""
    longest = float("inf")
    for e in model.effects:
        if e.largest_step is None:
            continue
        bound = e.largest_step if e.off is None else float("inf")
        for name, value in (e.off or {}).items():
            p = parameters[e.full(name)]
            bound = ops.where(p < value, e.largest_step, ops.where(p > value, e.largest_step, bound))
        longest = ops.minimum(longest, bound)
    return longest
