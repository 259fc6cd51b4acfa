"""The pitch actuator: a small DC motor behind gears and a screw (paper, eqs. 5 and 6), in the blades' angle.

    J_a d rate/dt + D_a rate = k_a I_a
    L_a dI_a/dt              = u V - R_a I_a - k_ia rate

solved exactly for a drive u that is held over the step. The P8-25-50-12 has a stroke of 25 mm, gears of 50:1 and is rated for
12 V (its name); the rig runs it at 15 V. Stall current, free speed and efficiency are chosen as usual for a screw of this
class (0.65 A at 12 V; 20 mm/s at 12 V), the lever such that 25 mm turn the blades by 30 deg. Free speed at full drive is
then 30 deg/s, and 20 deg of pitch take 0.67 s. This speed limits large steps, the LAC's PD small ones. A load on the blades
doesn't push the screw back.
"""

from hil.physics.linear import Pair, integrals, moved
from hil.physics.propeller import DEG
from vpp_fmu.kernel.types import Effect, Parameter, State


def full_speed(actuator):
    """Speed at full drive [deg/s]."""
    k, i, r = actuator.k_a, actuator.k_ia, actuator.r_a
    return k * actuator.v_a / (actuator.d_a * r + k * i) / DEG


def _publish(ops, s, x, p, dt):
    return {"actuator": p, "rod": x.rod, "rod_rate": x.rod_rate, "rod_current": x.rod_current, "rod_stuck": 0.0}, {}


def _at_command(ops, s, p):
    return ops.clip(s.beta_ref, p.beta_low, p.beta_high)


ACTUATOR = Effect(
    "actuator",
    "the pitch actuator",
    _publish,
    parameters=(
        Parameter("v_a", "V", 15.0, 1.0, 48.0, "supply of the actuator (paper)", 10.0),
        Parameter("r_a", "Ohm", 18.5, 0.5, 500.0, "resistance: 0.65 A of stall current at 12 V (chosen)", 10.0),
        Parameter("l_a", "H", 2e-3, 1e-5, 0.1, "inductance (chosen)", 1e-3),
        Parameter("k_ia", "V.s/rad", 38.7, 0.5, 500.0, "back-EMF per blade rate: 20 deg/s at 15 V (chosen)", 10.0),
        Parameter("k_a", "N.m/A", 13.5, 0.1, 500.0, "torque per current, 35 % of k_ia: the screw's efficiency (chosen)", 10.0),
        Parameter("d_a", "N.m.s/rad", 3.1, 0.0, 100.0, "damping: 0.08 A at free speed (chosen)"),
        Parameter("j_a", "kg.m.m", 0.63, 1e-3, 10.0, "inertia seen from the blades, mostly the motor's (chosen)"),
        Parameter("beta_low", "deg", -15.0, -45.0, 0.0, "pitch with the rod at its lower end (chosen: 30 deg for 25 mm)", 10.0),
        Parameter("beta_high", "deg", 15.0, 1.0, 45.0, "pitch with the rod at its upper end (chosen)", 10.0),
    ),
    states=(
        State("rod", "deg", "position of the rod as blade pitch", _at_command, closed_by="rod_ahead"),
        State("rod_rate", "deg/s", "rate of the rod", 0.0, closed_by="rod_rate_ahead"),
        State("rod_current", "A", "current of the actuator", 0.0, closed_by="rod_current_ahead"),
    ),
)


def circuit(actuator, drive) -> Pair:
    """The equations of (current [A], rate [rad/s]) under a held drive."""
    a = actuator
    volts = drive * a.v_a
    return Pair(-a.r_a / a.l_a, -a.k_ia / a.l_a, volts / a.l_a, a.k_a / a.j_a, -a.d_a / a.j_a, 0.0)


def _step(ops, s, x, p, dt):
    pair, before = circuit(s.actuator, s.drive), (s.rod_current, s.rod_rate * DEG)
    after = moved(ops, pair, *before, dt)
    reached = s.rod + integrals(pair, before, after, dt)[1] / DEG
    rod = ops.clip(reached, s.actuator.beta_low, s.actuator.beta_high)
    stops = ops.where(rod < reached, 1.0, ops.where(reached < rod, 1.0, 0.0))
    held = s.rod_stuck > 0.5
    rod = ops.where(held, s.rod, rod)
    rate = ops.where(held, 0.0, ops.where(stops > 0.5, 0.0, after[1] / DEG))
    return {"rod_ahead": rod, "rod_rate_ahead": rate, "rod_current_ahead": after[0], "beta": rod}, {}


MOVE = Effect("pitch_motion", "motion of the pitch actuator", _step, largest_step=0.001)
