"""What the readings add to what is known: how far the operating point has gone, and the filter's update by one sample."""

from collections.abc import Mapping, Sequence
from math import log
from types import SimpleNamespace
from typing import Any

from vpp_fmu.kernel.duals import TINY
from vpp_fmu.kernel.effects.thrust_map import normalised_thrust
from vpp_fmu.kernel.twin.noises import (
    BLOCK,
    HALVES,
    ON_THE_WAY,
    OUTLIER,
    PLACE,
    SPEED_ON_THE_WAY,
    WITHIN,
    dot,
    nothing,
    pairs,
    times,
)
from vpp_fmu.kernel.types import Effect, State


def motion() -> Effect:
    """How far the operating point has gone, what is left of its moves, and what the model is off by that."""

    def taken(ops, s, x, p, dt):
        known, at = s.noise_model, s.at
        # A point that plays within half a place has gone nowhere: what follows it is drawn along behind.
        dw, db = at.w - x.w_place, at.b - x.b_place
        away = ops.sqrt(dw * dw + db * db)
        gone = ops.maximum(away - 0.5 * PLACE, 0.0)
        drawn = gone / ops.maximum(away, 0.5 * PLACE)
        by_speed = normalised_thrust(at, at.w, x.b) - normalised_thrust(at, x.w, x.b)
        by_pitch = normalised_thrust(at, at.w, at.b) - normalised_thrust(at, at.w, x.b)
        halved = ops.exp(dt * (log(HALVES) / BLOCK))
        move = halved * x.move + at.thrust_scale * (ops.abs(by_speed) + ops.abs(by_pitch))
        turned = halved * x.turned + ops.abs(s.predicted_speed - x.predicted)

        # A block's mean of first-order noise has a share of its variance; what the model is off in a move is known by blocks.
        share = known.slow_time / BLOCK
        averaged = 2.0 * share * (1.0 - share * (1.0 - ops.exp(-1.0 / share)))
        on_the_way = (known.moving * known.moving / averaged + ON_THE_WAY * ON_THE_WAY) * move * move
        fading, staying = known.slow * known.slow + on_the_way, known.steady * known.steady
        # What a model's speed is off lasts as well: as white noise of a sample it is that much more.
        off = known.speed_error * known.speed_error + (SPEED_ON_THE_WAY * turned) * (SPEED_ON_THE_WAY * turned)
        said = {
            "moved": gone,
            "on_the_way": on_the_way,
            "stationary": (fading, staying),
            "keeps": (ops.exp(-dt / known.slow_time), ops.exp(-gone / PLACE)),
            "standing": staying / (staying + on_the_way),
            "lasting": off * (2.0 * known.slow_time / dt),
        }
        ahead = {"w_place": x.w_place + drawn * dw, "b_place": x.b_place + drawn * db, "w": at.w, "b": at.b}
        return said, ahead | {"move": move, "turned": turned, "predicted": s.predicted_speed}

    states = (
        State("w_place", "1", "normalised speed of the place that it is at", lambda ops, s, p: s.at.w),
        State("b_place", "1", "normalised pitch of the place that it is at", lambda ops, s, p: s.at.b),
        State("w", "1", "normalised speed at the last sample", lambda ops, s, p: s.at.w),
        State("b", "1", "normalised pitch at the last sample", lambda ops, s, p: s.at.b),
        State("move", "N", "what is left of the thrust's moves", nothing),
        State("turned", "rpm", "what is left of the speed's moves", nothing),
        State("predicted", "rpm", "predicted speed at the last sample", lambda ops, s, p: s.predicted_speed),
    )
    return Effect("motion", "how far the operating point has gone", taken, states=states)


def innovation(settled: tuple[bool, ...]) -> Effect:
    """The filter's update by one sample. `settled`: of each adapted parameter, whether it shows while everything stands."""
    m = len(settled)

    def taken(ops, s, x, p, dt):
        known = s.noise_model
        noises, P = _faded(s, m)
        white = known.white * known.white
        Pg = times(P, (*s.thrust_slopes, 1.0, 1.0))
        S = dot((*s.thrust_slopes, 1.0, 1.0), Pg) + white
        residual = s.thrust - s.predicted_thrust
        limit = OUTLIER * ops.sqrt(S)
        pulls = ops.clip(residual - noises[0] - noises[1], -limit, limit)
        own = times({key: P[key] for key in pairs(m)}, s.thrust_slopes)
        spread = dot(s.thrust_slopes, own)

        # What a model is off on the way is no noise: it comes back with each move. What shows where all stands is learned there
        # only while it is known to less than that. A gain that isn't the best one leaves more (Joseph's form).
        fading, staying = s.stationary
        coarse = (spread + staying) / (spread + staying + s.on_the_way)
        K = [(coarse if i < m and settled[i] else 1.0) * v / S for i, v in enumerate(Pg)]
        learned = {(i, j): P[i, j] - (K[i] * Pg[j] + Pg[i] * K[j] - K[i] * K[j] * S) for i, j in P}
        delta = [k * pulls for k in K]
        speed = None
        if any(d is not None for d in s.speed_slopes):
            speed, learned, delta = _by_speed(ops, s, x, learned, delta)
        # What is known of the excited direction is forgotten as the operating point goes on.
        forgets = s.moved / known.memory / ops.maximum(spread, TINY)
        for i, j in pairs(m):
            learned[i, j] = learned[i, j] + forgets * own[i] * own[j]
        band = WITHIN * ops.sqrt(spread + fading + staying + white)
        said = {"residual": residual, "band": band, "pulls": pulls, "S": S, "gain": K, "speed": speed}
        return said | {"learned": learned, "delta": delta, "noises": noises}, {"speed": s.omega}

    state = State("speed", "rpm", "last reading of the speed", lambda ops, s, p: s.omega)
    return Effect("innovation", "what the readings add to what is known", taken, states=(state,))


def _faded(s: Any, m: int) -> tuple[list, dict]:
    """(estimates of the noises, covariance) a sample on: the noises fade, and others come in their place."""
    P = dict(s.P)
    for k, (a, variance) in enumerate(zip(s.keeps, s.stationary, strict=True)):
        for i in range(m + 2):
            at = min(i, m + k), max(i, m + k)
            P[at] = P[at] * a
        P[m + k, m + k] = P[m + k, m + k] * a + (1.0 - a * a) * variance
    return [a * n for a, n in zip(s.keeps, s.noises, strict=True)], P


def _by_speed(ops: Any, s: Any, x: Any, P: Mapping, delta: Sequence) -> tuple[SimpleNamespace, dict, list]:
    """(innovation of the speed, covariance, update) behind a reading of the speed, where it is a new one."""
    Ph = times(P, (*s.speed_slopes, None, None))
    variance = dot(s.speed_slopes, Ph) + s.lasting
    limit = OUTLIER * ops.sqrt(variance)
    misses = ops.clip(s.omega - s.predicted_speed - dot(s.speed_slopes, delta), -limit, limit)
    fresh = ops.where(s.omega < x.speed, 1.0, ops.where(s.omega > x.speed, 1.0, 0.0))
    gain = [fresh * v / variance for v in Ph]
    after = {(i, j): P[i, j] - gain[i] * Ph[j] for i, j in P}
    one = SimpleNamespace(fresh=fresh, misses=misses, variance=variance)
    return one, after, [d + k * misses for d, k in zip(delta, gain, strict=True)]
