"""The adaptive twin: a plant that runs beside the rig, learns from what is read of it, and says when it can't.

    x, T = plant(x, u, p),   p = p0 + change theta                            the plant's own step, with its derivatives in theta
    reading = T + n1 + n2 + w,   n1 = a1 n1 + q1,   n2 = a2 n2 + q2           noise that fades in time, the model's error in place

is an extended Kalman filter in (theta, n1, n2) (Ljung, IEEE Trans. Automatic Control 24, 1979), one reading after the other. n1
is the reading's slow noise and what the model is off while thrust moves; n2 is what it is off where it stands, another one at
every place of the thrust map. Its a2 = exp(-distance / PLACE) counts how far the operating point has gone, so that a set-point
that never moves teaches no more than one visit, however long it stands. For the same reason what is known is forgotten by
distance, along the direction that is excited and no other (Kulhavy and Karny, 9th IFAC World Congress, 1984): P gains

    distance / memory  P g g' P / (g' P g),   g = d T / d theta

and stays below a plausible change's, 1. The speed's reading is another one of theta, of white noise, at each of its new values.

Five effects, one idea each; whoever reads a state of another one does so by a signal.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from math import ceil, log
from types import SimpleNamespace
from typing import Any

from vpp_fmu.kernel.duals import TINY, Dual, Duals
from vpp_fmu.kernel.effects.dead_time import dead_time
from vpp_fmu.kernel.effects.thrust_map import THRUST_MAP, normalised_thrust
from vpp_fmu.kernel.ops import NUMBERS
from vpp_fmu.kernel.plant import BETA_REF, OMEGA, OMEGA_REF, THRUST
from vpp_fmu.kernel.types import BOOLEAN, INTEGER, Effect, Model, Parameter, Signal, State, start, step

PLACE = 0.2
"""Of the scales of speed and pitch: so far apart, errors of a thrust map have little to do with each other, as
`identification.assessment.model_error` counts them."""

BLOCK, HALVES = 0.5, 0.5
"""s over which the model's error was measured, and s in which what a move leaves of it halves: likewise."""

ON_THE_WAY, SPEED_ON_THE_WAY = 0.15, 0.06
"""Of a move of thrust and of speed, what a model that is right about its end is off on the way, standard deviation: a motor that
brakes, an actuator at its fastest are far from any lag. The largest of twelve emulated rigs, each identified, under random steps
and under the controller: of thrust 0.05 to 0.15, of speed 0.02 to 0.06. Campaigns alone often show none of it."""

BORNE = 2.5
"""Standard deviations of the model's own error that half of a change which is watched for must exceed: a sum of log-likelihood
ratios falls while what there is stays below half of what it looks for, and one place in 80 is further off."""

OUTLIER = 4.0
"""Standard deviations beyond which a reading pulls no more (Huber): of normal ones, one in 16 000 goes so far."""

WITHIN = 1.96
"""Standard deviations that hold 95 %."""

SAMPLE_TIME = 0.004
"""s: the rig's tick."""

BROUGHT = ("sensor_gain", "pitch_offset", "sensor_drift")
"""Effects that a twin has in any case: what differs between two days of a rig, and is nothing in its identification."""

DAILY = ("sensor_gain.gain", "pitch_offset.offset", "sensor_drift.offset")
"""Adapted by default, with each channel's slower lag: the thrust's gain, the pitch's offset, the reading's offset."""

COEFFICIENTS = tuple(p.name for p in THRUST_MAP.parameters)


def adapted_by_default(values: Mapping[str, float]) -> tuple[str, ...]:
    """DAILY, and the larger time constant of each channel by these values of a plant."""
    lags = (max((f"tau_{u}_1", f"tau_{u}_2"), key=lambda name: values[name]) for u in ("beta", "omega"))
    return (*DAILY, *lags)


def plausible_change(plant: Model, name: str, value: float) -> float:
    """A size of a change of a plant's parameter that is worth finding, in its unit: what its effect's probe adds to what it is
    where off; half the value of what is always present. KeyError: the plant has none of this name."""
    for e in plant.effects:
        for p in e.parameters:
            if e.full(p.name) == name:
                probe = abs(e.probe.get(p.name, p.default) - (e.off or {}).get(p.name, p.default))
                return probe or 0.5 * abs(value) or p.nominal
    raise KeyError(name)


