"""The actuator board mistakes a slow approach for a stall, and turns its motor off until the opposite command.

    slow for `time`: |dx/dt| < speed while |e| > accuracy   ->   dx/dt = 0 until e changes its sign

A linear actuator control board (Actuonix LAC) turns its motor off after the stall time below a least speed, to protect it. The
end of an exponential approach is always slow; the actuator then stops speed tau exp(-time / tau) short of its goal. Acts in
the inner lag. The instant of turning off is exact; the instant of becoming slow is exact to third order in the step (its
logarithm is approximated by a difference over a geometric mean).
"""

from vpp_fmu.kernel.effects.stage import INNER, stage, with_distance
from vpp_fmu.kernel.types import Effect, Parameter, State


def _step(ops, s, x, p, dt):
    lag = stage(ops, s, "beta", INNER)
    side = ops.where(lag.before < 0.0, -1.0, 1.0)
    to_go, free = side * lag.distance / ops.gain(lag.tau, dt), side * lag.distance
    held = side * x.latched > 0.5
    slow_at, end = p.speed * lag.tau, to_go - free
    slow, away = to_go < slow_at, side * lag.before - free > p.accuracy
    becomes = ops.where(slow, 0.0, ops.where(end < slow_at, 1.0, 0.0)) > 0.5
    mean = ops.sqrt(ops.where(becomes, to_go * slow_at, 1.0))
    since = ops.where(becomes, ops.clip(dt - lag.tau * (to_go - slow_at) / mean, 0.0, dt), 0.0)
    slow_for = ops.where(away, ops.where(slow, x.slow_for + dt, since), 0.0)
    stalls = slow_for > p.time
    covered = ops.where(stalls, ops.gain(lag.tau, ops.clip(p.time - x.slow_for, 0.0, dt)) * to_go, free)
    distance = ops.where(held, 0.0, ops.where(stalls, side * covered, lag.distance))
    latched = ops.where(held, x.latched, ops.where(stalls, side, 0.0))
    still = {"latched": latched, "slow_for": ops.where(held, 0.0, ops.where(stalls, 0.0, slow_for))}
    return with_distance(ops, s, "beta", INNER, distance, dt), still


def _nothing(ops, s, p):
    return 0.0


EFFECT = Effect(
    "pitch_stall_latch",
    "the pitch motor turns off when it is slow for too long",
    _step,
    parameters=(
        Parameter("speed", "deg/s", 0.0, 0.0, 0.5, "rate of pitch below which the motor counts as stalled", scale="pitch/time"),
        Parameter(
            "time",
            "s",
            0.6,
            0.0,
            4.0,
            "time for which it must be stalled before it turns off",
            0.2,
            limit_form="at once",
            scale="time",
        ),
        Parameter(
            "accuracy",
            "deg",
            1.0 / 150.0,
            0.0,
            0.1,
            "pitch error within which it is at its goal and not stalled",
            0.01,
            scale="pitch",
        ),
    ),
    states=(
        State("slow_for", "s", "time for which the motor has been slow", _nothing),
        State("latched", "1", "direction in which the motor is turned off: 1 up, -1 down, 0 none", _nothing),
    ),
    off={"speed": 0.0},
    probe={"speed": 0.1, "time": 0.25},
    largest_step=0.002,
    channels=("beta",),
    says="the pitch motor turns off when it is slower than {speed} for {time}",
)
