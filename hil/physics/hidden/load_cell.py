"""Hidden effects between thrust and the load cell's reading.

The amplifier is a resistor and a capacitor, integrated by the trapezoidal rule; drift is a function of time.
"""

from math import pi

from hil.physics.hidden.pitch import swung
from vpp_fmu.kernel.types import Effect, Parameter, State


def _thrust(ops, s, p):
    return s.thrust


def _stand(ops, s, x, p, dt):
    soft = p.frequency > 0.0
    force, rate = swung(ops, x.force, x.rate, x.before, s.thrust, ops.where(soft, p.frequency, 1.0), p.damping, dt)
    force = ops.where(soft, force, s.thrust)
    return {"thrust": force}, {"force": force, "rate": ops.where(soft, rate, 0.0), "before": s.thrust}


STAND_SWING = Effect(
    "stand_swing",
    "the stand swings on the load cell",
    _stand,
    parameters=(
        Parameter("frequency", "Hz", 0.0, 0.0, 60.0, "natural frequency of the stand; 0: rigid", 10.0),
        Parameter("damping", "1", 0.04, 0.005, 0.9, "damping ratio", 0.1),
    ),
    states=(
        State("force", "N", "force on the load cell", _thrust),
        State("rate", "N/s", "rate of the force on the load cell", 0.0),
        State("before", "N", "thrust at the start of the step", _thrust),
    ),
    off={"frequency": 0.0},
    probe={"frequency": 3.0},
)


def _shake(ops, s, x, p, dt):
    share = s.omega / 6000.0
    return {"thrust": s.thrust + p.amplitude * share * share * ops.sin(2.0 * pi * s.angle)}, {}


IMBALANCE = Effect(
    "rotor_imbalance",
    "an unbalanced rotor shakes the load cell once a turn",
    _shake,
    parameters=(Parameter("amplitude", "N", 0.0, 0.0, 5.0, "amplitude at 6000 rpm; grows with the speed squared", 0.1),),
    off={"amplitude": 0.0},
    probe={"amplitude": 0.1},
)


def _smooth(ops, s, x, p, dt):
    moved = (s.thrust - x.reading + x.before - x.reading) * dt / (2.0 * p.time_constant + dt)
    reading = ops.where(p.time_constant > 0.0, x.reading + moved, s.thrust)
    return {"thrust": reading}, {"reading": reading, "before": s.thrust}


LOW_PASS = Effect(
    "amplifier_low_pass",
    "the amplifier and its capacitors smooth the signal",
    _smooth,
    parameters=(Parameter("time_constant", "s", 0.0, 0.0, 1.0, "time constant; 0: none", 0.1),),
    states=(
        State("reading", "N", "thrust behind the amplifier", _thrust),
        State("before", "N", "thrust before it at the start of the step", _thrust),
    ),
    off={"time_constant": 0.0},
    probe={"time_constant": 0.06},
)


def _scale(ops, s, x, p, dt):
    return {"thrust": s.thrust * p.gain}, {}


GAIN = Effect(
    "load_cell_gain",
    "the load cell's calibration is off",
    _scale,
    parameters=(Parameter("gain", "1", 1.0, 0.5, 1.5, "reading over thrust"),),
    off={"gain": 1.0},
    probe={"gain": 1.05},
)


def _drift(ops, s, x, p, dt):
    clock = x.clock + dt
    return {"thrust": s.thrust - p.final * ops.expm1(-clock / p.time_constant)}, {"clock": clock}


DRIFT = Effect(
    "load_cell_drift",
    "the load cell's zero drifts while it warms up",
    _drift,
    parameters=(
        Parameter("final", "N", 0.0, -3.0, 3.0, "drift when warm"),
        Parameter("time_constant", "s", 100.0, 1.0, 10000.0, "time constant of warming up", 100.0),
    ),
    states=(State("clock", "s", "time since the start, at which the load cell is cold", 0.0),),
    off={"final": 0.0},
    probe={"final": 0.5, "time_constant": 30.0},
)