def threshold(false_alarms: float, count: int, sample_time: float) -> float:
    """Of `count` log-likelihood sums at which they alarm no more than `false_alarms` times an hour: a sum runs e^threshold
    samples on average, at least (Lorden, Annals of Mathematical Statistics 42, 1971)."""
    return log(count * 3600.0 / (false_alarms * sample_time))


def watched(plant: Model, adapted: Sequence[str]) -> tuple[str, ...]:
    """Those that a twin watches for changes of: what shows while everything stands. A lag is learned and not watched for: half as
    slow again it moves the thrust by 0.18 of a move on the way, (tau / e) (d tau / tau) / tau, where a right model is off by 0.15."""
    return tuple(name for name, one in zip(adapted, _settled_ones(plant, tuple(adapted)), strict=True) if one)


def sums(count: int) -> int:
    """How many sums watch for changes of `count` parameters: two of each, and one of none."""
    return 2 * count + 1


def twin(plant: Model, adapted: Sequence[str], sample_time: float = SAMPLE_TIME) -> Model:
    """A sampled model that runs beside what `plant` is a model of, and adapts its parameters `adapted` (by full name; KeyError:
    it has none of this name).

    Its parameters are the plant's, under their names, and its own. Commands are those that act from the sample on, readings as
    they stand there. Commands that the plant holds back pass a Pade dead time instead: a sampled law has no delay lines. What
    the plant's forms are good for in one step decides how many it takes in a sample, at most `sample_time` where that matters.
    """
    adapted = tuple(adapted)
    own = {p.name: p for p in plant.parameters}
    parts = [own[name] for name in adapted]
    largest = min((e.largest_step for e in plant.effects if e.largest_step is not None), default=None)
    pieces = 1 if largest is None else ceil(sample_time / largest - 1e-9)
    longest = 0.1 if largest is None else pieces * largest
    measured = tuple(u for u in plant.inputs if not u.clock)
    extra = tuple(u for u in measured if u.name not in (OMEGA_REF.name, BETA_REF.name))
    commands = tuple(u for u in measured if u.name in (OMEGA_REF.name, BETA_REF.name))
    by_name = {y.name: y for y in plant.outputs}
    readings = by_name[THRUST.name], by_name[OMEGA.name]
    told = (
        _like(readings[0], "predicted_thrust", "thrust by the adapted model"),
        _like(readings[1], "predicted_speed", "rotor speed by the adapted model"),
        _like(readings[0], "residual", "measured thrust above the adapted model's"),
        Signal("band", "N", "half width of the band that holds 95 % of the residuals", 0.0, 1e6, readings[0].nominal),
        Signal("alarm", "1", "the rig is not what the model says", 0.0, 1.0, kind=BOOLEAN),
        Signal("direction", "1", f"what the last alarm points to: {_listed(adapted)}", 0.0, float(len(adapted)), kind=INTEGER),
        Signal("changes", "1", "changes that were followed", 0.0, 1e9, kind=INTEGER),
        *(Signal(f"adapted.{p.name}", p.unit, f"adapted: {p.description}", p.minimum, p.maximum, p.nominal) for p in parts),
        *(
            Signal(f"std.{p.name}", p.unit, f"standard deviation: {p.description}", 0.0, p.maximum - p.minimum, p.nominal)
            for p in parts
        ),
    )
    bounds = Parameter("sample_time", "s", min(sample_time, longest), 1e-5, longest, "period at which it samples", 0.004)
    return Model(
        "VppTwin",
        "Adaptive twin: the plant beside the rig, its parameters as they are now, and an alarm where no parameter explains it",
        inputs=(*commands, *(_measured(y) for y in readings), *extra, ACKNOWLEDGE),
        outputs=told,
        effects=(
            _adaptation(plant, parts, bounds),
            _prediction(plant, adapted, pieces),
            _innovation(_settled_ones(plant, adapted)),
            _watch(adapted, watched(plant, adapted), sample_time),
            _update(parts),
        ),
        sample_time="sample_time",
    )


