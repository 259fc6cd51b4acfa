"""The actuator board's speed law: full speed far from the goal, in proportion near it, never below a least speed.

    |dx/dt| = full                                   where |e| > threshold
            = clip(|e| / tau, slowest, full)         where accuracy < |e| < threshold
            = 0                                      where |e| < accuracy

A linear actuator control board (Actuonix LAC) turns its motor at full duty outside its threshold, scales the duty down
inside it to a minimum that still overcomes friction, and switches off within its accuracy. Acts in the inner lag. The
instants at which full speed ends and at which the motor stops are exact; in the step in which the least speed takes over,
the farther of the two ways counts.
"""

from vpp_fmu.kernel.effects.stage import INNER, bent, stage
from vpp_fmu.kernel.types import Effect, Parameter

UNLIMITED = 1000.0  # deg/s


def _step(ops, s, x, p, dt):
    lag = stage(ops, s, "beta", INNER)
    error, free = ops.abs(lag.before), ops.abs(lag.distance)
    lacks = free / ops.gain(lag.tau, dt)
    beyond = ops.maximum(error - p.threshold, lacks - p.full * lag.tau)
    ahead = ops.where(p.full < UNLIMITED, ops.clip(beyond / p.full, 0.0, dt), 0.0)
    fast = p.full * ahead + ops.gain(lag.tau, dt - ahead) * ops.maximum(lacks - p.full * ahead, 0.0)
    kept_up = ops.maximum(ops.where(ahead > 0.0, fast, free), ops.minimum(p.slowest, p.full) * dt)
    covered = ops.minimum(kept_up, ops.maximum(error - p.accuracy, 0.0))
    return bent(ops, s, "beta", INNER, ops.where(lag.before < 0.0, -covered, covered), dt), {}


EFFECT = Effect(
    "pitch_speed_limits",
    "least and full speed of the pitch actuator",
    _step,
    parameters=(
        Parameter("slowest", "deg/s", 0.0, 0.0, 15.0, "least speed on the way", 5.0, limit_form="no least speed"),
        Parameter("full", "deg/s", UNLIMITED, 4.5, UNLIMITED, "greatest speed; 1000: any", 20.0, limit_form="no limit"),
        Parameter("threshold", "deg", 60.0, 0.1, 60.0, "pitch error from which speed is full", 5.0, limit_form="no threshold"),
        Parameter("accuracy", "deg", 0.0, 0.0, 1.5, "pitch error within which the motor is off", 0.1, limit_form="never off"),
    ),
    off={"slowest": 0.0, "full": UNLIMITED, "accuracy": 0.0},
    probe={"slowest": 2.0, "full": 9.0, "threshold": 3.0, "accuracy": 0.15},
    largest_step=0.002,
    contains={"pitch_rate_limit": {"full": "rate"}, "pitch_stop_band": {"accuracy": "half_width"}},
)
