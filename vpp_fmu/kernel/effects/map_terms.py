"""Terms that the paper's polynomial of the thrust map omits (eq. 8), in the same normalised quantities.

    thrust += thrust_scale (c10 w + c22 w^2 b^2 + stall term)
    form 1: stall term = stall w b^3,   form 2: stall term = stall w^2 max(b - knee, 0)

The term in w alone results from the shift of pitch for the map in physical units. Higher powers of b bend the map near the
stall of the blades; the knee bends it from one pitch on.
"""

from vpp_fmu.kernel.types import Effect, Parameter


def _step(ops, s, x, p, dt):
    w, b = s.w, s.b
    knee = (p.knee + s.beta_offset) / s.beta_scale
    stalled = ops.where(p.form < 1.5, b * b * b, w * ops.maximum(b - knee, 0.0))
    more = w * (p.c10 + p.c22 * w * b * b + p.stall * stalled)
    return {"thrust": s.thrust + s.thrust_scale * more}, {}


def _coefficient(name: str, term: str) -> Parameter:
    return Parameter(name, "1", 0.0, -1.0, 1.0, f"coefficient of {term} in the normalised thrust map", 0.1)


EFFECT = Effect(
    "map_terms",
    "further terms of the thrust map",
    _step,
    parameters=(
        _coefficient("c10", "w"),
        _coefficient("c22", "w^2 b^2"),
        _coefficient("stall", "the stall term (below 0: thrust is lost)"),
        Parameter("knee", "deg", 2.0 / 3.0, 0.0, 1.0, "form 2: pitch from which the blades stall", scale="position"),
        Parameter("form", "1", 1.0, 1.0, 2.0, "stall term: 1 in w b^3, 2 in w^2 beyond a knee", choices=(1.0, 2.0)),
    ),
    off={"c10": 0.0, "c22": 0.0, "stall": 0.0},
    probe={"c10": 0.05, "c22": 0.15, "stall": -0.15},
    says="the thrust map has further terms (c10 {c10}, c22 {c22}, stall {stall})",
)
