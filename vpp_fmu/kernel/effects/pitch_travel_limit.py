"""The blades can't go all the way: the stroke of the actuator ends, or the linkage meets a stop.

    form 1: u = clip(beta_ref, minimum, maximum)          the command is cut, the lags run into the limit slowly
    form 2: beta = clip(beta, minimum, maximum)           the blades hit a stop on their way, at full speed

In form 2 the command and the inner lag continue beyond the stop; the blades leave it when the inner lag comes back.
"""

from vpp_fmu.kernel.types import Effect, Parameter

ANY = 180.0  # deg; half a turn


def _step(ops, s, x, p, dt):
    command = ops.where(p.form < 1.5, ops.clip(s.beta_ref, p.minimum, p.maximum), s.beta_ref)
    return {"beta_ref": command, "beta_lowest": p.minimum, "beta_highest": p.maximum}, {}


EFFECT = Effect(
    "pitch_travel_limit",
    "blade pitch can't leave a range",
    _step,
    parameters=(
        Parameter(
            "minimum",
            "deg",
            -ANY,
            -ANY,
            0.4,
            "least pitch of the blades; -180: any",
            0.7,
            limit_form="no limit",
            scale="position",
            unlimited=-ANY,
        ),
        Parameter(
            "maximum",
            "deg",
            ANY,
            0.4,
            ANY,
            "greatest pitch of the blades; 180: any",
            0.7,
            limit_form="no limit",
            scale="position",
            unlimited=ANY,
        ),
        Parameter("form", "1", 1.0, 1.0, 2.0, "1 limits the command, 2 stops the blades on their way", choices=(1.0, 2.0)),
    ),
    off={"minimum": -ANY, "maximum": ANY},
    probe={"minimum": 2.0 / 15.0, "maximum": 0.8},
    largest_step=0.002,
    channels=("beta",),
    says="the blade pitch does not leave a range (least {minimum}, greatest {maximum})",
)
