"""The parts of a model: parameters, signals, states, effects; and one step of it on any arithmetic.

A model is a chain. Its inputs are signals; each effect in turn reads signals, sets signals, and moves its own states; the
signals at the end are the outputs. An effect never reads another's state, only signals. If other effects may change a state,
its effect publishes the value as a signal, and `State.closed_by` names the signal that is the next value at the end of the
chain. All feedback thus runs through a state and no algebraic loop can form.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf
from types import SimpleNamespace
from typing import Any, TypeVar

from vpp_fmu.kernel.integration import exact_step, run_stages
from vpp_fmu.kernel.scales import Scales
from vpp_fmu.kernel.vector import Vector

SETTLING = 6
"""Passes through a chain with feedback to settle it: the error of a feedback with gain k is then k^6."""

REAL, INTEGER, BOOLEAN, ENUMERATION, STRING = "Real", "Integer", "Boolean", "Enumeration", "String"
"""FMI type of a quantity; within the model all are floats, a Boolean 0 or 1, an Enumeration or a String the number of its item
from 1."""

INSTANT = 1e-9
"""Time resolution of the kernel, s. Two events closer than this are one; settling takes one such step."""


def _itemised(q: Any, value: str) -> None:
    """The range of a quantity that has items, and the number of the item that its field `value` names."""
    if q.items:
        object.__setattr__(q, "minimum", 1.0)
        object.__setattr__(q, "maximum", float(len(q.items)))
        if getattr(q, value) in q.items:
            object.__setattr__(q, value, 1.0 + q.items.index(getattr(q, value)))


@dataclass(frozen=True)
class Signal:
    """A quantity that runs along the chain; as a model's input or output also an FMU variable.

    `scale`: the rig's scale that is its nominal value; "": `nominal` is absolute. `kind`: an FMI type, from REAL to STRING.
    `clock`: an input that is the duration [s] of the present row, which the simulation of a record sets. `items`: texts of an
    ENUMERATION or STRING; the model sees their numbers from 1. `size`: number of elements of a vector, 0 for a scalar; the
    elements have the numbers `place` from 1.
    """

    name: str
    unit: str
    description: str
    minimum: float = -inf
    maximum: float = inf
    nominal: float = 1.0
    start: float = 0.0
    scale: str = ""
    kind: str = REAL
    clock: bool = False
    items: tuple[str, ...] = ()
    size: int = 0
    place: int = 0

    def __post_init__(self) -> None:
        _itemised(self, "start")

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
    signal's, as are `items`, `size` and `place`. `tunable`: an importer may change it while the model runs, between two steps.
    `initial`: an initial condition, which differs between records.
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
    items: tuple[str, ...] = ()
    size: int = 0
    place: int = 0

    def __post_init__(self) -> None:
        _itemised(self, "default")

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

    `start(ops, signals, parameters)` is its value on settled inputs, from the signals that reach the effect; or a number, of a
    vector also one for each element. `closed_by` names the signal whose value at the end of the chain is the next state, where
    the effect's own step does not return it. `nominal`: its size; None: that of a signal of the same unit. `size`, `place`: as
    a signal's.
    """

    name: str
    unit: str
    description: str
    start: Any
    closed_by: str | None = None
    nominal: float | None = None
    size: int = 0
    place: int = 0


Q = TypeVar("Q", Signal, Parameter, State)


def scalars(quantities: Iterable[Q]) -> tuple[Q, ...]:
    """The quantities with each vector replaced by its elements: `T[1]`, `T[2]` ..."""
    return tuple(one for q in quantities for one in (elements(q) if q.size and not q.place else (q,)))


def elements(q: Q) -> tuple[Q, ...]:
    """The elements of a vector."""
    field_of = "default" if isinstance(q, Parameter) else "start"
    value = getattr(q, field_of)
    values = value if isinstance(value, Sequence) else [value] * q.size
    return tuple(replace(q, name=f"{q.name}[{i}]", place=i, **{field_of: x}) for i, x in enumerate(values, 1))


def no_step(ops: Any, s: Any, x: Any, p: Any, dt: Any) -> tuple[dict, dict]:
    """The step of an effect that only delays an input."""
    return {}, {}


