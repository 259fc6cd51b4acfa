"""The rotor answers faster at high speed: its drag, and with it its damping, grows with speed.

    tau / f(x) dx/dt = input - x,   f(x) = max(1 + sensitivity (x - 2/3 omega_scale), 0.2)

Quadratic drag linearised at the present speed (paper, below eq. 10: tau = J / (k_omega + C_Q)). With f linear in x this is a
logistic equation with a closed form: with f before (at x) and ahead (at the input), g = 1 - exp(-ahead dt / tau),

    covered = (input - x) before g / (ahead + (before - ahead) g)

Exact for a held input as long as both are above the floor of 0.2, which keeps the constant finite.
"""

from vpp_fmu.kernel.effects.stage import WHICH_LAG, stage, with_distance
from vpp_fmu.kernel.types import Effect, Parameter

PIVOT = 2.0 / 3.0  # of full speed: the middle of the paper's range
FLOOR = 0.2


def _step(ops, s, x, p, dt):
    lag, pivot = stage(ops, s, "omega", p.form), PIVOT * s.omega_scale
    plain = ops.gain(lag.tau, dt)
    before = ops.maximum(1.0 + p.sensitivity * (lag.value - pivot), FLOOR)
    ahead = ops.maximum(1.0 + p.sensitivity * (lag.value + lag.distance / plain - pivot), FLOOR)
    g = ops.gain(lag.tau / ahead, dt)
    factor = before * g / (ahead + (before - ahead) * g) / plain
    return with_distance(ops, s, "omega", p.form, lag.distance * factor, dt, lag.tau / before), {}


EFFECT = Effect(
    "speed_dependent_lag",
    "the rotor's time constant changes with speed",
    _step,
    parameters=(
        Parameter(
            "sensitivity",
            "1/rpm",
            0.0,
            -1.5,
            2.5,
            "relative gain in quickness per speed over two thirds of full",
            0.6,
            scale="1/speed",
        ),
        WHICH_LAG,
    ),
    off={"sensitivity": 0.0},
    probe={"sensitivity": 0.9},
    largest_step=0.002,
    channels=("omega",),
    says="the rotor's time constant changes with speed, by {sensitivity}",
)
