"""The actuator takes a new pitch command only when it differs enough from the one it holds.

    held <- beta_ref  where |beta_ref - held| > half_width

The paper reports demanded pitch that "was not always reached by the actuator, leaving flat areas, where the model predicts
bumps".
"""

from vpp_fmu.kernel.types import Effect, Parameter, State


def _step(ops, s, x, p, dt):
    held = ops.where(ops.abs(s.beta_ref - x.held) > p.half_width, s.beta_ref, x.held)
    return {"beta_ref": held}, {"held": held}


EFFECT = Effect(
    "pitch_command_deadband",
    "small changes of the pitch command are ignored",
    _step,
    parameters=(
        Parameter("half_width", "deg", 0.0, 0.0, 0.3, "largest change of the pitch command that is ignored", scale="pitch"),
    ),
    states=(State("held", "deg", "pitch command that the actuator holds", lambda ops, s, p: s.beta_ref),),
    off={"half_width": 0.0},
    probe={"half_width": 0.1},
    channels=("beta",),
    says="the pitch servo ignores changes below {half_width} (dead band)",
)
