"""The actuator's motor is off while the pitch error is small.

    tau dx/dt = e where |e| > half_width, else 0;   e = input - x

A linear actuator control board stops its motor within its accuracy (Actuonix LAC: 0.39 % of the stroke as delivered), since
it would hunt otherwise. The motor stops at the edge of the band, also between samples. The outer lag, whose input moves, also
starts at the edge, and follows a slowly moving input at a distance of half_width.
"""

from vpp_fmu.kernel.effects.pitch_stop_restart import driven_between
from vpp_fmu.kernel.effects.stage import WHICH_LAG, stage, with_distance
from vpp_fmu.kernel.types import Effect, Parameter


def _step(ops, s, x, p, dt):
    lag = stage(ops, s, "beta", p.form)
    distance, _ = driven_between(ops, lag, 0.0, p.half_width, p.half_width, dt)
    return with_distance(ops, s, "beta", p.form, distance, dt), {}


EFFECT = Effect(
    "pitch_stop_band",
    "the pitch motor is off near its goal",
    _step,
    parameters=(
        Parameter("half_width", "deg", 0.0, 0.0, 0.1, "pitch error within which the motor is off", scale="pitch"),
        WHICH_LAG,
    ),
    off={"half_width": 0.0},
    probe={"half_width": 0.03},
    largest_step=0.002,
    channels=("beta",),
    says="the pitch motor is off within {half_width} of its goal",
)
