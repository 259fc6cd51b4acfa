"""The load cell's scale is off: reading = gain thrust."""

from vpp_fmu.kernel.types import Effect, Parameter


def _step(ops, s, x, p, dt):
    return {"thrust": s.thrust * p.gain}, {}


EFFECT = Effect(
    "sensor_gain",
    "scale error of the thrust reading",
    _step,
    parameters=(Parameter("gain", "1", 1.0, 0.7, 1.3, "thrust reading over thrust"),),
    off={"gain": 1.0},
    probe={"gain": 1.05},
    reading="thrust",
    says="the thrust reading is {gain} times the thrust (scale error)",
)
