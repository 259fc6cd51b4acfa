"""The propeller's static maps C_T and C_Q over inflow ratio and pitch, and the induced inflow from momentum theory.

    thrust = rho A omega^2 R^2 C_T / 2        (paper, eq. 1)
    torque = rho A omega^2 R^3 C_Q / 2        (paper, section 2.1)
    alpha  = incidence + beta - 3/2 inflow                                blade element at three quarters of the radius
    C_T    = lift alpha (1 - bend |alpha|),   constant past its peak      the lift curve bends, then stalls
    C_Q    = induced |inflow C_T| + profile + profile_rise alpha^2

In hover, momentum theory gives C_T = 4 inflow |inflow|; with C_T above it is a quadratic equation in the inflow.

The three parameters of C_T are a least-squares fit to the paper's published static map (section 4.1) over 2000 to 6000 rpm and
-5 to 10 deg: largest error 0.26 N, rms 0.08 N. The paper's map itself deviates from omega^2 (Reynolds number), which no map
over inflow and pitch can represent: with C_T free at every pitch the errors would still be 0.19 N and 0.06 N. Slope and
incidence agree with the part: a 1045 has 10.8 deg at three quarters of the radius and a cambered section. No torque was
published; induced factor and profile drag are chosen so that the figure of merit goes from 0.58 at 0 deg to 0.65 at 10 deg,
common for this size.
"""

from math import pi

from vpp_fmu.kernel.types import Effect, Parameter

DEG = pi / 180.0
RPM = pi / 30.0


def angle_of_attack(blades, beta, inflow):
    """At three quarters of the radius, rad; `beta` in deg."""
    return (blades.incidence + beta) * DEG - 1.5 * inflow


def thrust_coefficient(ops, blades, beta, inflow):
    """C_T of pitch [deg] and inflow ratio."""
    alpha = angle_of_attack(blades, beta, inflow)
    peak = 0.5 / blades.bend
    held = ops.clip(alpha, -peak, peak)
    return blades.lift * held * (1.0 - blades.bend * ops.abs(held))


def torque_coefficient(ops, blades, beta, inflow):
    """C_Q of pitch [deg] and inflow ratio."""
    alpha = angle_of_attack(blades, beta, inflow)
    useful = inflow * thrust_coefficient(ops, blades, beta, inflow)
    return blades.induced * ops.abs(useful) + blades.profile + blades.profile_rise * alpha * alpha


def settled_inflow(ops, blades, beta):
    """The inflow ratio at which blade elements and momentum theory agree, for a pitch in deg."""
    alpha = (blades.incidence + beta) * DEG
    size, lift, bend = ops.abs(alpha), blades.lift, blades.bend
    a = 4.0 + 2.25 * lift * bend
    b = lift * (1.5 - 3.0 * bend * size)
    c = lift * size * (1.0 - bend * size)
    inflow = 0.5 * (ops.sqrt(ops.maximum(b * b + 4.0 * a * c, 0.0)) - b) / a
    stalled = size - 1.5 * inflow > 0.5 / bend
    inflow = ops.where(stalled, 0.25 * ops.sqrt(lift / bend), inflow)
    return ops.where(alpha < 0.0, -inflow, inflow)


def force_factor(blades):
    """rho A R^2 / 2: thrust over C_T omega^2 [N s^2/rad^2]."""
    return 0.5 * blades.density * pi * blades.radius * blades.radius * blades.radius * blades.radius


def drag_factor(ops, blades, beta, inflow):
    """Aerodynamic torque over omega^2 [N m s^2/rad^2]."""
    return force_factor(blades) * blades.radius * torque_coefficient(ops, blades, beta, inflow)


def _publish(ops, s, x, p, dt):
    return {"blades": p}, {}


BLADES = Effect(
    "blades",
    "the blades: size and lift",
    _publish,
    parameters=(
        Parameter("radius", "m", 0.127, 0.03, 1.0, "radius of the rotor (paper: blades of a 1045)", 0.1),
        Parameter("density", "kg/m/m/m", 1.225, 0.5, 2.0, "density of the air (standard)"),
        Parameter("lift", "1", 0.585, 0.05, 2.0, "slope of C_T over angle of attack (fitted to the paper's static map)", 0.5),
        Parameter("incidence", "deg", 12.14, 0.0, 30.0, "blade angle above zero lift at pitch 0 (fitted, same)", 10.0),
        Parameter("bend", "1", 1.867, 0.1, 5.0, "how the lift curve bends, 1/rad (fitted, same)"),
        Parameter("induced", "1", 1.2, 1.0, 2.0, "induced power over the ideal one (chosen, usual for two blades)"),
        Parameter("profile", "1", 0.0015, 0.0001, 0.02, "C_Q of the profile at zero lift (chosen)", 0.001),
        Parameter("profile_rise", "1", 0.05, 0.0, 1.0, "growth of C_Q with the angle of attack squared (chosen)", 0.1),
    ),
)


def _load(ops, s, x, p, dt):
    coefficient = thrust_coefficient(ops, s.blades, s.beta, s.inflow)
    omega = s.omega * RPM
    thrust = force_factor(s.blades) * omega * omega * coefficient
    return {"thrust": thrust, "lift": thrust}, {}


THRUST = Effect("thrust", "thrust of the blades", _load)
