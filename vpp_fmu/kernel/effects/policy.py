"""A learned control law: a small network or a linear law on scaled observations, with limits and a fallback to the dual PID.

    z = (observation - mean) / scale
    h = f(W_1 z + b_1), ..., a = W_n h + b_n                    f: tanh or max(., 0); one layer: a linear law
    command = low + (high - low) (a + 1) / 2, or the last command + a rate dt       a held to -1 ... 1
    command held to rate dt about the last one, then to the limits

The dual PID takes over if an observation is outside of its box, or if z' P z > distance^2 (P: inverse covariance of the
observations in training). It acts for `fallback_hold` seconds after that, twice as long at each further takeover: a law that
drives itself out of its box ends in the fallback. While the law acts, the integrals of the PID are set so that
its commands are those of the law: the takeover is bumpless. Before the first sample the commands are the lowest ones.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

from vpp_fmu.kernel.effects.dual_pid import ALLOCATION, DUAL_PID
from vpp_fmu.kernel.types import Effect, Parameter, State

OBSERVABLE = {
    "thrust_set": "N",
    "thrust": "N",
    "omega": "rpm",
    "omega_ref": "rpm",
    "beta_ref": "deg",
    "integral": "N.s",
}
"""Observations and their units: set-point and reading of thrust, reading of speed, the last commands, and the integral of
set-point less reading. The integral stops while both commands are at their limits in the direction of the error. The policy's
FMU has an input for the speed only if the speed is observed."""

UNLIMITED = 1e9
"""Rate of a command, rpm/s or deg/s, that means no limit."""

LARGEST_INTEGRAL, LONGEST_HOLD = 1e6, 1e6
"""N.s; s"""

Number = float | str
"""A weight: its value, or the name of the parameter that holds it."""


@dataclass(frozen=True)
class Law:
    """The law without its limits. `layers`: (weights (outputs, inputs), biases (outputs,)) of each; the last gives speed and
    pitch. `observe`: names of OBSERVABLE, followed by `history` earlier readings of thrust, the latest first; `mean`,
    `scale`, `low`, `high` have a value for each, in its unit. `rate`: actions are rates. `squash`: tanh of the last layer.
    `precision` (observations, observations): P; `distance`: largest allowed."""

    observe: tuple[str, ...]
    mean: tuple[float, ...]
    scale: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    layers: tuple[tuple[tuple[tuple[Number, ...], ...], tuple[Number, ...]], ...]
    activation: str = "tanh"
    history: int = 0
    rate: bool = False
    squash: bool = False
    precision: tuple[tuple[float, ...], ...] = ()
    distance: float = 0.0


def policy_effect(law: Law) -> Effect:
    """The law as the one effect of a sampled model, with limits, rates and the gains of its fallback as parameters."""
    names = [name for weights, biases in law.layers for row in (*weights, biases) for name in row if isinstance(name, str)]

    def step(ops, s, x, p, dt):
        running = x.running > 0.5
        first = {"omega_ref": p.omega_min, "beta_ref": p.beta_min}
        before = {u: ops.where(running, getattr(x, f"{u}_before"), start) for u, start in first.items()}
        past = [ops.where(running, getattr(x, f"thrust_{k}"), s.thrust) for k in range(1, law.history + 1)]
        named = {**vars(s), **before, "integral": x.integral}
        seen = [*(named[name] for name in law.observe), *past]
        z = [(o - m) / c for o, m, c in zip(seen, law.mean, law.scale, strict=True)]
        outside = _outside(ops, law, seen, z)
        active = ops.where(outside > 0.5, 1.0, ops.where(x.fallback_left > 0.0, 1.0, 0.0))
        pid, memory = DUAL_PID.step(ops, s, x, SimpleNamespace(**ALLOCATION, **vars(p)), dt)
        wanted = dict(zip(first, _network(ops, law, z, p), strict=True))
        commands = {}
        for u in ("omega", "beta"):
            u_ref, low, high = f"{u}_ref", getattr(p, f"{u}_min"), getattr(p, f"{u}_max")
            move = getattr(p, f"{u}_rate") * dt
            action = ops.clip(wanted[u_ref], -1.0, 1.0)
            asked = before[u_ref] + action * move if law.rate else low + (high - low) * (0.5 * (action + 1.0))
            asked = ops.where(active > 0.5, pid[u_ref], asked)
            asked = ops.minimum(ops.maximum(asked, before[u_ref] - move), before[u_ref] + move)
            commands[u_ref] = ops.minimum(ops.maximum(asked, low), high)
        memory |= _tracked(ops, p, commands, memory, active)
        memory |= {f"{u}_before": value for u, value in commands.items()}
        memory |= {f"thrust_{k}": value for k, value in enumerate([s.thrust, *past[:-1]][: law.history], 1)}
        memory["integral"] = ops.where(active > 0.5, 0.0, _grown(ops, x.integral, s, before, p, dt))
        again = ops.maximum(p.fallback_hold, 2.0 * x.fallback_hold_last)
        hold = ops.where(active > x.fallback_active + 0.5, ops.minimum(again, LONGEST_HOLD), x.fallback_hold_last)
        memory |= {"fallback_active": active, "fallback_hold_last": hold}
        memory["fallback_left"] = ops.where(outside > 0.5, hold, ops.maximum(x.fallback_left - dt, 0.0))
        return {**commands, "fallback": active, **{f"seen_{k}": o for k, o in enumerate(seen)}}, memory

    return Effect(
        "policy",
        "a learned law on the thrust error, with the dual PID to fall back on",
        step,
        parameters=(
            *(q for q in DUAL_PID.parameters if q.name not in ALLOCATION),
            _rate("omega", "rpm/s", "speed"),
            _rate("beta", "deg/s", "pitch"),
            Parameter("fallback_hold", "s", 1.0, 0.0, 1e4, "how long the fallback acts after a bad observation, at first"),
            *(Parameter(name, "1", 0.0, -1e6, 1e6, "weight of the network") for name in names),
        ),
        states=(
            *(replace(x, start=_nothing) for x in DUAL_PID.states),  # the mode, too: the fallback has no parameter for it
            State("omega_ref_before", "rpm", "last commanded speed", _nothing),
            State("beta_ref_before", "deg", "last commanded pitch", _nothing),
            State("integral", "N.s", "integral of set-point less reading", _nothing),
            State("fallback_left", "s", "how long the fallback still acts", _nothing),
            State("fallback_active", "1", "whether the fallback acts", _nothing),
            State("fallback_hold_last", "s", "how long it acts after a bad observation since it took over", _nothing),
            *(State(f"thrust_{k}", "N", f"thrust as read, {k} samples ago", _nothing) for k in range(1, law.history + 1)),
        ),
    )


def _rate(u: str, unit: str, title: str) -> Parameter:
    text = f"fastest change of the commanded {title}; {UNLIMITED:g}: unlimited"
    return Parameter(f"{u}_rate", unit, UNLIMITED, 0.0, UNLIMITED, text, unlimited=UNLIMITED, tunable=True)


def _nothing(ops, s, p):
    return 0.0


def _outside(ops: Any, law: Law, seen: Sequence, z: Sequence) -> Any:
    """1 if an observation is NaN, or outside of its box or distance; else 0."""
    outside = 0.0
    for o, low, high in zip(seen, law.low, law.high, strict=True):
        inside = ops.where(o > low, ops.where(o < high, 1.0, 0.0), 0.0)
        outside = ops.where(inside > 0.5, outside, 1.0)
    if law.precision:
        distance = _dot(z, [_dot(row, z) for row in law.precision])
        outside = ops.where(distance < law.distance * law.distance, outside, 1.0)
    return outside


def _grown(ops: Any, integral: Any, s: SimpleNamespace, before: dict, p: SimpleNamespace, dt: Any) -> Any:
    """The next integral: it stops while both commands are at their limits in the direction of the error."""
    error = s.thrust_set - s.thrust
    below = ops.where(before["omega_ref"] < p.omega_max, 1.0, ops.where(before["beta_ref"] < p.beta_max, 1.0, 0.0))
    above = ops.where(before["omega_ref"] > p.omega_min, 1.0, ops.where(before["beta_ref"] > p.beta_min, 1.0, 0.0))
    moves = ops.where(error > 0.0, below, above)
    grown = ops.clip(integral + error * dt, -LARGEST_INTEGRAL, LARGEST_INTEGRAL)
    return ops.where(moves > 0.5, grown, integral)


def _network(ops: Any, law: Law, z: Sequence, p: SimpleNamespace) -> list:
    """The outputs (2,) of the layers on scaled observations."""

    def number(weight: Number):
        return getattr(p, weight) if isinstance(weight, str) else weight

    for k, (weights, biases) in enumerate(law.layers, 1):
        z = [_dot(map(number, row), z) + number(b) for row, b in zip(weights, biases, strict=True)]
        if k < len(law.layers):
            z = [ops.tanh(v) if law.activation == "tanh" else ops.maximum(v, 0.0) for v in z]
    return [ops.tanh(v) for v in z] if law.squash else list(z)


def _dot(one: Iterable, other: Iterable) -> Any:
    """Scalar product, summed in pairs: few dependent operations, and few nested brackets in generated code."""
    terms = [a * b for a, b in zip(one, other, strict=True)]
    while len(terms) > 1:
        terms = [a + b for a, b in zip(terms[::2], terms[1::2], strict=False)] + list(terms[len(terms) // 2 * 2 :])
    return terms[0]


def _tracked(ops: Any, p: SimpleNamespace, commands: dict, memory: dict, active: Any) -> dict:
    """Integrals for which the PID's commands equal those of the law; its own integrals while it acts."""
    reached = {
        "omega": commands["omega_ref"] / p.omega_scale,
        "beta": (commands["beta_ref"] + p.beta_offset) / p.beta_scale,
    }
    found = {}
    for u, command in reached.items():
        kp, ki, kd = (getattr(p, f"{k}_{u}") for k in ("kp", "ki", "kd"))
        integrates = ki > 0.0
        held = (command - kp * memory["error"] - kd * memory["rate"]) / ops.where(integrates, ki, 1.0)
        own = memory[f"{u}_integral"]
        found[f"{u}_integral"] = ops.where(active > 0.5, own, ops.where(integrates, held, own))
    return found
