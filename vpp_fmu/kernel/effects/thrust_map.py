"""Static thrust map (paper, eqs. 7 and 8), in the paper's normalised quantities.

thrust = thrust_scale (c20 w^2 + c11 w b + c21 w^2 b + c12 w b^2 + c30 w^3)

w and b are normalised by `normalisation`. Effects after the map read w, b and the coefficients as signals.
"""

from vpp_fmu.kernel.types import Effect, Parameter


def normalised_thrust(c, w, b):
    """The map at normalised speed and pitch; `c`: the coefficients, from the map's parameters or, after the map, signals."""
    return w * (w * (c.c20 + c.c21 * b + c.c30 * w) + b * (c.c11 + c.c12 * b))


def _step(ops, s, x, p, dt):
    w = s.omega / s.omega_scale
    b = (s.beta + s.beta_offset) / s.beta_scale
    return {"thrust": s.thrust_scale * normalised_thrust(p, w, b), "w": w, "b": b, **vars(p)}, {}


def _coefficient(name: str, default: float, term: str) -> Parameter:
    return Parameter(name, "1", default, -10.0, 10.0, f"coefficient of {term} in the normalised thrust map")


THRUST_MAP = Effect(
    "thrust_map",
    "thrust over rotor speed and blade pitch",
    _step,
    parameters=(
        _coefficient("c20", 0.355, "w^2"),
        _coefficient("c11", 0.064, "w b"),
        _coefficient("c21", 0.8, "w^2 b"),
        _coefficient("c12", -0.16, "w b^2"),
        _coefficient("c30", -0.081, "w^3"),
    ),
)
