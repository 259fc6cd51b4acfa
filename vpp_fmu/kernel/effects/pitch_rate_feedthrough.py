"""Thrust changes while the blades turn, at once and in proportion to their rate.

    thrust += gain w^2 d beta/dt,   d beta/dt = (inner - outer) / tau_beta_1

Causes are the virtual camber of a pitching blade and the reaction of the moving parts on the stand: the direct feed-through of
sudden pitch changes that the paper's introduction reports (Cutler 2015). The rate is from the equation of the actuator's outer
lag, not from a difference of samples. It is 0 while a stop, a band or play holds the blades.
"""

from vpp_fmu.kernel.effects.stage import OUTER, stage
from vpp_fmu.kernel.types import Effect, Parameter, State


def _step(ops, s, x, p, dt):
    moves = ops.where(s.beta < x.beta_before, 1.0, ops.where(s.beta > x.beta_before, 1.0, 0.0)) > 0.5
    rate = (s.beta_inner_ahead - s.beta_outer_ahead) / stage(ops, s, "beta", OUTER).tau
    return {"thrust": s.thrust + p.gain * s.w * s.w * ops.where(moves, rate, 0.0)}, {"beta_before": s.beta}


EFFECT = Effect(
    "pitch_rate_feedthrough",
    "thrust while the blades turn",
    _step,
    parameters=(
        Parameter(
            "gain", "N.s/deg", 0.0, -0.4, 0.4, "thrust per rate of pitch, at full speed (w = 1)", 0.1, scale="thrust.time/pitch"
        ),
    ),
    states=(State("beta_before", "deg", "blade pitch at the start of the step", lambda ops, s, p: s.beta),),
    off={"gain": 0.0},
    probe={"gain": 0.08},
    channels=("beta",),
    says="turning blades change the thrust by {gain}",
)
