"""Play in the linkage: when the drive reverses, the driven side waits until the gap is closed.

    driven <- clip(driven, drive - half_gap, drive + half_gap)

form 1: between actuator and blades, after both lags; form 2: between the lags, on the input of the outer one. The play is
exact while the drive keeps its direction. It starts in the middle of the gap.
"""

from vpp_fmu.kernel.types import Effect, Parameter, State


def _drive(ops, p, behind, between):
    return ops.where(p.form < 1.5, behind, between)


def _step(ops, s, x, p, dt):
    drive = _drive(ops, p, s.beta, s.beta_inner_ahead)
    driven = ops.clip(x.driven, drive - p.half_gap, drive + p.half_gap)
    missing = ops.lag_ramp(0.0, s.beta_inner - x.driven, s.beta_inner_ahead - driven, s.tau_beta_1, dt)
    signals = {
        "beta": _drive(ops, p, driven, s.beta - missing),
        "beta_outer_ahead": s.beta_outer_ahead - _drive(ops, p, 0.0, missing),
    }
    return signals, {"driven": driven}


EFFECT = Effect(
    "pitch_backlash",
    "play in the pitch linkage",
    _step,
    parameters=(
        Parameter(
            "half_gap", "deg", 0.0, 0.0, 0.15, "half of the pitch that is lost when the drive turns round", scale="pitch"
        ),
        Parameter("form", "1", 1.0, 1.0, 2.0, "1 play behind the lags, 2 between them", choices=(1.0, 2.0)),
    ),
    states=(State("driven", "deg", "pitch behind the play", lambda ops, s, p: _drive(ops, p, s.beta, s.beta_inner)),),
    off={"half_gap": 0.0},
    probe={"half_gap": 0.04},
    largest_step=0.002,
    channels=("beta",),
    says="the pitch linkage has a play of {half_gap} to each side (backlash)",
)
