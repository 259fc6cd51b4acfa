"""The blades have another pitch than commanded: an error of the pitch calibration, or of the linkage's neutral.

u = beta_ref + offset
"""

from vpp_fmu.kernel.types import Effect, Parameter


def _step(ops, s, x, p, dt):
    return {"beta_ref": s.beta_ref + p.offset}, {}


EFFECT = Effect(
    "pitch_offset",
    "blade pitch is off by a constant",
    _step,
    parameters=(Parameter("offset", "deg", 0.0, -0.3, 0.3, "reached pitch less commanded pitch, at rest", scale="pitch"),),
    off={"offset": 0.0},
    probe={"offset": 0.07},
    channels=("beta",),
    says="the blade pitch is off by {offset}",
)