@dataclass(frozen=True)
class Effect:
    """One physical effect, as one of two functions; signals `s`, own states `x` and own parameters `p` come as attributes.

    `step(ops, s, x, p, dt)`: the next states after dt s, or (signals it sets, its next states). States and inputs are values at
    the start of the step, set signals are values at its end. `derivative(ops, s, x, p)`: the derivatives of all states in
    time, under held signals; `method`: "rk4", "euler", both with a `largest_step`, or "exact", which is exact where the
    derivative is linear in the states (`vpp_fmu.kernel.integration`). `output(ops, s, x, p)`: the signals that it sets, from
    the states at the end of the step, or at the start; None: each state is the signal of its name.

    `sample_time`: the name of its parameter that is its period [s]: the step runs then only. `prefix`: of an instance, see
    `instance`; `wired`: the outer signal of each of its inner ones.

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
    derivative: Callable | None = None
    method: str = "rk4"
    output: Callable | None = None
    sample_time: str | None = None
    prefix: str = ""
    wired: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.sample_time and self.wait not in [x.name for x in self.states]:
            object.__setattr__(self, "states", (*self.states, State(self.wait, "s", "time until its next sample", 0.0)))

    @property
    def wait(self) -> str:
        """The state of a sampled effect that counts down to its next sample; the same for every instance."""
        return f"next_{self.name.rpartition('.')[2]}" if self.sample_time else ""

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
        """The name outside the effect: of one that is always present with its instance, if any, else `<effect>.<name>`."""
        return f"{self.prefix}{name}" if self.off is None else f"{self.name}.{name}"

    @property
    def in_speed(self) -> bool:
        """Whether it acts on the rotor's speed or on its reading."""
        return "omega" in self.channels or "speed" in self.reading

    @property
    def switched_off(self) -> dict[str, float]:
        """`off` by full names; empty for an effect that is always present."""
        return {self.full(name): value for name, value in (self.off or {}).items()}


def instance(name: str, effects: Iterable[Effect], **wired: str) -> tuple[Effect, ...]:
    """The effects as the part `name` of a larger model: their signals, states and parameters are `name.NAME`.

    Its effects read the part's own signals first, then those of the whole. `wired`: the signal of the whole that is the part's
    signal of this name; another part's are written `left.speed`. The other effects read the part's signals as `s.name.NAME`.

    >>> heater = vpp.Effect("heater", "warms", derivative=lambda ops, s, x, p: {"T": s.power - x.T}, largest_step=0.1,
    ...     states=(vpp.State("T", "degC", "temperature", 20.0),))
    >>> hall = (*vpp.instance("left", [heater], power="supply"), *vpp.instance("right", [heater], power="left.T"))
    >>> [effect.name for effect in hall]
    ['left.heater', 'right.heater']
    """

    def wires(e: Effect) -> dict[str, str]:
        """Also those of parts within the part."""
        return wired | {inner: wired.get(outer, outer) for inner, outer in e.wired.items()}

    return tuple(replace(e, name=f"{name}.{e.name}", prefix=f"{name}.{e.prefix}", wired=wires(e)) for e in effects)


