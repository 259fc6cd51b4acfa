"""Hidden effects of the air on the blades."""

from hil.physics.propeller import force_factor, settled_inflow, thrust_coefficient
from vpp_fmu.kernel.types import Effect, Parameter, State

ROUNDS = 8
"""Fixed-point iterations. Twist takes a tenth of the pitch's own effect or less, so each of them gains a digit."""


def _settled_twist(ops, s, p):
    twist = 0.0
    for _ in range(ROUNDS):
        twist = p.compliance * _settled_thrust(ops, s, s.beta - twist)
    return twist


def _settled_load(ops, s, p):
    return _settled_thrust(ops, s, s.beta - _settled_twist(ops, s, p))


def _settled_thrust(ops, s, beta):
    coefficient = thrust_coefficient(ops, s.blades, beta, settled_inflow(ops, s.blades, beta))
    return force_factor(s.blades) * s.shaft_speed * s.shaft_speed * coefficient


def _twist(ops, s, x, p, dt):
    twist = ops.lag(x.twist, p.compliance * x.load, p.time_constant, dt)
    return {"beta": s.beta - twist}, {"twist": twist}


BLADE_TORSION = Effect(
    "blade_torsion",
    "thrust twists the blades to less pitch",
    _twist,
    parameters=(
        Parameter("compliance", "deg/N", 0.0, 0.0, 0.3, "pitch lost per thrust", 0.1),
        Parameter("time_constant", "s", 0.005, 0.001, 0.1, "time that twisting takes", 0.01),
    ),
    states=(
        State("twist", "deg", "twist of the blades", _settled_twist),
        State("load", "N", "thrust at the end of a step", _settled_load, closed_by="lift"),
    ),
    off={"compliance": 0.0},
    probe={"compliance": 0.1},
)


def _return(ops, s, x, p, dt):
    room = ops.lag(x.room, p.share * s.inflow, p.time_constant, dt)
    return {"inflow": s.inflow + room, "inflow_between": s.inflow_between + 0.5 * (x.room + room)}, {"room": room}


RECIRCULATION = Effect(
    "room_recirculation",
    "the wake comes back through the room: more inflow, less thrust",
    _return,
    parameters=(
        Parameter("share", "1", 0.0, 0.0, 1.0, "inflow that comes back, over the rotor's own", 0.1),
        Parameter("time_constant", "s", 3.0, 0.2, 60.0, "time until it comes back"),
    ),
    states=(State("room", "1", "inflow ratio that the room adds", lambda ops, s, p: p.share * s.inflow),),
    off={"share": 0.0},
    probe={"share": 0.1},
)
