"""The stand swings: the load cell reads thrust through a lightly damped spring and mass.

    y'' + 2 damping w0 y' + w0^2 y = w0^2 thrust,   w0 = 2 pi frequency;   frequency = 0: a rigid stand

Exact for thrust that is linear over the step. A stand of any size is built stiff, so `frequency` has no scale.
"""

from math import pi

from vpp_fmu.kernel.types import Effect, Parameter, State


def _step(ops, s, x, p, dt):
    soft = p.frequency > 0.0
    w0 = 2.0 * pi * ops.where(soft, p.frequency, 1.0)
    a = p.damping * w0
    wd = w0 * ops.sqrt(1.0 - p.damping * p.damping)
    left, c, r = ops.exp(-a * dt), ops.cos(wd * dt), ops.sin(wd * dt) / wd
    slope = (s.thrust - x.thrust_before) / dt
    lagging = 2.0 * p.damping / w0 * slope
    z = x.reading - (x.thrust_before - lagging)
    v = x.velocity - slope
    reading = s.thrust - lagging + left * (c * z + r * (v + a * z))
    velocity = slope + left * (c * v - r * (w0 * w0 * z + a * v))
    reading = ops.where(soft, reading, s.thrust)
    return {"thrust": reading}, {"thrust_before": s.thrust, "reading": reading, "velocity": velocity}


def _at_thrust(ops, s, p):
    return s.thrust


EFFECT = Effect(
    "stand_resonance",
    "the stand swings on the load cell",
    _step,
    parameters=(
        Parameter("frequency", "Hz", 0.0, 0.0, 100.0, "natural frequency of the stand; 0: rigid", 10.0),
        Parameter("damping", "1", 0.05, 0.005, 0.3, "damping ratio of the stand", 0.1),
    ),
    states=(
        State("thrust_before", "N", "thrust at the start of the step", _at_thrust),
        State("reading", "N", "force on the load cell", _at_thrust),
        State("velocity", "N/s", "rate of the force on the load cell", lambda ops, s, p: 0.0),
    ),
    off={"frequency": 0.0},
    probe={"frequency": 3.0},
    largest_step=0.002,
    reading="thrust",
    says="the stand swings on the load cell at {frequency}",
)
