"""The adaptive twin as a model: its inputs and outputs, the initial state, and the update by a sample."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import ceil

from vpp_fmu.kernel.plant import OURS
from vpp_fmu.kernel.signals import BETA_REF, OMEGA, OMEGA_REF, THRUST
from vpp_fmu.kernel.twin.innovation import innovation, motion
from vpp_fmu.kernel.twin.noises import AT_NODES, BETWEEN, NODE, SLOW_TIME, pairs
from vpp_fmu.kernel.twin.prediction import SAMPLE_TIME, ahead_of, prediction
from vpp_fmu.kernel.twin.watch import ACKNOWLEDGE, watch, watched
from vpp_fmu.kernel.types import BOOLEAN, INTEGER, Effect, Model, Parameter, Signal, State

DAILY = ("sensor_gain.gain", "pitch_offset.offset", "sensor_drift.offset")
"""Adapted by default, with each channel's slower lag: the thrust's gain, the pitch's offset, the reading's offset."""

MEMORY = 20.0
"""Distance of the operating point, in scales of the map. Random steps over the whole map cover one in 9 s, of which 0.2 counts
for a lag: 20 are 15 min. Over a record of length L exponential forgetting in T multiplies the variance by (L/2T) coth(L/2T),
1.08 at L = T; it increases the lags' standard deviation over 15 min by 9 %."""


def adapted_by_default(values: Mapping[str, float]) -> tuple[str, ...]:
    """DAILY, and the larger time constant of each channel by these values of a plant."""
    lags = (max((f"tau_{u}_1", f"tau_{u}_2"), key=lambda name: values[name]) for u in ("beta", "omega"))
    return (*DAILY, *lags)


def plausible_change(plant: Model, name: str, value: float) -> float:
    """A plausible change of a plant's parameter, in its unit: its effect's probe less its value when off; half the value of a
    permanent parameter. KeyError: the plant has none of this name."""
    for e in plant.effects:
        for p in e.parameters:
            if e.full(p.name) == name:
                probe = abs(e.probe.get(p.name, p.default) - (e.off or {}).get(p.name, p.default))
                return probe or 0.5 * abs(value) or p.nominal
    raise KeyError(name)


def twin(plant: Model, adapted: Sequence[str], sample_time: float = SAMPLE_TIME) -> Model:
    """A sampled model that runs beside the rig of `plant`, and adapts its parameters `adapted` (by full name; KeyError: it has
    none of this name).

    Its parameters are the plant's, under their names, and its own. Commands are those that act from the sample on, readings
    are those of that time. Commands that the plant delays pass a Pade dead time: a sampled law has no delay lines. If
    the plant has a largest step, `sample_time` determines its number of steps per sample, and so the longest sample time.
    """
    adapted = tuple(adapted)
    own = {p.name: p for p in plant.parameters}
    parts, followed = [own[name] for name in adapted], watched(plant, adapted)
    largest = min((e.largest_step for e in plant.effects if e.largest_step is not None), default=None)
    pieces = 1 if largest is None else ceil(sample_time / largest - 1e-9)
    longest = 0.1 if largest is None else pieces * largest
    measured = tuple(u for u in plant.inputs if not u.clock)
    extra = tuple(u for u in measured if u.name not in (OMEGA_REF.name, BETA_REF.name))
    commands = tuple(u for u in measured if u.name in (OMEGA_REF.name, BETA_REF.name))
    by_name = {y.name: y for y in plant.outputs}
    readings = by_name[THRUST.name], by_name[OMEGA.name]
    listed = ", ".join(f"{k} {name}" for k, name in enumerate(("none", *adapted)))
    outputs = (
        _like(readings[0], "predicted_thrust", "thrust by the adapted model"),
        _like(readings[1], "predicted_speed", "rotor speed by the adapted model"),
        _like(readings[0], "residual", "measured thrust above the adapted model's"),
        Signal("band", "N", "half width of the band that holds 95 % of the residuals", 0.0, 1e6, readings[0].nominal),
        Signal("alarm", "1", "the rig is not what the model says", 0.0, 1.0, kind=BOOLEAN),
        Signal("direction", "1", f"what the last alarm points to: {listed}", 0.0, float(len(adapted)), kind=INTEGER),
        Signal("changes", "1", "changes that were followed", 0.0, 1e9, kind=INTEGER),
        Signal("learning", "1", "it adapts: unless no parameter explains an alarm, until acknowledge", 1.0, 1.0, kind=BOOLEAN),
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
        outputs=outputs,
        effects=(
            adaptation(plant, parts, bounds),
            prediction(plant, adapted, pieces),
            motion(),
            innovation([name not in followed for name in adapted]),
            watch(adapted, followed, sample_time),
            update(parts),
        ),
        sample_time="sample_time",
        **OURS,
    )


def _like(signal: Signal, name: str, description: str) -> Signal:
    return Signal(name, signal.unit, description, -1e6, 1e6, signal.nominal)


def _measured(signal: Signal) -> Signal:
    said = f"measured {signal.description.removeprefix('measured ')}"
    return Signal(signal.name, signal.unit, said, signal.minimum, signal.maximum, signal.nominal)


