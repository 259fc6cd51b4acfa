"""Rigs in virtual time that end with their test."""

import contextlib

import pytest
from rigs import virtual_rig


@pytest.fixture
def new_rig():
    """Make (rig, its log) in virtual time, with the arguments of `virtual_rig`; all are closed at the test's end."""
    with contextlib.ExitStack() as ends:

        def made(**more):
            rig, log = virtual_rig(**more)
            ends.callback(rig.close)
            return rig, log

        yield made
