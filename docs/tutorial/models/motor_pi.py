"""A motor under a PI law: L di/dt = u - R i - K w, J dw/dt = K i - b w - load, u = kp e + ki integral(e), e = wanted - w."""

from vpp_fmu import Effect, Model, Parameter, Signal, State

P = {"L": ("H", 0.01), "R": ("Ohm", 1.0), "K": ("N.m/A", 0.1), "J": ("kg.m2", 0.001), "b": ("N.m.s", 0.001)}
P |= {"kp": ("V.s", 0.5), "ki": ("V", 5.0)}


def derivative(ops, s, x, p):
    e = s.wanted - x.w
    u = p.kp * e + p.ki * x.e
    return {"i": (u - p.R * x.i - p.K * x.w) / p.L, "w": (p.K * x.i - p.b * x.w - s.load) / p.J, "e": e}


MOTOR = Effect(
    "motor",
    "a DC motor and its PI law",
    derivative=derivative,
    method="exact",  # it is linear, so any step is exact
    parameters=tuple(Parameter(name, unit, value, 1e-6, 1e3, name) for name, (unit, value) in P.items()),
    states=(State("i", "A", "current", 0.0), State("w", "rad/s", "speed", 0.0), State("e", "rad", "integral of e", 0.0)),
)
INPUTS = Signal("wanted", "rad/s", "wanted speed", nominal=100.0), Signal("load", "N.m", "load", nominal=0.1)
MODEL = Model("MotorPI", "A motor under a PI law", INPUTS, (Signal("w", "rad/s", "speed", nominal=100.0),), (MOTOR,))
