"""Torque and power of the rotor: effects that add outputs to the plant and change nothing else of it.

    torque_map:  Q = sum q_ij w^i b^j                           with w, b of the thrust map (as eq. 7 of the paper for thrust)
    motor:       P = Q_m omega + loss Q_m^2 + idle,             Q_m = Q + friction
    power_map:   P = sum p_ij w^i b^j                           electrical power where no torque was measured
    figure_of_merit: T sqrt(T / (2 rho A)) / (Q omega)          ideal over real power of a hovering rotor; A: its disc

`motor` is the paper's eqs. 3 and 4 at rest, R i^2 + k omega i with the motor's constant k: Q_m = k i, so loss = R / k^2, which
needs no measurement of the motor current; idle is the power of the ESC. Coefficients are in N.m or W: w and b are normalised.
"""

from itertools import product
from math import pi

from vpp_fmu.kernel.signals import POWER, TORQUE
from vpp_fmu.kernel.types import Effect, Parameter, Signal

RAD_PER_S = 2.0 * pi / 60.0
"""One rpm in rad/s."""

TORQUE_TERMS = {f"q{i}{j}": (i, j) for i, j in product((1, 2), (0, 1, 2))}
POWER_TERMS = {f"p{i}{j}": (i, j) for i, j in product((1, 2, 3), (0, 1, 2))}
"""Powers (i, j) of the terms w^i b^j, by coefficient. The power terms include the torque terms times speed. A rotor at rest
takes none."""


def _map(terms, unit: str, output: Signal, text: str) -> Effect:
    def step(ops, s, x, p, dt):
        total = 0.0
        for name, (i, j) in terms.items():
            term = getattr(p, name)
            for factor in (*i * [s.w], *j * [s.b]):
                term = term * factor
            total = total + term
        return {output.name: total}, {}

    about = "coefficient of w^{} b^{} in the map of " + output.name
    parameters = tuple(Parameter(n, unit, 0.0, -1e6, 1e6, about.format(*ij), output.nominal) for n, ij in terms.items())
    off, probe = dict.fromkeys(terms, 0.0), {list(terms)[-3]: output.nominal}
    return Effect(f"{output.name}_map", text, step, parameters, off=off, probe=probe, outputs=(output,))


TORQUE_MAP = _map(TORQUE_TERMS, "N.m", TORQUE, "torque over rotor speed and blade pitch")
POWER_MAP = _map(POWER_TERMS, "W", POWER, "electrical power over rotor speed and blade pitch")


def _motor(ops, s, x, p, dt):
    speed, driven = s.w * s.omega_scale * RAD_PER_S, s.torque + p.friction
    power = driven * speed + p.loss * driven * driven + p.idle
    takes = power > 0.0
    return {"power": power, "efficiency": ops.where(takes, s.torque * speed / ops.where(takes, power, 1.0), 0.0)}, {}


MOTOR = Effect(
    "motor",
    "electrical power of motor and ESC (paper, eqs. 3 and 4 at rest)",
    _motor,
    parameters=(
        Parameter("friction", "N.m", 0.0, 0.0, 1e3, "torque of the motor without load (no-load current)", 0.01),
        Parameter("loss", "W/N2.m2", 0.0, 0.0, 1e9, "copper loss per torque squared, R / k^2", 1e3),
        Parameter("idle", "W", 0.0, 0.0, 1e5, "power of the ESC alone", 1.0),
    ),
    off={"friction": 0.0, "loss": 0.0, "idle": 0.0},
    probe={"loss": 500.0},
    outputs=(
        POWER,
        Signal("efficiency", "1", "shaft power over electrical power of motor and ESC; 0 without power", -10.0, 10.0),
    ),
)


def _figure(ops, s, x, p, dt):
    shaft, disc = s.torque * s.w * s.omega_scale * RAD_PER_S, 0.25 * pi * p.diameter * p.diameter
    lift = ops.maximum(s.thrust, 0.0)
    known = ops.where(shaft > 0.0, disc, 0.0) > 0.0
    # Limited from below: the derivative of a square root at 0 is infinite.
    ideal = lift * ops.sqrt(ops.maximum(lift / ops.where(known, 2.0 * p.air_density * disc, 1.0), 1e-12))
    return {"figure_of_merit": ops.where(known, ideal / ops.where(known, shaft, 1.0), 0.0)}, {}


FIGURE = Effect(
    "figure_of_merit",
    "ideal over real power of a hovering rotor (momentum theory)",
    _figure,
    parameters=(
        Parameter("diameter", "m", 0.0, 0.0, 30.0, "diameter of the rotor; 0: not known", 0.3),
        Parameter("air_density", "kg/m3", 1.2, 0.1, 10.0, "density of the air", 1.0),
    ),
    off={"diameter": 0.0},
    probe={"diameter": 0.28},
    outputs=(Signal("figure_of_merit", "1", "ideal over real power of the rotor; 0 without torque", 0.0, 100.0),),
)

EFFECTS = (TORQUE_MAP, MOTOR, POWER_MAP, FIGURE)
"""In their order along the chain. A model has `torque_map`, optionally with `motor` and `figure_of_merit`, or `power_map`."""
