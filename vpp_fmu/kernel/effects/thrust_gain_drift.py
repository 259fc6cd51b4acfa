"""Thrust for the same speed and pitch changes as the rig warms up, anew in each record.

    thrust *= 1 + drift,   d drift/dt = (rate time_constant heat - drift) / time_constant,   drift(0) = 0
    form 1: heat = 1 (time alone);   form 2: heat = thrust / thrust_scale (load)

Motor, blades or load cell get warm. `rate` is the drift at the start, at full load in form 2; a time constant much longer
than the record makes it a straight line.
"""

from vpp_fmu.kernel.types import Effect, Parameter, State


def _heat(ops, s, p):
    return ops.where(p.form < 1.5, 1.0, s.thrust / s.thrust_scale)


def _step(ops, s, x, p, dt):
    heat, full = _heat(ops, s, p), p.rate * p.time_constant
    drift = ops.lag_ramp(x.drift, full * x.heat, full * heat, p.time_constant, dt)
    return {"thrust": s.thrust * (1.0 + drift)}, {"drift": drift, "heat": heat}


EFFECT = Effect(
    "thrust_gain_drift",
    "thrust changes as the rig warms up",
    _step,
    parameters=(
        Parameter("rate", "1/s", 0.0, -0.05, 0.05, "relative drift of thrust per time, at the start", 0.0005),
        Parameter("time_constant", "s", 1000.0, 10.0, 1000.0, "time constant of the warm-up", 100.0, limit_form="a line"),
        Parameter("form", "1", 1.0, 1.0, 2.0, "1 warms up with time, 2 with load", choices=(1.0, 2.0)),
    ),
    states=(
        State("drift", "1", "relative change of thrust so far", lambda ops, s, p: 0.0),
        State("heat", "1", "what warms the rig, at the start of the step", _heat),
    ),
    off={"rate": 0.0},
    probe={"rate": -0.001, "time_constant": 50.0},
    says="the thrust drifts by {rate} as the rig warms up",
)