ACKNOWLEDGE = Signal("acknowledge", "1", "somebody has seen the alarm: adapt again", 0.0, 1.0, kind=BOOLEAN)


def _like(signal: Signal, name: str, description: str) -> Signal:
    return Signal(name, signal.unit, description, -1e6, 1e6, signal.nominal)


def _measured(signal: Signal) -> Signal:
    said = f"measured {signal.description.removeprefix('measured ')}"
    return Signal(signal.name, signal.unit, said, signal.minimum, signal.maximum, signal.nominal)


def _listed(names: Iterable[str]) -> str:
    return ", ".join(["0 none", *(f"{k} {name}" for k, name in enumerate(names, 1))])


def _nothing(ops, s, p):
    return 0.0


def _pairs(n: int) -> list[tuple[int, int]]:
    """Places in the upper triangle of n x n."""
    return [(i, j) for i in range(n) for j in range(i, n)]


def _times(P: Mapping, g: Sequence) -> list:
    """P g of a symmetric matrix by its upper triangle; None in g is 0."""
    rows = []
    for i in range(len(g)):
        terms = [P[min(i, j), max(i, j)] * x for j, x in enumerate(g) if x is not None]
        rows.append(sum(terms[1:], terms[0]))
    return rows


def _dot(g: Sequence, x: Sequence) -> Any:
    terms = [a * b for a, b in zip(g, x, strict=False) if a is not None]
    return sum(terms[1:], terms[0])


# --- what is known: theta, the two noises and their covariance -----------------------------------------------------------------


def _adaptation(plant: Model, parts: Sequence[Parameter], sample_time: Parameter) -> Effect:
    m, defaults = len(parts), plant.values()
    pairs = _pairs(m + 2)

    def step(ops, s, x, p, dt):
        return {
            "theta": [getattr(x, f"theta.{q.name}") for q in parts],
            "noises": [x.slow_noise, x.map_error],
            "P": {(i, j): getattr(x, f"covariance.{i}.{j}") for i, j in pairs},
            "change": [getattr(p, f"change.{q.name}") for q in parts],
            "noise_model": p,
        }, {}

    def of_prior(i: int, j: int) -> Callable:
        def at_start(ops, s, p):
            if i != j:
                return 0.0
            if i < m:
                share = getattr(p, f"prior.{parts[i].name}") / getattr(p, f"change.{parts[i].name}")
                return ops.minimum(share * share, 1.0)
            return p.slow * p.slow if i == m else p.steady * p.steady

        return at_start

    def changes() -> Iterable[Parameter]:
        for q in parts:
            size = plausible_change(plant, q.name, defaults[q.name])
            span = q.maximum - q.minimum
            said = f"a change of {q.name} that is watched for, and how far it is learned after an alarm"
            yield Parameter(f"change.{q.name}", q.unit, size, 1e-6 * span, span, said, q.nominal)
            said = f"standard deviation of {q.name} at the start"
            yield Parameter(f"prior.{q.name}", q.unit, size, 0.0, span, said, q.nominal)

    noise = (
        Parameter("white", "N", 0.05, 1e-6, 1e4, "white noise of the thrust reading, standard deviation", 0.05),
        Parameter("slow", "N", 0.02, 0.0, 1e4, "slow noise of the thrust reading, standard deviation", 0.05),
        Parameter("slow_time", "s", 0.15, 1e-3, 10.0, "correlation time of the slow noise", 0.15),
        Parameter("steady", "N", 0.03, 0.0, 1e4, "error of the model where it stands, standard deviation", 0.05),
        Parameter(
            "moving", "1", 0.03, 0.0, 1.0, "error of the model for each N that its thrust moves, standard deviation", 0.05
        ),
        Parameter(
            "speed_error",
            "rpm",
            20.0,
            1e-3,
            1e5,
            "error of the model's speed, standard deviation; it lasts as slow noise",
            20.0,
        ),
        Parameter(
            "memory", "1", MEMORY, 10.0, 1e9, "distance after which what is known counts 1/e, in scales of the map", 100.0
        ),
    )
    states = [
        *(
            State(f"theta.{q.name}", "1", f"{q.name} in plausible changes", _nothing, f"next.theta.{i}")
            for i, q in enumerate(parts)
        ),
        State("slow_noise", "N", "estimate of the slow noise", _nothing, "next.noise.0"),
        State("map_error", "N", "estimate of the model's error at this place", _nothing, "next.noise.1"),
        *(State(f"covariance.{i}.{j}", "1", "of what is known", of_prior(i, j), f"next.P.{i}.{j}") for i, j in pairs),
    ]
    said = "the parameters as they are known, and how well"
    return Effect("adaptation", said, step, (*changes(), *noise, sample_time), tuple(states))


