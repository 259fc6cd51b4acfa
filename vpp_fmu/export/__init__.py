"""Models as FMUs."""

from vpp_fmu.export.description import Experiment
from vpp_fmu.export.native_flavour import native_fmu
from vpp_fmu.export.python_flavour import python_fmu

__all__ = ["Experiment", "native_fmu", "python_fmu"]
