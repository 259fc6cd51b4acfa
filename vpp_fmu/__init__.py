"""Measured data of a variable-pitch propeller rig to FMUs."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("vpp-fmu")
except PackageNotFoundError:  # run from a source tree that was never installed
    __version__ = "not installed"
