"""Distance of the operating point, and the filter's update by one sample."""

from collections.abc import Mapping, Sequence
from math import log
from types import SimpleNamespace
from typing import Any

from vpp_fmu.kernel.effects.thrust_map import normalised_thrust
from vpp_fmu.kernel.twin.noises import (
    BETWEEN,
    BLOCK,
    HALVES,
    ON_THE_WAY,
    OUTLIER,
    PLACE,
    SPEED_ON_THE_WAY,
    WITHIN,
    dot,
    pairs,
    times,
    weights,
)
from vpp_fmu.kernel.types import Effect, State


def motion() -> Effect:
    """Distance of the operating point, decaying sums of its moves, and the model error that they cause."""

    def taken(ops, s, x, p, dt):
        known, at = s.noise_model, s.at
        # Moves within half of PLACE cover no distance: the reference point follows with a dead band.
        dw, db = at.w - x.w_place, at.b - x.b_place
        away = ops.sqrt(dw * dw + db * db)
        gone = ops.maximum(away - 0.5 * PLACE, 0.0)
        drawn = gone / ops.maximum(away, 0.5 * PLACE)
        halved = ops.exp(dt * (log(HALVES) / BLOCK))
        moved = halved * x.move + _path(ops, at, (x.w, x.b), (at.w, at.b))
        turned = halved * x.turned + ops.abs(s.predicted_speed - x.predicted)
        # A late model has an error from the beginning of a move, so the rest of the move counts as well.
        move = moved + _path(ops, at, (at.w, at.b), s.commanded)

        # The mean of first-order noise over a block has a share of its variance; the model error in a move is that of blocks.
        share = known.slow_time / BLOCK
        averaged = 2.0 * share * (1.0 - share * (1.0 - ops.exp(-1.0 / share)))
        on_the_way = (known.moving * known.moving / averaged + ON_THE_WAY * ON_THE_WAY) * move * move
        fading, staying = known.slow * known.slow + on_the_way, known.steady * known.steady
        # The error of the model's speed is correlated in time: equivalent white noise has a larger variance.
        off = known.speed_error * known.speed_error + (SPEED_ON_THE_WAY * turned) * (SPEED_ON_THE_WAY * turned)
        said = {
            "moved": gone,
            "on_the_way": on_the_way,
            "stationary": (fading, BETWEEN * BETWEEN * staying),
            "keeps": (ops.exp(-dt / known.slow_time), ops.exp(-gone / PLACE)),
            "shares": (1.0, 1.0, *weights(ops, at.w, at.b)),
            "band": (fading, staying),
            "standing": staying / (staying + on_the_way),
            "lasting": off * (2.0 * known.slow_time / dt),
        }
        ahead = {"w_place": x.w_place + drawn * dw, "b_place": x.b_place + drawn * db, "w": at.w, "b": at.b}
        return said, ahead | {"move": moved, "turned": turned, "predicted": s.predicted_speed}

    states = (
        State("w_place", "1", "normalised speed of the place that it is at", lambda ops, s, p: s.at.w),
        State("b_place", "1", "normalised pitch of the place that it is at", lambda ops, s, p: s.at.b),
        State("w", "1", "normalised speed at the last sample", lambda ops, s, p: s.at.w),
        State("b", "1", "normalised pitch at the last sample", lambda ops, s, p: s.at.b),
        State("move", "N", "decaying sum of the thrust's moves", 0.0),
        State("turned", "rpm", "decaying sum of the speed's moves", 0.0),
        State("predicted", "rpm", "predicted speed at the last sample", lambda ops, s, p: s.predicted_speed),
    )
    return Effect("motion", "how far the operating point has gone", taken, states=states)


