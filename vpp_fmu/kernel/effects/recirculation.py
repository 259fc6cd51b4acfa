"""The rotor's wake returns to it: in a closed room, or near a wall, thrust decreases as the circulation builds up.

    d wake/dt = (thrust - wake) / time_constant,   thrust -= share wake

Thrust is nearly linear over a step, and the lag is exact for a ramp. At the start the circulation is steady.
"""

from vpp_fmu.kernel.types import Effect, Parameter, State


def _at_thrust(ops, s, p):
    return s.thrust


def _step(ops, s, x, p, dt):
    wake = ops.lag_ramp(x.wake, x.thrust_before, s.thrust, p.time_constant, dt)
    return {"thrust": s.thrust - p.share * wake}, {"wake": wake, "thrust_before": s.thrust}


EFFECT = Effect(
    "recirculation",
    "thrust is lost as the room's air begins to circulate",
    _step,
    parameters=(
        Parameter("share", "1", 0.0, -0.4, 0.4, "share of thrust that is lost in the end; below 0: gained (ground)", 0.1),
        Parameter("time_constant", "s", 4.0, 1.6, 30.0, "time constant of the circulation", 4.0, scale="time"),
    ),
    states=(
        State("wake", "N", "thrust that has set air in motion", _at_thrust),
        State("thrust_before", "N", "thrust at the start of the step", _at_thrust),
    ),
    off={"share": 0.0},
    probe={"share": 0.07, "time_constant": 4.0},
    largest_step=0.002,
    says="the thrust changes by a share of {share} as the room's air begins to circulate",
)
