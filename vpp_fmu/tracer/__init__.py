"""Turns the kernel's functions into straight-line Python and C; see `program`."""

from vpp_fmu.tracer.emit import LANES, c_lanes, c_source, python_source
from vpp_fmu.tracer.program import Layout, Program, trace

__all__ = ["LANES", "Layout", "Program", "c_lanes", "c_source", "python_source", "trace"]
