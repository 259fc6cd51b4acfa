"""The plant's step on dual numbers: the twin's prediction and its sensitivity to the adapted parameters."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from vpp_fmu.kernel.duals import Dual, Duals
from vpp_fmu.kernel.effects.dead_time import dead_time
from vpp_fmu.kernel.effects.thrust_map import THRUST_MAP
from vpp_fmu.kernel.ops import NUMBERS
from vpp_fmu.kernel.signals import BETA_REF, OMEGA_REF
from vpp_fmu.kernel.types import Effect, Model, State, start, step

SAMPLE_TIME = 0.004
"""The rig's sampling period, s."""

BROUGHT = ("sensor_gain", "pitch_offset", "sensor_drift")
"""Effects of every twin: they differ from day to day, and the identification of a rig does not have them."""

COEFFICIENTS = tuple(p.name for p in THRUST_MAP.parameters)


def _sampled(plant: Model) -> Model:
    """The plant with a dead time instead of each delay, which the schedule of a sampled law doesn't have."""
    return replace(plant, effects=tuple(_held_back(e) if e.delays else e for e in plant.effects))


def _held_back(e: Effect) -> Effect:
    def step(ops, s, x, p, dt):
        late, ahead = {}, {}
        for u, delay in e.delays.items():
            # The command is constant over the step, so the dead time takes its value before the step as well.
            state = SimpleNamespace(before=getattr(s, u), behind=getattr(x, f"{u}.behind"), rate=getattr(x, f"{u}.rate"))
            late[u], after = dead_time(ops, state.before, state, getattr(p, delay), dt)
            ahead |= {f"{u}.behind": after["behind"], f"{u}.rate": after["rate"]}
        return late, ahead

    def states() -> Iterable[State]:
        for u in e.delays:
            yield State(f"{u}.behind", "1", f"{u} behind two lags", lambda ops, s, p, u=u: getattr(s, u))
            yield State(f"{u}.rate", "1/s", "rate of that", 0.0)

    return replace(e, step=step, states=(*e.states, *states()), delays={})


class _Plant:
    """The plant on dual numbers: its states, and which of their derivatives are structurally zero."""

    def __init__(self, plant: Model, adapted: tuple[str, ...], pieces: int):
        self.model, self.adapted, self.pieces = _sampled(plant), adapted, pieces
        self.measured = [u for u in plant.inputs if not u.clock]
        self._clocks = [u.name for u in plant.inputs if u.clock]
        self._own = {p.name: p for p in plant.parameters}
        self.depends = self._structure()
        self._settled: tuple = (None, None, {})

    def values(self, duals: Duals, s: Any, p: Any) -> dict[str, Dual]:
        """All parameters; the adapted ones have their present values, within their bounds."""
        found = {name: duals.constant(getattr(p, name)) for name in self._own}
        for i, name in enumerate(self.adapted):
            q = self._own[name]
            now = duals.ops.clip(getattr(p, name) + s.change[i] * s.theta[i], q.minimum, q.maximum)
            found[name] = Dual(now, tuple(s.change[i] if k == i else None for k in range(len(self.adapted))))
        return found

    def inputs(self, duals: Duals, value_of: Callable[[str], Any], dt: Any) -> dict[str, Dual]:
        """Commands and measured inputs, by name; a clock has the length of the sample, `dt`."""
        return {u.name: duals.constant(value_of(u.name)) for u in self.measured} | {u: duals.constant(dt) for u in self._clocks}

    def settled(self, ops: Any, s: Any, p: Any) -> dict[str, Dual]:
        """The states settled on the inputs. A start computes one state at a time, so the last result is kept."""
        if self._settled[0] is not s or self._settled[1] is not p:
            duals = Duals(ops, len(self.adapted))
            inputs = self.inputs(duals, lambda name: getattr(s, name), 0.0)
            states = start(self.model, duals, inputs, self.values(duals, s, p))[1]
            self._settled = s, p, {name: duals.constant(value) for name, value in states.items()}
        return self._settled[2]

    def advance(self, duals: Duals, s: Any, x: Any, p: Any, dt: Any) -> tuple[dict, dict, dict]:
        """(signals, states, parameters) at the end of a sample under the inputs that were held."""
        states = {
            name: Dual(getattr(x, name), tuple(getattr(x, _tangent(name, q)) if q in of else None for q in self.adapted))
            for name, of in self.depends.items()
        }
        inputs = self.inputs(duals, lambda name: getattr(x, _held(name)), dt)
        known, piece, signals = self.values(duals, s, p), duals.constant(dt / float(self.pieces)), {}
        for _ in range(self.pieces):
            signals, states = _stepped(self.model, duals, inputs, states, known, piece)
        return signals, states, known

    def _structure(self) -> dict[str, tuple[str, ...]]:
        """The adapted parameters on which each state depends: of a start, then steps until no dependence is added."""
        m = len(self.adapted)
        duals, defaults = Duals(NUMBERS, m), self.model.values()
        asked = SimpleNamespace(change=[1.0] * m, theta=[0.0] * m)
        known = self.values(duals, asked, SimpleNamespace(**defaults))
        inputs = self.inputs(duals, {u.name: u.nominal for u in self.measured}.__getitem__, SAMPLE_TIME)
        states = {name: duals.constant(x) for name, x in start(self.model, duals, inputs, known)[1].items()}
        found: dict[str, set[str]] = {name: set() for name in states}
        while True:
            grown = {
                name: {q for q, d in zip(self.adapted, x.tangents, strict=True) if d is not None} for name, x in states.items()
            }
            if all(grown[name] <= found[name] for name in found):
                return {name: tuple(q for q in self.adapted if q in of) for name, of in found.items()}
            found = {name: found[name] | grown[name] for name in found}
            states = {
                name: Dual(x.value, tuple(0.0 if q in found[name] else None for q in self.adapted))
                for name, x in states.items()
            }
            states = _stepped(self.model, duals, inputs, states, known, duals.constant(SAMPLE_TIME))[1]


