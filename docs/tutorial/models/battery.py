"""A battery: voltage = ocv(charge) - R0 i - u, tau du/dt = R1 i - u, d(charge)/dt = -i / (3600 Q); i is held."""

from vpp_fmu import Effect, Model, Parameter, Signal, State

CHARGE, OCV = (0.0, 0.05, 0.1, 0.3, 0.6, 0.9, 1.0), (3.0, 3.35, 3.5, 3.65, 3.8, 4.05, 4.2)


def step(ops, s, x, p, dt):
    return {"charge": x.charge - s.i * dt / (3600.0 * p.Q), "u": ops.lag(x.u, p.R1 * s.i, p.tau, dt)}


def output(ops, s, x, p):
    return {"voltage": ops.table(x.charge, CHARGE, OCV, "cubic") - p.R0 * s.i - x.u, "charge": x.charge}


PARAMETERS = tuple(Parameter(name, "Ohm", 0.02, 0.0, 1.0, "resistance") for name in ("R0", "R1"))
PARAMETERS += Parameter("Q", "1", 2.5, 0.1, 100.0, "capacity, A h"), Parameter("tau", "s", 20.0, 0.1, 1e3, "of the RC")
STATES = State("charge", "1", "state of charge", 0.9), State("u", "V", "voltage of the RC", 0.0)
CELL = Effect("cell", "voltage by a table, and one RC", step, PARAMETERS, STATES, output=output)
OUTPUTS = Signal("voltage", "V", "at the terminals"), Signal("charge", "1", "state of charge")
MODEL = Model("Battery", "A battery cell", (Signal("i", "A", "current drawn", nominal=5.0),), OUTPUTS, (CELL,))
