"""Two masses on a line, a spring and a damper between them: an example of a user-defined model for an FMU.

    m1 dv1/dt = force + f,   m2 dv2/dt = -f,   f = k (x2 - x1) + d (v2 - v1)

sampled every `sample_time`: first the speeds from the forces at the sample, then the positions from the new speeds. The error
is of the order of (sample_time)^2 k / m per swing; the momentum is exact. A brake holds the first mass. When the second mass
passes a gate, in either direction, this is an event, which is detected at the first sample after it.

    vpp export --model fmu_src.two_masses:MODEL --flavour both -o two_masses
"""

from vpp_fmu.kernel.types import BOOLEAN, INTEGER, Effect, Model, Parameter, Signal, State

FORCE = Signal("force", "N", "force on the first mass", -1000.0, 1000.0, nominal=10.0)
BRAKE = Signal("brake", "1", "holds the first mass", 0.0, 1.0, kind=BOOLEAN)
FIRST, SECOND = (Signal(f"x{i}", "m", f"position of mass {i}", -1e6, 1e6) for i in (1, 2))
BEYOND = Signal("beyond", "1", "whether the second mass is beyond the gate", 0.0, 1.0, kind=BOOLEAN)
PASSES = Signal("passes", "1", "how often the second mass has passed the gate", 0.0, 1e9, kind=INTEGER)


def _move(ops, s, x, p, dt):
    f = p.k * (x.x2 - x.x1) + p.d * (x.v2 - x.v1)
    v1 = ops.where(s.brake > 0.5, 0.0, x.v1 + dt * (s.force + f) / p.m1)
    v2 = x.v2 - dt * f / p.m2
    moved = {"x1": x.x1 + dt * v1, "x2": x.x2 + dt * v2}
    return moved, {**moved, "v1": v1, "v2": v2}


def _watch(ops, s, x, p, dt):
    beyond = ops.where(s.x2 > p.gate, 1.0, 0.0)
    passes = x.passes + ops.abs(beyond - x.beyond)
    seen = {"beyond": beyond, "passes": passes}
    return seen, seen


def _rest(ops, s, p):
    return 0.0


MASSES = Effect(
    "masses",
    "two masses, a spring and a damper",
    _move,
    parameters=(
        Parameter("m1", "kg", 1.0, 0.01, 100.0, "first mass"),
        Parameter("m2", "kg", 2.0, 0.01, 100.0, "second mass"),
        Parameter("k", "N/m", 50.0, 0.0, 1e4, "stiffness of the spring", nominal=100.0),
        Parameter("d", "N.s/m", 0.5, 0.0, 100.0, "damping"),
        Parameter("sample_time", "s", 0.001, 1e-5, 0.1, "period of the law", nominal=0.001),
    ),
    states=(
        State("x1", "m", "position of mass 1", _rest),
        State("x2", "m", "position of mass 2", _rest),
        State("v1", "m/s", "speed of mass 1", _rest),
        State("v2", "m/s", "speed of mass 2", _rest),
    ),
)
GATE = Effect(
    "gate",
    "counts how often the second mass passes",
    _watch,
    parameters=(Parameter("gate", "m", 0.1, -10.0, 10.0, "where the gate is", tunable=True),),
    states=(
        State("beyond", "1", "whether it was beyond the gate at the last sample", _rest),
        State("passes", "1", "passes so far", _rest),
    ),
)
MODEL = Model(
    "TwoMasses",
    "Two masses on a line, a brake, and a gate that counts",
    inputs=(FORCE, BRAKE),
    outputs=(FIRST, SECOND, BEYOND, PASSES),
    effects=(MASSES, GATE),
    sample_time="sample_time",
)