def _path(ops: Any, at: Any, start: Sequence, end: Sequence) -> Any:
    """Sum of the thrust's changes [N] between two points of the map, by speed and then by pitch."""
    (w, b), (w_end, b_end) = start, end
    by_speed = normalised_thrust(at, w_end, b) - normalised_thrust(at, w, b)
    by_pitch = normalised_thrust(at, w_end, b_end) - normalised_thrust(at, w_end, b)
    return at.thrust_scale * (ops.abs(by_speed) + ops.abs(by_pitch))


def innovation(forgotten: Sequence[bool]) -> Effect:
    """The filter's update by one sample. `forgotten`: of each parameter, whether its information decays with the distance."""
    m = len(forgotten)

    def taken(ops, s, x, p, dt):
        known = s.noise_model
        noises, P = _faded(s, m)
        white = known.white * known.white
        Pg = times(P, (*s.thrust_slopes, *s.shares))
        S = dot((*s.thrust_slopes, *s.shares), Pg) + white
        residual = s.thrust - s.predicted_thrust
        limit = OUTLIER * ops.sqrt(S)
        pulls = ops.clip(residual - dot(s.shares, noises), -limit, limit)
        spread = dot(s.thrust_slopes, times({key: P[key] for key in pairs(m)}, s.thrust_slopes))
        K = [v / S for v in Pg]
        learned = {(i, j): P[i, j] - K[i] * Pg[j] for i, j in P}
        delta = [k * pulls for k in K]
        speed = None
        if any(d is not None for d in s.speed_slopes):
            speed, learned, delta = _by_speed(ops, s, x, learned, delta)
        # Forgetting: with the distance, and as far as a change of the parameter would be visible.
        wider = {}
        for i, d in enumerate(s.thrust_slopes):
            if forgotten[i] and d is not None:
                wider[i] = ops.sqrt(1.0 + s.moved / known.memory * (d * d / (d * d + S)))
        for at in learned:
            for k in at:
                learned[at] = learned[at] * wider[k] if k in wider else learned[at]
        band = WITHIN * ops.sqrt(spread + sum(s.band) + white)
        said = {"residual": residual, "band": band, "pulls": pulls, "S": S, "speed": speed}
        said["takes"] = K[m], K[m + 1], dot(s.shares[2:], K[m + 2 :])
        return said | {"learned": learned, "delta": delta, "noises": noises}, {"speed": s.omega}

    state = State("speed", "rpm", "last reading of the speed", lambda ops, s, p: s.omega)
    return Effect("innovation", "what the readings add to what is known", taken, states=(state,))


def _faded(s: Any, m: int) -> tuple[list, dict]:
    """(estimates of the noises, covariance) a sample later: decayed, with new noise that keeps the stationary variance."""
    P, noises = dict(s.P), list(s.noises)
    for k, (a, variance) in enumerate(zip(s.keeps, s.stationary, strict=True)):
        noises[k] = a * noises[k]
        for i in range(m + len(noises)):
            at = min(i, m + k), max(i, m + k)
            P[at] = P[at] * a
        P[m + k, m + k] = P[m + k, m + k] * a + (1.0 - a * a) * variance
    return noises, P


def _by_speed(ops: Any, s: Any, x: Any, P: Mapping, delta: Sequence) -> tuple[SimpleNamespace, dict, list]:
    """(innovation of the speed, covariance, update) after a reading of the speed, if its value is new."""
    Ph = times(P, (*s.speed_slopes, *[None] * len(s.noises)))
    variance = dot(s.speed_slopes, Ph) + s.lasting
    limit = OUTLIER * ops.sqrt(variance)
    misses = ops.clip(s.omega - s.predicted_speed - dot(s.speed_slopes, delta), -limit, limit)
    fresh = ops.where(s.omega < x.speed, 1.0, ops.where(s.omega > x.speed, 1.0, 0.0))
    gain = [fresh * v / variance for v in Ph]
    after = {(i, j): P[i, j] - gain[i] * Ph[j] for i, j in P}
    one = SimpleNamespace(fresh=fresh, misses=misses, variance=variance)
    return one, after, [d + k * misses for d, k in zip(delta, gain, strict=True)]
