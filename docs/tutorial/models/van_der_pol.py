"""Van der Pol's oscillator: x'' = mu (1 - x^2) x' - x + force."""

from vpp_fmu import Effect, Model, Parameter, Signal, State


def derivative(ops, s, x, p):
    return {"x": x.v, "v": p.mu * (1.0 - x.x * x.x) * x.v - x.x + s.force}


OSCILLATOR = Effect(
    "oscillator",
    "a damping that changes its sign with the amplitude",
    derivative=derivative,
    parameters=(Parameter("mu", "1", 1.0, 0.0, 100.0, "damping"),),
    states=(State("x", "1", "position", 2.0), State("v", "1", "speed", 0.0)),
    largest_step=0.01,
)
MODEL = Model(
    "VanDerPol",
    "Van der Pol's oscillator",
    inputs=(Signal("force", "1", "force"),),
    outputs=(Signal("x", "1", "position"), Signal("v", "1", "speed")),
    effects=(OSCILLATOR,),
)
