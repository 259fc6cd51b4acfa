"""Rigs in virtual time that end with their test, and a short profile."""

import contextlib

import pytest
from rigs import step_profile, virtual_rig

from vpp_fmu.files import OutputFolder
from vpp_fmu.record import write_record


@pytest.fixture
def new_rig():
    """Make (rig, its log) in virtual time, with the arguments of `virtual_rig`; all are closed at the test's end."""
    with contextlib.ExitStack() as ends:

        def made(**more):
            rig, log = virtual_rig(**more)
            ends.callback(rig.close)
            return rig, log

        yield made


@pytest.fixture
def profile(tmp_path):
    """File of a step up and down, of 3 s."""
    return write_record(OutputFolder(tmp_path), "step.csv", step_profile(hold=1.0))
