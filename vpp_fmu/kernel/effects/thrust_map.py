"""Static thrust map (paper, eqs. 7 and 8), in the paper's normalised quantities.

w = omega / omega_scale,  b = (beta + beta_offset) / beta_scale
thrust = thrust_scale (c20 w^2 + c11 w b + c21 w^2 b + c12 w b^2 + c30 w^3)

Effects behind the map find w, b and all its parameters as signals.
"""

from vpp_fmu.kernel.types import Effect, Parameter


def scales() -> tuple[Parameter, ...]:
    """The paper's normalisation; plant and controller must agree on it."""
    return (
        Parameter("omega_scale", "rpm", 6000.0, 1.0, 1e5, "rotor speed that is 1 when normalised", 6000.0),
        Parameter("beta_scale", "deg", 15.0, 0.1, 180.0, "span of blade pitch that is 1 when normalised", 15.0),
        Parameter("beta_offset", "deg", 5.0, -90.0, 90.0, "added to blade pitch before it is normalised", 5.0),
        Parameter("thrust_scale", "N", 15.0, 0.001, 1e4, "thrust that is 1 when normalised", 15.0),
    )


def normalised_thrust(c, w, b):
    """The map at normalised speed and pitch; `c` has the coefficients, as the map's parameters and, behind it, signals."""
    return w * (w * (c.c20 + c.c21 * b + c.c30 * w) + b * (c.c11 + c.c12 * b))


def _step(ops, s, x, p, dt):
    w = s.omega / p.omega_scale
    b = (s.beta + p.beta_offset) / p.beta_scale
    return {"thrust": p.thrust_scale * normalised_thrust(p, w, b), "w": w, "b": b, **vars(p)}, {}


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
        *scales(),
    ),
)
