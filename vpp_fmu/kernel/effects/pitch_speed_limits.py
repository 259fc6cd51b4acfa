"""The actuator board's speed law: full speed far from the goal, proportional near it, never below a least speed.

    |dx/dt| = full                                   where |e| > threshold
            = clip(|e| / tau, slowest, full)         where accuracy < |e| < threshold
            = 0                                      where |e| < accuracy

A linear actuator control board (Actuonix LAC) turns its motor at full duty outside its threshold, scales the duty down
inside it to a minimum that still overcomes friction, and switches off within its accuracy. Acts in the inner lag. The
instants at which full speed ends and at which the motor stops are exact; in the step in which the least speed takes over,
the larger of the two distances is used.
"""

from vpp_fmu.kernel.effects.stage import INNER, stage, with_distance
from vpp_fmu.kernel.types import Effect, Parameter

UNLIMITED = 10000.0  # deg/s; no blade turns 30 times a second


def _step(ops, s, x, p, dt):
    lag = stage(ops, s, "beta", INNER)
    error, free = ops.abs(lag.before), ops.abs(lag.distance)
    to_go = free / ops.gain(lag.tau, dt)
    beyond = ops.maximum(error - p.threshold, to_go - p.full * lag.tau)
    ahead = ops.where(p.full < UNLIMITED, ops.clip(beyond / p.full, 0.0, dt), 0.0)
    fast = p.full * ahead + ops.gain(lag.tau, dt - ahead) * ops.maximum(to_go - p.full * ahead, 0.0)
    kept_up = ops.maximum(ops.where(ahead > 0.0, fast, free), ops.minimum(p.slowest, p.full) * dt)
    covered = ops.minimum(kept_up, ops.maximum(error - p.accuracy, 0.0))
    return with_distance(ops, s, "beta", INNER, ops.where(lag.before < 0.0, -covered, covered), dt), {}


EFFECT = Effect(
    "pitch_speed_limits",
    "least and full speed of the pitch actuator",
    _step,
    parameters=(
        Parameter(
            "slowest", "deg/s", 0.0, 0.0, 0.5, "least speed on the way", 0.2, limit_form="no least speed", scale="pitch/time"
        ),
        Parameter(
            "full",
            "deg/s",
            UNLIMITED,
            0.15,
            UNLIMITED,
            "greatest speed; 10000: any",
            0.6,
            limit_form="no limit",
            scale="pitch/time",
            unlimited=UNLIMITED,
        ),
        Parameter(
            "threshold",
            "deg",
            4.0,
            1.0 / 150.0,
            4.0,
            "pitch error from which speed is full",
            0.3,
            limit_form="no threshold",
            scale="pitch",
        ),
        Parameter(
            "accuracy",
            "deg",
            0.0,
            0.0,
            0.1,
            "pitch error within which the motor is off",
            0.01,
            limit_form="never off",
            scale="pitch",
        ),
    ),
    off={"slowest": 0.0, "full": UNLIMITED, "accuracy": 0.0},
    probe={"slowest": 1.0 / 15.0, "full": 0.3, "threshold": 0.2, "accuracy": 0.01},
    largest_step=0.002,
    contains={"pitch_rate_limit": {"full": "rate"}, "pitch_stop_band": {"accuracy": "half_width"}},
    channels=("beta",),
    says="the speed of the pitch actuator is limited (least {slowest}, full {full})",
)
