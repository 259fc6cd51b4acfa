"""The scales that normalise the thrust map and other quantities that depend on a rig's size (paper, section 3.1).

w = omega / omega_scale,  b = (beta + beta_offset) / beta_scale,  T = thrust / thrust_scale

The first effect of the chain: it passes the scales to all others as signals.
"""

from vpp_fmu.kernel.types import Effect, Parameter


def scales() -> tuple[Parameter, ...]:
    """The four scales; plant and controller must agree on them."""
    return (
        Parameter("omega_scale", "rpm", 1.0, 0.001, 10.0, "rotor speed that is 1 when normalised", 1.0, scale="speed"),
        Parameter("beta_scale", "deg", 1.0, 0.01, 10.0, "span of blade pitch that is 1 when normalised", 1.0, scale="pitch"),
        Parameter("beta_offset", "deg", 0.0, -5.0, 5.0, "added to blade pitch before it is normalised", 1.0, scale="offset"),
        Parameter("thrust_scale", "N", 1.0, 0.001, 100.0, "thrust that is 1 when normalised", 1.0, scale="thrust"),
    )


def _step(ops, s, x, p, dt):
    return vars(p), {}


EFFECT = Effect("normalisation", "scales of the normalised quantities", _step, parameters=scales())
