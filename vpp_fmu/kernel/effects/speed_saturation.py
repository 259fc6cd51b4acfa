"""The motor can't turn faster than its supply voltage allows.

    form 1: u = min(omega_ref, maximum)        the command is cut, the lags run into the limit slowly
    form 2: omega = min(omega, maximum)        the rotor runs into it on its way

In form 2 the command and the inner lag continue beyond the limit; the rotor leaves it when the inner lag comes back.
"""

from vpp_fmu.kernel.types import Effect, Parameter

UNLIMITED = 1e6  # rpm; no rotor gets there


def _step(ops, s, x, p, dt):
    command = ops.where(p.form < 1.5, ops.minimum(s.omega_ref, p.maximum), s.omega_ref)
    return {"omega_ref": command, "omega_highest": p.maximum}, {}


EFFECT = Effect(
    "speed_saturation",
    "rotor speed can't exceed a limit",
    _step,
    parameters=(
        Parameter(
            "maximum",
            "rpm",
            UNLIMITED,
            0.3,
            UNLIMITED,
            "greatest speed of the rotor; 1000000: no limit",
            1.0,
            scale="speed",
            unlimited=UNLIMITED,
        ),
        Parameter("form", "1", 1.0, 1.0, 2.0, "1 limits the command, 2 the rotor on its way", choices=(1.0, 2.0)),
    ),
    off={"maximum": UNLIMITED},
    probe={"maximum": 0.9},
    largest_step=0.002,
    channels=("omega",),
    says="the rotor speed does not exceed {maximum} (saturation)",
)