def _stepped(model: Model, duals: Duals, *arguments) -> tuple[dict, dict]:
    """A step whose states are all dual, also those that an effect sets to a plain number."""
    signals, states = step(model, duals, *arguments)
    return signals, {name: duals.constant(value) for name, value in states.items()}


def _tangent(state: str, name: str) -> str:
    return f"{state}.by.{name}"


def _held(name: str) -> str:
    return f"held.{name}"


def prediction(plant: Model, adapted: tuple[str, ...], pieces: int) -> Effect:
    one = _Plant(plant, adapted, pieces)

    def taken(ops, s, x, p, dt):
        duals = Duals(ops, len(adapted))
        signals, states, known = one.advance(duals, s, x, p, dt)
        ahead = {_held(u.name): getattr(s, u.name) for u in one.measured}
        for name, of in one.depends.items():
            slopes = dict(zip(adapted, states[name].tangents, strict=True))
            ahead |= {_tangent(name, q): 0.0 if slopes[q] is None else slopes[q] for q in of}
        point = {name: signals[name].value for name in ("w", "b", "thrust_scale", *COEFFICIENTS)}
        found = {
            "plant_states": states,
            "at": SimpleNamespace(**point),
            "commanded": _normalised(x, known),
            "start_values": [getattr(p, name) for name in adapted],
            "adapted": [known[name].value for name in adapted],
            "predicted_thrust": signals["thrust"].value,
            "predicted_speed": duals.constant(signals["omega"]).value,
            "thrust_slopes": signals["thrust"].tangents,
            "speed_slopes": duals.constant(signals["omega"]).tangents,
        }
        return found, ahead

    def value(name: str) -> Callable:
        return lambda ops, s, p: one.settled(ops, s, p)[name].value

    def slope(name: str, k: int) -> Callable:
        def at_start(ops, s, p):
            d = one.settled(ops, s, p)[name].tangents[k]
            return 0.0 if d is None else d

        return at_start

    def states() -> Iterable[State]:
        for u in one.measured:
            yield State(_held(u.name), u.unit, f"{u.name} as it has acted", lambda ops, s, p, u=u: getattr(s, u.name))
        units = {x.name: x for x in one.model.states}
        for name, of in one.depends.items():
            yield State(name, units[name].unit, units[name].description, value(name), ahead_of(name))
            for q in of:
                yield State(_tangent(name, q), "1", f"by {q}", slope(name, adapted.index(q)))

    parameters = tuple(replace(p, scale="", tunable=False) for p in one.model.parameters)
    extra = tuple(u for u in one.measured if u.name in plant.measured_inputs)
    return Effect("prediction", "the plant's step with its derivatives", taken, parameters, tuple(states()), inputs=extra)


def _normalised(x: Any, known: Mapping[str, Dual]) -> tuple[Any, Any]:
    """The commands that have acted, as speed and pitch of the thrust map."""
    pitch = getattr(x, _held(BETA_REF.name)) + known["beta_offset"].value
    return getattr(x, _held(OMEGA_REF.name)) / known["omega_scale"].value, pitch / known["beta_scale"].value


def ahead_of(name: str) -> str:
    return f"ahead.{name}"


def settled_ones(plant: Model, adapted: tuple[str, ...]) -> tuple[bool, ...]:
    """For each adapted parameter, whether it changes static outputs; the others change only transients, like a lag."""
    duals, defaults = Duals(NUMBERS, len(adapted)), plant.values()
    values = {name: duals.constant(value) for name, value in defaults.items()}
    for i, name in enumerate(adapted):
        values[name] = Dual(defaults[name], tuple(1.0 if k == i else None for k in range(len(adapted))))
    inputs = {u.name: duals.constant(0.0 if u.clock else u.nominal) for u in plant.inputs}
    signals = start(plant, duals, inputs, values)[0]
    slopes = zip(signals["thrust"].tangents, duals.constant(signals["omega"]).tangents, strict=True)
    return tuple(any(d is not None and abs(d) > 0.0 for d in both) for both in slopes)
