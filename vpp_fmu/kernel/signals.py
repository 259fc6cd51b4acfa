"""What is commanded to a rig, and what is measured of it."""

from vpp_fmu.kernel.types import Signal

OMEGA_REF = Signal("omega_ref", "rpm", "commanded rotor speed", 0.0, 2e5, 6000.0, scale="speed")
BETA_REF = Signal("beta_ref", "deg", "commanded blade pitch", -90.0, 90.0, 15.0, scale="pitch")
THRUST = Signal("thrust", "N", "measured thrust", -1e5, 1e5, 15.0, scale="thrust")
OMEGA = Signal("omega", "rpm", "rotor speed", 0.0, 2e5, 6000.0, scale="speed")
BETA = Signal("beta", "deg", "blade pitch", -90.0, 90.0, 15.0, scale="pitch")
TORQUE = Signal("torque", "N.m", "torque of the rotor", -1e4, 1e4, 0.1)
POWER = Signal("power", "W", "electrical power", -1e6, 1e6, 100.0)