def adaptation(plant: Model, parts: Sequence[Parameter], sample_time: Parameter) -> Effect:
    m, defaults = len(parts), plant.values()
    entries = pairs(m + 2 + len(AT_NODES))

    def prior(ops, p, q: Parameter):
        """Variance of a parameter at the start, in plausible changes: at most that of one."""
        share = getattr(p, f"prior.{q.name}") / getattr(p, f"change.{q.name}")
        return ops.minimum(share * share, 1.0)

    def step(ops, s, x, p, dt):
        return {
            "theta": [getattr(x, f"theta.{q.name}") for q in parts],
            "prior": [prior(ops, p, q) for q in parts],
            "noises": [x.slow_noise, x.between, *(getattr(x, name) for name in AT_NODES)],
            "P": {(i, j): getattr(x, f"covariance_{i}_{j}") for i, j in entries},
            "change": [getattr(p, f"change.{q.name}") for q in parts],
            "noise_model": p,
        }, {}

    def of_prior(i: int, j: int) -> Callable:
        def at_start(ops, s, p):
            if i != j:
                return 0.0
            if i < m:
                return prior(ops, p, parts[i])
            if i == m:
                return p.slow * p.slow
            share = BETWEEN if i == m + 1 else NODE
            return share * share * (p.steady * p.steady)

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
        Parameter("slow_time", "s", SLOW_TIME, 1e-3, 10.0, "correlation time of the slow noise", 0.15),
        Parameter("steady", "N", 0.03, 0.0, 1e4, "error of the model at the operating point, standard deviation", 0.05),
        Parameter("moving", "1", 0.03, 0.0, 1.0, "model error per N that its thrust moves, standard deviation", 0.05),
        Parameter("speed_error", "rpm", 20.0, 1e-3, 1e5, "error of the model's speed, standard deviation, as slow noise", 20.0),
        Parameter("memory", "1", MEMORY, 1.0, 1e9, "distance in the map's scales over which a lag is forgotten", 100.0),
    )
    states = [
        *(State(f"theta.{q.name}", "1", f"{q.name} in plausible changes", 0.0, f"next.theta.{i}") for i, q in enumerate(parts)),
        State("slow_noise", "N", "estimate of the slow noise", 0.0, "next.noise.0"),
        State("between", "N", "estimate of the model's error at this place beyond the map's", 0.0, "next.noise.1"),
        *(
            State(name, "N", "estimate of the model's error at a node of the map", 0.0, f"next.noise.{k}")
            for k, name in enumerate(AT_NODES, 2)
        ),
        *(State(f"covariance_{i}_{j}", "1", "of what is known", of_prior(i, j), f"next.P.{i}.{j}") for i, j in entries),
    ]
    said = "the parameters as they are known, and how well"
    return Effect("adaptation", said, step, (*changes(), *noise, sample_time), tuple(states))


def update(parts: Sequence[Parameter]) -> Effect:
    m = len(parts)

    def taken(ops, s, x, p, dt):
        learns, opens = s.learns > 0.5, s.opens > 0.5
        back = s.starts + s.returns > 0.5  # to the values before a change, or before an unsuccessful adaptation
        found, theta = {}, []
        for i, q in enumerate(parts):
            low, high = (q.minimum - s.start_values[i]) / s.change[i], (q.maximum - s.start_values[i]) / s.change[i]
            new = ops.clip(s.theta[i] + s.delta[i], low, high)
            theta.append(ops.where(back, s.kept[i], ops.where(learns, new, s.theta[i])))
            found[f"next.theta.{i}"] = theta[i]
        for k, noise in enumerate(s.noises):
            new = ops.where(learns, noise + s.delta[m + k], noise)
            found[f"next.noise.{k}"] = ops.where(back, s.kept[m + k - 2], new) if k > 1 else new

        # Variances are at most that of a plausible change, 1.
        shrinks = [1.0 / ops.sqrt(ops.maximum(s.learned[i, i], 1.0)) for i in range(m)]
        for i, j in s.learned:
            bounded = s.learned[i, j]
            for k in (i, j):
                bounded = bounded * shrinks[k] if k < m else bounded
            # After an alarm only the model's error over the map keeps its covariance.
            unknown = s.P[i, j]
            if i < m + 2:
                unknown = (1.0 if i < m else s.stationary[i - m]) if i == j else 0.0
            found[f"next.P.{i}.{j}"] = ops.where(opens, unknown, ops.where(learns, bounded, s.P[i, j]))

        # The filter corrects the plant's states to first order: they become those of the updated parameters.
        moved = [theta[i] - s.theta[i] for i in range(m)]
        for name, state in s.plant_states.items():
            terms = [d * by for d, by in zip(state.tangents, moved, strict=True) if d is not None]
            found[ahead_of(name)] = sum(terms, state.value)
        for i, q in enumerate(parts):
            found[f"adapted.{q.name}"] = ops.clip(s.start_values[i] + s.change[i] * theta[i], q.minimum, q.maximum)
            found[f"std.{q.name}"] = s.change[i] * ops.sqrt(ops.maximum(found[f"next.P.{i}.{i}"], 0.0))
        return found, {}

    return Effect("update", "what becomes of what is known", taken)