@dataclass(frozen=True)
class Model:
    """A chain of effects between named inputs and outputs.

    `sample_time` names the parameter that holds the period [s] of a sampled law; None: the model runs in continuous time.
    `sets` are named sets of parameter values, such as the paper's. `author`, `version`, `license`, `copyright`: of the model,
    as its FMU tells them. `icon`: path of a PNG, or "propeller". `stop_time`, `step_size` [s] and `tolerance` of the default
    experiment; None: the exporter's. `black_box(state, inputs, dt)`: in place of all steps, a function that changes `state`, a
    dictionary that is empty at first, and returns the outputs after dt s by name; `inputs` has the parameters, too. It may do
    anything; only the Python flavour can pack it, with its file.
    """

    name: str
    description: str
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    effects: tuple[Effect, ...]
    sample_time: str | None = None
    sets: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    author: str = ""
    version: str = ""
    license: str = ""
    copyright: str = ""
    icon: str = ""
    stop_time: float | None = None
    step_size: float | None = None
    tolerance: float | None = None
    black_box: Callable | None = None

    def __post_init__(self) -> None:
        for name in ("inputs", "outputs"):
            if isinstance(declared := getattr(self, name), tuple | list) and all(isinstance(q, Signal) for q in declared):
                object.__setattr__(self, name, scalars(declared))

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters under their full names, in the effects' order."""
        return scalars(replace(p, name=e.full(p.name)) for e in self.effects for p in e.parameters)

    @cached_property
    def states(self) -> tuple[State, ...]:
        """All states under their full names, in the effects' order."""
        return scalars(replace(x, name=e.full(x.name)) for e in self.effects for x in e.states)

    @cached_property
    def delays(self) -> tuple[tuple[str, str], ...]:
        """(input, full name of the parameter that holds it back), one for each delayed input."""
        return tuple((u, e.full(p)) for e in self.effects for u, p in e.delays.items())

    @cached_property
    def sampled(self) -> tuple[tuple[str, str], ...]:
        """(state that counts down to the next sample, parameter that is the period) of each sampled effect, by full names."""
        return tuple((e.full(e.wait), e.full(e.sample_time)) for e in self.effects if e.sample_time)

    @cached_property
    def links(self) -> tuple[tuple[Effect, str, tuple, tuple, tuple, Mapping], ...]:
        """For each effect: itself, the prefix of its full names, and (name, full name) of its states and of its parameters;
        (full name, signal) of states that a signal closes; the names of the elements of its vectors, by their full names.
        Cached, since making them takes half the time of a step."""
        return tuple(
            (
                e,
                e.full(""),
                tuple((x.name, e.full(x.name)) for x in e.states),
                tuple((p.name, e.full(p.name)) for p in e.parameters),
                tuple((e.full(x.name), x.closed_by) for x in e.states if x.closed_by is not None),
                dict(_places(e.full(q.name), q.size) for q in _quantities(e) if q.size),
            )
            for e in self.effects
        )

    @cached_property
    def integrated(self) -> Mapping[str, frozenset[str]]:
        """The full names of the states that are integrated together, by their method; empty if there are none."""
        found: dict[str, set[str]] = {"rk4": set(), "euler": set()}
        for e in filter(is_integrated, self.effects):
            own = replace(self, effects=(e,)).states
            found[e.method] |= {x.name for x in own if x.closed_by is None}
        return {method: frozenset(names) for method, names in found.items()} if any(found.values()) else {}

    @cached_property
    def vectors(self) -> Mapping[str, tuple[str, ...]]:
        """The names of the elements of each input and output that is a vector."""
        firsts = (q for q in (*self.inputs, *self.outputs) if q.place == 1)
        return dict(_places(q.name.removesuffix("[1]"), q.size) for q in firsts)

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
        inputs=tuple({u.name: u for u in (*model.inputs, *(u for e in effects for u in e.inputs))}.values()),
        outputs=model.outputs + tuple(y for e in effects for y in e.outputs),
        effects=effects,
    )


def _places(name: str, size: int) -> tuple[str, tuple[str, ...]]:
    """(name of a vector, names of its elements)."""
    return name, tuple(f"{name}[{i}]" for i in range(1, size + 1))


def _quantities(e: Effect) -> tuple[State | Parameter, ...]:
    return (*e.states, *e.parameters)


def own_values(values: Mapping, names: tuple, vectors: Mapping) -> SimpleNamespace:
    """States or parameters of an effect by their own names; vectors from their elements."""
    return SimpleNamespace(
        **{name: Vector(values[i] for i in vectors[full]) if full in vectors else values[full] for name, full in names}
    )


def input_signals(model: Model, inputs: Mapping) -> SimpleNamespace:
    """The inputs as signals; vectors from their elements."""
    s = SimpleNamespace(**inputs)
    for name, parts in model.vectors.items():
        if parts[0] in inputs:
            setattr(s, name, Vector(inputs[i] for i in parts))
    return s


