"""The induced inflow approaches the equilibrium of blade-element and momentum theory with a lag (paper, eq. 2).

    d inflow/dt = (settled - inflow) / tau,   tau = apparent_mass / (4 |inflow| omega)

`apparent_mass` is the air that moves with the disk (Pitt and Peters: 0.849 for a uniform inflow); tau is 2.5 ms at full thrust,
10 ms at 2000 rpm. The paper's tau_lambda is a constant; here tau depends on speed and inflow. Below the inflow `least` tau
grows no further with falling inflow. The step is exact for a settled value that changes linearly, as it nearly does.
"""

from hil.physics.propeller import settled_inflow
from vpp_fmu.kernel.types import Effect, Parameter, State


def _settled(ops, s, p):
    return settled_inflow(ops, s.blades, s.beta)


def _step(ops, s, x, p, dt):
    settled = _settled(ops, s, p)
    size = ops.maximum(0.5 * (ops.abs(x.before) + ops.abs(settled)), p.least)
    spans = 4.0 * size * s.shaft_speed / p.apparent_mass * dt
    covered = -ops.expm1(-spans)
    inflow = x.inflow + covered * (x.before - x.inflow) + (settled - x.before) * (1.0 - ops.relaxation(spans))
    between = {"inflow_between": 0.5 * (x.inflow + inflow), "beta_between": 0.5 * (x.beta_before + s.beta)}
    return {"inflow": inflow, **between}, {"inflow": inflow, "before": settled, "beta_before": s.beta}


INFLOW = Effect(
    "inflow",
    "the induced inflow builds up",
    _step,
    parameters=(
        Parameter("apparent_mass", "1", 0.849, 0.05, 5.0, "air that moves with the disk (Pitt and Peters, uniform inflow)"),
        Parameter("least", "1", 0.02, 0.001, 0.2, "inflow ratio below which the lag slows down no further (chosen)", 0.1),
    ),
    states=(
        State("inflow", "1", "inflow ratio", _settled),
        State("before", "1", "what the inflow follows, at the start of the step", _settled),
        State("beta_before", "deg", "blade pitch at the start of the step", lambda ops, s, p: s.beta),
    ),
)