MEMORY = 400.0
"""Scales of the map that the operating point goes. Random steps over the whole of it make 3 in 5 s: of a run of 20 min the half.
Exponential forgetting over half of a record costs 15 % of the standard deviation: (L/2T) coth(L/2T) = 1.31 of the variance at
L = 2T."""


# --- the plant's step, on dual numbers -----------------------------------------------------------------------------------------


def _sampled(plant: Model) -> Model:
    """The plant with a dead time in the place of each delay, which the schedule of a sampled law doesn't have."""
    return replace(plant, effects=tuple(_held_back(e) if e.delays else e for e in plant.effects))


def _held_back(e: Effect) -> Effect:
    def step(ops, s, x, p, dt):
        late, ahead = {}, {}
        for u, delay in e.delays.items():
            # The command stands over the step: to the dead time it is as if it had stood there before.
            told = SimpleNamespace(before=getattr(s, u), behind=getattr(x, f"{u}.behind"), rate=getattr(x, f"{u}.rate"))
            late[u], after = dead_time(ops, told.before, told, getattr(p, delay), dt)
            ahead |= {f"{u}.behind": after["behind"], f"{u}.rate": after["rate"]}
        return late, ahead

    def states() -> Iterable[State]:
        for u in e.delays:
            yield State(f"{u}.behind", "1", f"{u} behind two lags", lambda ops, s, p, u=u: getattr(s, u))
            yield State(f"{u}.rate", "1/s", "rate of that", _nothing)

    return replace(e, step=step, states=(*e.states, *states()), delays={})


class _Plant:
    """The plant on dual numbers: its states and which of their derivatives are none by structure."""

    def __init__(self, plant: Model, adapted: tuple[str, ...], pieces: int):
        self.model, self.adapted, self.pieces = _sampled(plant), adapted, pieces
        self.measured = [u for u in plant.inputs if not u.clock]
        self._clocks = [u.name for u in plant.inputs if u.clock]
        self._own = {p.name: p for p in plant.parameters}
        self.depends = self._structure()
        self._settled: tuple = (None, None, {})

    def values(self, duals: Duals, s: Any, p: Any) -> dict[str, Dual]:
        """All parameters, with the adapted ones where they are now, inside their bounds."""
        found = {name: duals.constant(getattr(p, name)) for name in self._own}
        for i, name in enumerate(self.adapted):
            q = self._own[name]
            now = duals.ops.clip(getattr(p, name) + s.change[i] * s.theta[i], q.minimum, q.maximum)
            found[name] = Dual(now, tuple(s.change[i] if k == i else None for k in range(len(self.adapted))))
        return found

    def inputs(self, duals: Duals, told: Callable[[str], Any], dt: Any) -> dict[str, Dual]:
        """Commands and what is measured, by name; a clock has the sample's time."""
        return {u.name: duals.constant(told(u.name)) for u in self.measured} | {u: duals.constant(dt) for u in self._clocks}

    def settled(self, ops: Any, s: Any, p: Any) -> dict[str, Dual]:
        """The states settled on the inputs. A start asks for one state at a time: the last answer is kept."""
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
        """On which adapted parameters each state depends: what a start and as many steps as it takes make of it."""
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


def _stepped(model: Model, duals: Duals, *told) -> tuple[dict, dict]:
    """A step whose states are all dual, also those that an effect sets to a plain number."""
    signals, states = step(model, duals, *told)
    return signals, {name: duals.constant(value) for name, value in states.items()}


def _tangent(state: str, name: str) -> str:
    return f"{state}.by.{name}"


def _held(name: str) -> str:
    return f"held.{name}"