def view(e: Effect, s: SimpleNamespace) -> SimpleNamespace:
    """The signals as an effect reads them: an instance's own ones first, then those of the whole. KeyError: a wired signal."""
    if not e.prefix:
        return s
    seen, scopes, inner = dict(vars(s)), [""], s
    for part in e.prefix[:-1].split("."):  # from the whole inwards: the innermost name is taken
        inner = getattr(inner, part, SimpleNamespace())
        seen.update(vars(inner))
        scopes.append(f"{scopes[-1]}{part}.")
    for name, outer in e.wired.items():
        found = [scope + outer for scope in scopes[:-1] if scope + outer in vars(s)]
        seen[name] = vars(s)[found[-1] if found else outer]
    return SimpleNamespace(**seen)


def set_signals(e: Effect, s: SimpleNamespace, signals: Mapping) -> None:
    """Add an effect's signals; those of an instance under its prefix, and within the namespace of its name."""
    if not e.prefix:
        s.__dict__.update(signals)
        return
    *path, _ = e.prefix.split(".")
    inner = s
    for part in path:
        inner = vars(inner).setdefault(part, SimpleNamespace())
    vars(inner).update(signals)
    s.__dict__.update((e.prefix + name, value) for name, value in signals.items())


def flat(model: Model, s: SimpleNamespace) -> dict:
    """The signals by name, with the elements of output vectors."""
    for name, parts in model.vectors.items():
        if name in vars(s):
            s.__dict__.update(zip(parts, vars(s)[name], strict=True))
    return vars(s)


def _entered(values: dict, prefix: str, moved: Mapping, vectors: Mapping) -> None:
    """Enter an effect's states under their full names; vectors as their elements."""
    for name, value in moved.items():
        if prefix + name in vectors:
            values.update(zip(vectors[prefix + name], value, strict=True))
        else:
            values[prefix + name] = value


def shown(e: Effect, ops: Any, s: Any, x: SimpleNamespace, p: Any) -> Mapping:
    """The signals of an effect that has an `output`, or whose states are its signals."""
    if e.output is not None:
        signals: Mapping = e.output(ops, s, x, p)
        return signals
    return {name: value for name, value in vars(x).items() if name != e.wait}


def moved(e: Effect, ops: Any, s: Any, x: SimpleNamespace, p: Any, dt: Any) -> tuple[Mapping, Mapping]:
    """(signals that an effect sets, its next states) after a step of dt s."""
    returned = exact_step(e, ops, s, x, p, dt) if e.derivative else e.step(ops, s, x, p, dt)
    signals, ahead = returned if isinstance(returned, tuple) else (None, returned)
    if e.sample_time:
        wait, period = getattr(x, e.wait), getattr(p, e.sample_time)
        due = wait < INSTANT
        held = {name: _chosen(ops, due, value, getattr(x, name)) for name, value in ahead.items()}
        left = ops.where(due, wait + period, wait) - dt
        ahead = {**held, e.wait: ops.where(ops.abs(left) < INSTANT, 0.0, left)}
    if e.output is not None or signals is None:
        signals = shown(e, ops, s, SimpleNamespace(**{**vars(x), **ahead}), p)
    return signals, ahead


def _chosen(ops: Any, condition: Any, yes: Any, no: Any) -> Any:
    if isinstance(no, Vector):
        return Vector(ops.where(condition, a, b) for a, b in zip(yes, no, strict=True))
    return ops.where(condition, yes, no)


def step(model: Model, ops: Any, inputs: Mapping, states: Mapping, parameters: Mapping, dt: Any) -> tuple[dict, dict]:
    """One step of the chain under held inputs: (signals at its end, next states), on whatever arithmetic `ops` is.

    `states` and `parameters` have full names. Units are the declarations'; dt in s.
    """
    s, reached = input_signals(model, inputs), states
    ahead: dict = {}
    if model.integrated:

        def rates(c: Any, at: Mapping) -> dict:
            found: dict = {}
            _passed(model, ops, input_signals(model, inputs), {**states, **at}, parameters, c, {}, found)
            return found

        ahead = run_stages(rates, states, dt, model.integrated["euler"])
        reached = {**states, **ahead}
    _passed(model, ops, s, reached, parameters, dt, ahead, None)
    for e, *_, closed, vectors in model.links:
        for full, signal in closed:
            _entered(ahead, "", {full: vars(view(e, s))[signal]}, vectors)
    return flat(model, s) if model.vectors else vars(s), ahead


