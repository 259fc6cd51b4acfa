"""The measurement chain of the thrust as a sampled model: from the plant's thrust to the controller's input."""

from vpp_fmu.kernel.effects.thrust_reading import THRUST_READING
from vpp_fmu.kernel.signals import THRUST
from vpp_fmu.kernel.types import Model, Signal

CONVERSIONS = 860.0
"""Readings per second of the rig's converter (ADS1115). On average the middle of the newest conversion is one period old."""

RESOLUTION = 98.07 / 2**15
"""N per count: the rig's 10 kg load cell over half the converter's 16 bits."""

MEASUREMENT = Model(
    "ThrustMeasurement",
    "Thrust to the reading that the controller is given",
    inputs=(THRUST, Signal("noise", "N", "noise of the reading", -1e5, 1e5, 0.1)),
    outputs=(Signal("reading", "N", "thrust as it is read", THRUST.minimum, THRUST.maximum, 15.0),),
    effects=(THRUST_READING,),
    sample_time="sample_time",
)
