"""A rod of ten thermal nodes: C dT_k/dt = G (T_(k-1) - 2 T_k + T_(k+1)), its ends at two given temperatures."""

from vpp_fmu import Effect, Model, Parameter, Signal, State

N = 10


def derivative(ops, s, x, p):
    T = [s.hot, *x.T, s.cold]
    return {"T": [p.G / p.C * (T[k - 1] - 2.0 * T[k] + T[k + 1]) for k in range(1, N + 1)]}


ROD = Effect(
    "rod",
    "conduction from node to node",
    derivative=derivative,
    parameters=(Parameter("G", "W/K", 2.0, 0.0, 100.0, "conductance"), Parameter("C", "J/K", 10.0, 0.1, 1e4, "capacity")),
    states=(State("T", "degC", "temperatures", 20.0, size=N),),
    largest_step=0.25,
)
ENDS = tuple(Signal(name, "degC", f"the {name} end", nominal=100.0, start=20.0) for name in ("hot", "cold"))
MODEL = Model("Rod", "A rod of ten thermal nodes", ENDS, (Signal("T", "degC", "temperatures", size=N),), (ROD,))
