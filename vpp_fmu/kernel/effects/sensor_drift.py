"""The thrust reading is off by a constant and drifts as the amplifier warms up, anew in each record.

    reading = thrust + offset + rate time_constant (1 - exp(-t / time_constant))

`rate` is the drift at the start; a time constant much longer than the record makes it a straight line.
"""

from vpp_fmu.kernel.types import Effect, Parameter, State


def _step(ops, s, x, p, dt):
    drift = ops.lag(x.drift, p.rate * p.time_constant, p.time_constant, dt)
    return {"thrust": s.thrust + (p.offset + drift)}, {"drift": drift}


EFFECT = Effect(
    "sensor_drift",
    "offset and warm-up drift of the thrust reading",
    _step,
    parameters=(
        Parameter("offset", "N", 0.0, -0.1, 0.1, "thrust reading without thrust, at the start", 0.01, scale="thrust"),
        Parameter("rate", "N/s", 0.0, -0.002, 0.002, "drift of the thrust reading at the start", 0.0002, scale="thrust"),
        Parameter("time_constant", "s", 1000.0, 10.0, 1000.0, "time constant of the warm-up", 100.0, limit_form="a line"),
    ),
    states=(State("drift", "N", "drift of the thrust reading so far", lambda ops, s, p: 0.0),),
    off={"offset": 0.0, "rate": 0.0},
    probe={"offset": 0.1 / 15.0, "rate": 0.0002, "time_constant": 50.0},
    reading="thrust",
    says="the thrust reading is off by {offset} at the start and drifts by {rate}",
)
