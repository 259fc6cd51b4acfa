"""An unbalanced rotor shakes the load cell once a revolution.

    reading = thrust + amplitude w^2 sin(2 pi turns + phase),   d turns/dt = omega / 60

The force of an imbalance is proportional to speed squared. Speed is nearly linear over a step; whole turns are dropped.
`phase` is the rotor's angle at the start of a record.
"""

from math import pi

from vpp_fmu.kernel.types import Effect, Parameter, State


def _step(ops, s, x, p, dt):
    turns = x.turns + (x.omega_before + s.omega) * dt / 120.0
    turns = turns - ops.where(turns < 1.0, 0.0, ops.where(turns < 2.0, 1.0, 2.0))
    shake = p.amplitude * s.w * s.w * ops.sin(2.0 * pi * turns + pi / 180.0 * p.phase)
    return {"thrust": s.thrust + shake}, {"turns": turns, "omega_before": s.omega}


EFFECT = Effect(
    "rotor_vibration",
    "the rotor shakes the load cell once a revolution",
    _step,
    parameters=(
        Parameter(
            "amplitude",
            "N",
            0.0,
            0.0,
            0.1,
            "amplitude of the vibration in the reading, at full speed (w = 1)",
            0.01,
            scale="thrust",
        ),
        Parameter("phase", "deg", 0.0, -180.0, 180.0, "phase of the vibration at the start", 90.0, initial=True),
    ),
    states=(
        State("turns", "1", "revolutions since the start, without the whole ones", lambda ops, s, p: 0.0),
        State("omega_before", "rpm", "rotor speed at the start of the step", lambda ops, s, p: s.omega),
    ),
    off={"amplitude": 0.0},
    probe={"amplitude": 0.1 / 15.0},
    largest_step=0.002,
    common=0.05,
    says="the rotor shakes the load cell by {amplitude} once a revolution",
)