def _prediction(plant: Model, adapted: tuple[str, ...], pieces: int) -> Effect:
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
            yield State(name, units[name].unit, units[name].description, value(name), _ahead(name))
            for q in of:
                yield State(_tangent(name, q), "1", f"by {q}", slope(name, adapted.index(q)))

    parameters = tuple(replace(p, scale="", tunable=False) for p in one.model.parameters)
    extra = tuple(u for u in one.measured if u.name in plant.measured_inputs)
    return Effect("prediction", "the plant's step with its derivatives", taken, parameters, tuple(states()), inputs=extra)


def _ahead(name: str) -> str:
    return f"ahead.{name}"


# --- what the readings say -----------------------------------------------------------------------------------------------------


def _settled_ones(plant: Model, adapted: tuple[str, ...]) -> tuple[bool, ...]:
    """Of each adapted parameter, whether it shows while everything stands; the others show on the way alone, as a lag does."""
    duals, defaults = Duals(NUMBERS, len(adapted)), plant.values()
    values = {name: duals.constant(value) for name, value in defaults.items()}
    for i, name in enumerate(adapted):
        values[name] = Dual(defaults[name], tuple(1.0 if k == i else None for k in range(len(adapted))))
    inputs = {u.name: duals.constant(0.0 if u.clock else u.nominal) for u in plant.inputs}
    signals = start(plant, duals, inputs, values)[0]
    slopes = zip(signals["thrust"].tangents, duals.constant(signals["omega"]).tangents, strict=True)
    return tuple(any(d is not None and abs(d) > 0.0 for d in both) for both in slopes)


