"""A vehicle with four motors of one kind: m dv/dt = sum of their forces - drag v; each motor lags behind its command."""

from vpp_fmu import Effect, Model, Parameter, Signal, State, instance

PLACES = "front_left", "front_right", "rear_left", "rear_right"


def body(ops, s, x, p):
    forces = (s.front_left.force, s.front_right.force, s.rear_left.force, s.rear_right.force)
    return {"v": (sum(forces) - p.drag * x.v) / p.m}


MOTOR = Effect(
    "motor",
    "its force lags behind the command",
    lambda ops, s, x, p, dt: {"force": ops.lag(x.force, s.command, p.tau, dt)},
    parameters=(Parameter("tau", "s", 0.1, 0.01, 10.0, "time constant"),),
    states=(State("force", "N", "force", 0.0),),
)
MASS = Parameter("m", "kg", 4.0, 0.1, 1e4, "mass"), Parameter("drag", "N.s/m", 0.8, 0.0, 1e3, "drag")
BODY = Effect("body", "moves", derivative=body, parameters=MASS, states=(State("v", "m/s", "speed", 0.0),), largest_step=0.01)
MOTORS = [e for place in PLACES for e in instance(place, [MOTOR], command=f"{place}_command")]
INPUTS = tuple(Signal(f"{place}_command", "N", "wanted force", nominal=10.0) for place in PLACES)
OUTPUTS = Signal("v", "m/s", "speed"), Signal("front_left.force", "N", "force", nominal=10.0)
MODEL = Model("Vehicle", "Four motors on a body", INPUTS, OUTPUTS, (*MOTORS, BODY))
