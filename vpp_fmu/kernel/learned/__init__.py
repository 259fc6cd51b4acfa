"""A term that no effect of the library has: where it enters the chain, what drives it, how it looks."""

from vpp_fmu.kernel.learned.drivers import DRIVERS, Driver
from vpp_fmu.kernel.learned.effect import learned
from vpp_fmu.kernel.learned.ports import PORTS, Port, placed
from vpp_fmu.kernel.learned.shapes import SHAPES

__all__ = ["DRIVERS", "PORTS", "SHAPES", "Driver", "Port", "learned", "placed"]