def _passed(
    model: Model, ops: Any, s: SimpleNamespace, states: Mapping, parameters: Mapping, dt: Any, ahead: dict, rates: dict | None
) -> None:
    """Enter the signals after dt s (None: at the start), the next states of effects with a step, and if `rates` is given the
    derivatives of the others, whose states have been integrated."""
    for e, prefix, its_states, its_parameters, _, vectors in model.links:
        if vectors:
            x, p = own_values(states, its_states, vectors), own_values(parameters, its_parameters, vectors)
        else:  # calls would take a third of the time of a step
            x = SimpleNamespace(**{name: states[full] for name, full in its_states})
            p = SimpleNamespace(**{name: parameters[full] for name, full in its_parameters})
        seen = view(e, s) if e.prefix else s
        own: Mapping = {}
        if e.derivative is not None and is_integrated(e):
            signals = shown(e, ops, seen, x, p)
            if rates is not None:
                _entered(rates, prefix, e.derivative(ops, seen, x, p), vectors)
        elif dt is None:
            signals = begun(e, ops, seen, x, p)
        else:
            signals, own = moved(e, ops, seen, x, p, dt)
        if e.prefix:
            set_signals(e, s, signals)
        else:
            s.__dict__.update(signals)
        if vectors:
            _entered(ahead, prefix, own, vectors)
        else:
            for name, value in own.items():
                ahead[prefix + name] = value


def is_integrated(e: Effect) -> bool:
    """Whether its states are integrated together with those of other effects."""
    return e.derivative is not None and e.method != "exact"


def start(model: Model, ops: Any, inputs: Mapping, parameters: Mapping) -> tuple[dict, dict]:
    """The chain settled on `inputs`: (signals, states).

    Each state starts from the signals that reach its effect. The signals behind it are its output at these states. A step that
    returns signals is taken for INSTANT instead: from a settled state every exact form stays where it is to the bit. If effects
    start from later signals (`ahead`), this is repeated with the signals of the last pass.
    """
    guesses = {name: inputs[guess] if guess else 0.0 for e in model.effects for name, guess in e.ahead.items()}
    for _ in range(SETTLING if guesses else 0):
        signals, _ = _started(model, ops, inputs, guesses, parameters)
        guesses = {name: signals[name] for name in guesses}
    return _started(model, ops, inputs, guesses, parameters)


def _started(model: Model, ops: Any, inputs: Mapping, ahead: Mapping, parameters: Mapping) -> tuple[dict, dict]:
    s = input_signals(model, inputs)
    s.__dict__.update((f"settled_{name}", value) for name, value in ahead.items())
    states: dict = {}
    for e, prefix, _, its_parameters, _, vectors in model.links:
        seen, p = view(e, s), own_values(parameters, its_parameters, vectors)
        own = {x.name: started(x, ops, seen, p) for x in e.states}
        set_signals(e, s, begun(e, ops, seen, SimpleNamespace(**own), p))
        _entered(states, prefix, own, vectors)
    if model.sample_time is not None:
        s.__dict__.update((output.name, output.start) for output in model.outputs)
    return flat(model, s), states


def show(model: Model, ops: Any, inputs: Mapping, states: Mapping, parameters: Mapping) -> dict:
    """The signals at given states, without a step, as at the start; states and parameters by full names."""
    s = input_signals(model, inputs)
    _passed(model, ops, s, states, parameters, None, {}, None)
    return flat(model, s)


def started(x: State, ops: Any, s: Any, p: Any) -> Any:
    """A state's value at the start; of a vector, an element or all of them may be given."""
    value = x.start(ops, s, p) if callable(x.start) else x.start
    return Vector(value if isinstance(value, Sequence) else [value] * x.size) if x.size else value


def begun(e: Effect, ops: Any, s: Any, x: SimpleNamespace, p: Any) -> Mapping:
    """The signals of an effect at its start."""
    returned = None if e.derivative or e.output else e.step(ops, s, x, p, INSTANT)
    return returned[0] if isinstance(returned, tuple) else shown(e, ops, s, x, p)


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
