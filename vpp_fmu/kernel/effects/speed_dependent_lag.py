"""The rotor answers faster at high speed: its drag, and with it its damping, grows with speed.

    tau / f(x) dx/dt = input - x,   f(x) = max(1 + sensitivity (x - 4000 rpm), 0.2)

Quadratic drag linearised at the present speed (paper, below eq. 10: tau = J / (k_omega + C_Q)). With f linear in x this is a
logistic equation with a closed form: with f before (at x) and ahead (at the input), g = 1 - exp(-ahead dt / tau),

    covered = (input - x) before g / (ahead + (before - ahead) g)

Exact for a held input as long as both are above the floor of 0.2, which keeps the constant finite.
"""

from vpp_fmu.kernel.effects.stage import WHICH_LAG, bent, stage
from vpp_fmu.kernel.types import Effect, Parameter

PIVOT = 4000.0  # rpm, two thirds of the paper's range
FLOOR = 0.2


def _step(ops, s, x, p, dt):
    lag = stage(ops, s, "omega", p.form)
    plain = ops.gain(lag.tau, dt)
    before = ops.maximum(1.0 + p.sensitivity * (lag.value - PIVOT), FLOOR)
    ahead = ops.maximum(1.0 + p.sensitivity * (lag.value + lag.distance / plain - PIVOT), FLOOR)
    g = ops.gain(lag.tau / ahead, dt)
    factor = before * g / (ahead + (before - ahead) * g) / plain
    return bent(ops, s, "omega", p.form, lag.distance * factor, dt, lag.tau / before), {}


EFFECT = Effect(
    "speed_dependent_lag",
    "the rotor's time constant changes with speed",
    _step,
    parameters=(
        Parameter("sensitivity", "1/rpm", 0.0, -2.5e-4, 4.2e-4, "relative gain in quickness per speed over 4000 rpm", 1e-4),
        WHICH_LAG,
    ),
    off={"sensitivity": 0.0},
    probe={"sensitivity": 1.5e-4},
    largest_step=0.002,
)