def _innovation(settled: tuple[bool, ...]) -> Effect:
    m = len(settled)

    def taken(ops, s, x, p, dt):
        known, at, before = s.noise_model, s.at, SimpleNamespace(**{n: getattr(s.at, n) for n in COEFFICIENTS})
        # A point that plays within half a place has gone nowhere: what follows it is drawn along behind.
        dw, db = at.w - x.w_place, at.b - x.b_place
        away = ops.sqrt(dw * dw + db * db)
        gone = ops.maximum(away - 0.5 * PLACE, 0.0)
        drawn = gone / ops.maximum(away, 0.5 * PLACE)
        by_speed = normalised_thrust(before, at.w, x.b) - normalised_thrust(before, x.w, x.b)
        by_pitch = normalised_thrust(before, at.w, at.b) - normalised_thrust(before, at.w, x.b)
        moves = at.thrust_scale * (ops.abs(by_speed) + ops.abs(by_pitch))
        move = ops.exp(dt * (log(HALVES) / BLOCK)) * x.move + moves

        # A block's mean of first-order noise has a share of its variance; what the model is off in a move is known by blocks.
        share = known.slow_time / BLOCK
        averaged = 2.0 * share * (1.0 - share * (1.0 - ops.exp(-1.0 / share)))
        rough = known.moving * known.moving / averaged + ON_THE_WAY * ON_THE_WAY
        fading, staying = known.slow * known.slow + rough * move * move, known.steady * known.steady
        keeps = ops.exp(-dt / known.slow_time), ops.exp(-gone / PLACE)
        noises, P = [a * n for a, n in zip(keeps, s.noises, strict=True)], dict(s.P)
        for k, (a, variance) in enumerate(zip(keeps, (fading, staying), strict=True)):
            for i in range(m + 2):
                P[min(i, m + k), max(i, m + k)] = P[min(i, m + k), max(i, m + k)] * a
            P[m + k, m + k] = P[m + k, m + k] * a + (1.0 - a * a) * variance
        g = (*s.thrust_slopes, 1.0, 1.0)
        residual = s.thrust - s.predicted_thrust
        Pg = _times(P, g)
        S = _dot(g, Pg) + known.white * known.white
        innovation = residual - noises[0] - noises[1]
        limit = OUTLIER * ops.sqrt(S)
        pulls = ops.clip(innovation, -limit, limit)
        own = _times({key: P[key] for key in _pairs(m)}, s.thrust_slopes)
        spread = _dot(s.thrust_slopes, own)

        # What a model is off on the way is no noise: it comes back with each move. What shows where all stands is learned on the
        # way only while it is known to less than that.
        on_the_way = rough * move * move
        standing = staying / (staying + on_the_way)
        coarse = (spread + staying) / (spread + staying + on_the_way)
        weights = [coarse if one else 1.0 for one in (*settled, False, False)]
        K = [w * v / S for w, v in zip(weights, Pg, strict=True)]
        # The speed is read once a revolution. What the model is off lasts: as white noise of a sample it is that much more.
        learned = {(i, j): P[i, j] - (K[i] * Pg[j] + Pg[i] * K[j] - K[i] * K[j] * S) for i, j in P}
        fresh = ops.where(s.omega < x.speed, 1.0, ops.where(s.omega > x.speed, 1.0, 0.0))
        turned = ops.exp(dt * (log(HALVES) / BLOCK)) * x.turned + ops.abs(s.predicted_speed - x.predicted)
        off = known.speed_error * known.speed_error + (SPEED_ON_THE_WAY * turned) * (SPEED_ON_THE_WAY * turned)
        lasting = off * (2.0 * known.slow_time / dt)
        h = (*s.speed_slopes, None, None)
        said = {
            "moved": gone,
            "move": move,
            "residual": residual,
            "innovation": innovation,
            "pulls": pulls,
            "S": S,
            "keeps": keeps,
        }
        said["standing"], said["on_the_way"] = standing, on_the_way
        delta = [k * pulls for k in K]
        if all(d is None for d in s.speed_slopes):
            speed = None
        else:
            Ph = _times(learned, h)
            variance = _dot(h, Ph) + lasting
            misses = s.omega - s.predicted_speed - _dot(s.speed_slopes, delta)
            limit = OUTLIER * ops.sqrt(variance)
            misses = ops.clip(misses, -limit, limit)
            speed = SimpleNamespace(fresh=fresh, misses=misses, variance=variance)
            gain = [fresh * v / variance for v in Ph]
            learned = {(i, j): learned[i, j] - gain[i] * Ph[j] for i, j in learned}
            delta = [d + k * misses for d, k in zip(delta, gain, strict=True)]
        # What is known of the excited direction is forgotten as the operating point goes on.
        forgets = gone / known.memory / ops.maximum(spread, 1e-300)
        for i, j in _pairs(m):
            learned[i, j] = learned[i, j] + forgets * own[i] * own[j]
        said |= {
            "band": WITHIN * ops.sqrt(spread + fading + staying + known.white * known.white),
            "gain": K,
            "speed": speed,
            "learned": learned,
            "delta": delta,
            "noises": noises,
            "stationary": (fading, staying),
        }
        ahead = {
            "w_place": x.w_place + drawn * dw,
            "b_place": x.b_place + drawn * db,
            "w": at.w,
            "b": at.b,
            "move": move,
            "speed": s.omega,
            "predicted": s.predicted_speed,
            "turned": turned,
        }
        return said, ahead

    states = (
        State("w_place", "1", "normalised speed of the place that it is at", lambda ops, s, p: s.at.w),
        State("b_place", "1", "normalised pitch of the place that it is at", lambda ops, s, p: s.at.b),
        State("w", "1", "normalised speed at the last sample", lambda ops, s, p: s.at.w),
        State("b", "1", "normalised pitch at the last sample", lambda ops, s, p: s.at.b),
        State("move", "N", "what is left of the thrust's moves", _nothing),
        State("speed", "rpm", "last reading of the speed", lambda ops, s, p: s.omega),
        State("predicted", "rpm", "predicted speed at the last sample", lambda ops, s, p: s.predicted_speed),
        State("turned", "rpm", "what is left of the speed's moves", _nothing),
    )
    return Effect("innovation", "what the readings add to what is known", taken, states=states)


# --- whether a parameter explains it -------------------------------------------------------------------------------------------

UP, DOWN = "up", "down"
WATCHING, FOLLOWING, STOPPED = 0.0, 1.0, 2.0


