"""A learned term, for dynamics that no effect of the library has: its port in the chain, its driver and its shape."""

from vpp_fmu.kernel.learned.drivers import DRIVERS, Driver
from vpp_fmu.kernel.learned.effect import learned
from vpp_fmu.kernel.learned.ports import PORTS, Port, placed
from vpp_fmu.kernel.learned.shapes import SHAPES

__all__ = ["DRIVERS", "PORTS", "SHAPES", "Driver", "Port", "learned", "placed"]
