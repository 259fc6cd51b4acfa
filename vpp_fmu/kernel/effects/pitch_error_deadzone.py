"""A small position error does not move the actuator; of a larger one only the excess acts.

    tau dx/dt = e - clip(e, -half_width, half_width),   e = input - x

Causes are static friction, or an amplifier with a minimum voltage for the motor: the actuator comes to rest half_width short
of its command, on the side from which it came. The form is exact in the inner lag for a held command. The outer lag, whose
input moves within the step, uses the mean of its error.
"""

from vpp_fmu.kernel.effects.stage import WHICH_LAG, stage, with_distance
from vpp_fmu.kernel.types import Effect, Parameter


def _step(ops, s, x, p, dt):
    lag = stage(ops, s, "beta", p.form)
    lost = ops.gain(lag.tau, dt) * p.half_width
    return with_distance(ops, s, "beta", p.form, lag.distance - ops.clip(lag.distance, -lost, lost), dt), {}


EFFECT = Effect(
    "pitch_error_deadzone",
    "small pitch errors do not move the actuator",
    _step,
    parameters=(
        Parameter("half_width", "deg", 0.0, 0.0, 0.15, "pitch error at which the actuator begins to move", scale="pitch"),
        WHICH_LAG,
    ),
    off={"half_width": 0.0},
    probe={"half_width": 0.04},
    largest_step=0.002,
    channels=("beta",),
    says="the pitch actuator does not move for errors below {half_width} (dead zone)",
)