def _watch(adapted: tuple[str, ...], names: tuple[str, ...], sample_time: float) -> Effect:
    m, places = len(adapted), [adapted.index(name) for name in names]

    def taken(ops, s, x, p, dt):
        watching = ops.where(x.mode < 0.5, 1.0, 0.0)
        found, ahead = [], {}
        for i, name in zip(places, names, strict=True):
            heights = []
            for sign, way in ((1.0, UP), (-1.0, DOWN)):
                more, shape, absorbed = _ratio(s, x, i, sign, f"{name}.{way}")
                height = watching * ops.maximum(getattr(x, f"sum.{name}.{way}") + more, 0.0)
                ahead[f"sum.{name}.{way}"] = height
                heights.append(height)
                for k, a in enumerate(absorbed):
                    after = a if shape is None else a + s.gain[m + k] * shape
                    ahead[f"absorbed.{name}.{way}.{k}"] = ops.where(height > 0.0, after, 0.0)
            found.append(ops.maximum(*heights))

        # Ordinary innovations against such of twice the variance.
        unlike = s.standing * (0.25 * s.pulls * s.pulls / s.S - 0.5 * log(2.0))
        nothing_else = watching * ops.maximum(x.unlike + unlike, 0.0)
        largest = nothing_else
        for height in found:
            largest = ops.maximum(largest, height)
        starts = ops.where(largest > p.threshold, watching, 0.0)
        points, best = 0.0, 0.0
        for i, height in zip(places, found, strict=True):
            points, best = ops.where(height > best, float(i + 1), points), ops.maximum(height, best)

        # After an alarm: Wald's test of the same ratio, once as many places were seen as there are parameters to tell apart.
        following = ops.where(x.mode > 0.5, ops.where(x.mode < 1.5, 1.0, 0.0), 0.0)
        doubt = following * ops.maximum(x.doubt + unlike, -p.threshold)
        seen = following * (x.seen + s.moved)
        explained = ops.where(doubt < 1e-9 - p.threshold, ops.where(seen > m * PLACE, following, 0.0), 0.0)
        stops = ops.where(doubt > p.threshold, following, 0.0)
        stopped = ops.where(x.mode > 1.5, 1.0, 0.0)
        goes_on = ops.where(s.acknowledge > 0.5, stopped, 0.0)

        # Which parameter has moved by most plausible changes, as far as it is known.
        moved_most, most = x.direction, 0.0
        for i in range(m):
            by = s.theta[i] - getattr(x, f"kept.{i}")
            sure = by * by * (1.0 - s.P[i, i])
            moved_most, most = ops.where(sure > most, float(i + 1), moved_most), ops.maximum(sure, most)
        direction = ops.where(starts > 0.5, points, ops.where(explained > 0.5, moved_most, x.direction))
        mode = ops.where(
            starts > 0.5,
            FOLLOWING,
            ops.where(stops > 0.5, STOPPED, ops.where(explained + goes_on > 0.5, WATCHING, x.mode)),
        )
        changes = x.changes + explained
        kept = [ops.where(starts > 0.5, s.theta[i], getattr(x, f"kept.{i}")) for i in range(m)]
        ahead |= {
            "unlike": nothing_else,
            "doubt": ops.where(starts > 0.5, 0.0, doubt),
            "seen": ops.where(starts > 0.5, 0.0, seen),
            "mode": mode,
            "direction": direction,
            "changes": changes,
            **{f"kept.{i}": value for i, value in enumerate(kept)},
        }
        said = {
            "alarm": ops.where(mode > 0.5, 1.0, 0.0),
            "direction": direction,
            "changes": changes,
            "opens": starts + goes_on,
            "returns": stops,
            "learns": ops.where(mode > 1.5, 0.0, ops.where(x.mode > 1.5, 0.0, 1.0)),
            "kept": kept,
        }
        return said, ahead

    def states() -> Iterable[State]:
        for name in names:
            for way in (UP, DOWN):
                yield State(f"sum.{name}.{way}", "1", f"log-likelihood ratio of a change of {name}, {way}", _nothing)
                for k in range(2):
                    said = "what of such a change the noises' estimates have taken up"
                    yield State(f"absorbed.{name}.{way}.{k}", "N", said, _nothing)
        yield State("unlike", "1", "log-likelihood ratio of twice the variance", _nothing)
        yield State("doubt", "1", "the same since an alarm", _nothing)
        yield State("seen", "1", "how far the operating point has gone since an alarm", _nothing)
        yield State("mode", "1", "0 watches, 1 follows a change, 2 has stopped", _nothing)
        yield State("direction", "1", "what the last alarm points to", _nothing)
        yield State("changes", "1", "changes that were followed", _nothing)
        for i, name in enumerate(adapted):
            yield State(f"kept.{i}", "1", f"{name} before the alarm, in plausible changes", _nothing)

    usual = threshold(0.01, sums(len(names)), sample_time)
    said = "log-likelihood ratio at which a change counts as one: ln(sums x samples between false alarms)"
    parameters = (Parameter("threshold", "1", usual, 1.0, 1000.0, said, 20.0),)
    return Effect(
        "watch", "whether a parameter explains what is read", taken, parameters, tuple(states()), inputs=(ACKNOWLEDGE,)
    )


