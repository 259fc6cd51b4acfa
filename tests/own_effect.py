"""The README's user-defined effect, in a file as its reader would write it."""

from vpp_fmu import Effect, Parameter, State


def _step(ops, s, x, p, dt):
    reading = ops.lag_ramp(x.reading, x.before, s.thrust, ops.maximum(p.tau, 1e-4), dt)
    reading = ops.where(p.tau > 0.0, reading, s.thrust)
    return {"thrust": reading}, {"reading": reading, "before": s.thrust}


EFFECT = Effect(
    "cell_lag",
    "the load cell's amplifier is slow",
    _step,
    parameters=(Parameter("tau", "s", 0.0, 0.0, 0.3, "time constant of the amplifier"),),
    states=tuple(State(n, "N", "thrust", lambda ops, s, p: s.thrust) for n in ("reading", "before")),
    off={"tau": 0.0},
    probe={"tau": 0.05},
    largest_step=0.002,
    reading="thrust",
)
