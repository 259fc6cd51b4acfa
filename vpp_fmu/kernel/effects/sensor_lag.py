"""The load cell's amplifier is a first-order low-pass, for example with capacitors across its terminals.

    time_constant d reading/dt = thrust - reading;   time_constant = 0: none

Thrust is nearly linear over a step, and the lag is exact for a ramp.
"""

from vpp_fmu.kernel.types import Effect, Parameter, State


def _at_thrust(ops, s, p):
    return s.thrust


def _step(ops, s, x, p, dt):
    slow = p.time_constant > 0.0
    lagged = ops.lag_ramp(x.reading, x.thrust_before, s.thrust, ops.where(slow, p.time_constant, 1.0), dt)
    reading = ops.where(slow, lagged, s.thrust)
    return {"thrust": reading}, {"reading": reading, "thrust_before": s.thrust}


EFFECT = Effect(
    "sensor_lag",
    "the thrust reading lags behind the thrust",
    _step,
    parameters=(
        Parameter("time_constant", "s", 0.0, 0.0, 0.6, "time constant of the thrust reading; 0: none", 0.1, scale="time"),
    ),
    states=(
        State("reading", "N", "thrust reading", _at_thrust),
        State("thrust_before", "N", "thrust at the start of the step", _at_thrust),
    ),
    off={"time_constant": 0.0},
    probe={"time_constant": 0.1},
    largest_step=0.002,
    reading="thrust",
    says="the thrust reading lags behind the thrust by {time_constant}",
)