def _ratio(s: Any, x: Any, i: int, sign: float, name: str) -> tuple[Any, Any, list]:
    """(what a sample adds to the log-likelihood ratio of a change of theta_i by `sign`, what it makes of the innovation, what the
    noises' estimates have of it already). The ratio is of normal innovations; what they take up of a change is none of it. A power of it below 1
    bears innovations that are not independent, and is no larger on average (Jensen)."""
    absorbed = [a * getattr(x, f"absorbed.{name}.{k}") for k, a in enumerate(s.keeps)]
    more, shape, by_thrust = 0.0, None, s.thrust_slopes[i]
    if by_thrust is not None:
        looked_for = by_thrust * by_thrust
        counts = looked_for / (looked_for + (2.0 * BORNE) * (2.0 * BORNE) * s.on_the_way + TINY)
        shape = by_thrust - absorbed[0] - absorbed[1]
        more = counts * (sign * s.pulls - 0.5 * shape) * shape / s.S
    by_speed = s.speed_slopes[i]
    if by_speed is not None:
        more = more + s.speed.fresh * (sign * s.speed.misses - 0.5 * by_speed) * by_speed / s.speed.variance
    return more, shape, absorbed


# --- what becomes of it --------------------------------------------------------------------------------------------------------


def _update(parts: Sequence[Parameter]) -> Effect:
    m = len(parts)

    def taken(ops, s, x, p, dt):
        learns, opens = s.learns > 0.5, s.opens > 0.5
        told, theta = {}, []
        for i, q in enumerate(parts):
            low, high = (q.minimum - s.start_values[i]) / s.change[i], (q.maximum - s.start_values[i]) / s.change[i]
            new = ops.clip(s.theta[i] + s.delta[i], low, high)
            theta.append(ops.where(s.returns > 0.5, s.kept[i], ops.where(learns, new, s.theta[i])))
            told[f"next.theta.{i}"] = theta[i]
        for k in range(2):
            told[f"next.noise.{k}"] = ops.where(learns, s.noises[k] + s.delta[m + k], s.noises[k])

        # What is known stays below what is known of a plausible change, whose variance is 1.
        shrinks = [1.0 / ops.sqrt(ops.maximum(s.learned[i, i], 1.0)) for i in range(m)] + [1.0, 1.0]
        for i, j in s.learned:
            bounded = s.learned[i, j] * (shrinks[i] * shrinks[j])
            unknown = (1.0 if i < m else s.stationary[i - m]) if i == j else 0.0
            told[f"next.P.{i}.{j}"] = ops.where(opens, unknown, ops.where(learns, bounded, s.P[i, j]))

        # The plant's states are where these parameters would have taken them, to first order: the filter's own correction.
        moved = [theta[i] - s.theta[i] for i in range(m)]
        for name, state in s.plant_states.items():
            terms = [d * by for d, by in zip(state.tangents, moved, strict=True) if d is not None]
            told[_ahead(name)] = sum(terms, state.value)
        for i, q in enumerate(parts):
            told[f"adapted.{q.name}"] = ops.clip(s.start_values[i] + s.change[i] * theta[i], q.minimum, q.maximum)
            told[f"std.{q.name}"] = s.change[i] * ops.sqrt(ops.maximum(told[f"next.P.{i}.{i}"], 0.0))
        return told, {}

    return Effect("update", "what becomes of what is known", taken)
