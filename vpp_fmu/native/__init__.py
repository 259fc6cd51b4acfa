"""Traced models, compiled with the machine's C compiler and run over whole records."""

from vpp_fmu.native.adjoint import Adjoint
from vpp_fmu.native.simulator import Simulator

__all__ = ["Adjoint", "Simulator"]
