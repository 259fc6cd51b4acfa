"""Two rows of the fault table; `python -m tests.hil.faults` tries all of them."""

from dataclasses import replace

import pytest
from faults import ROWS, tried


@pytest.mark.parametrize("name", ["SIGKILL", "SIGINT"])
def test_what_must_come_of_a_fault_comes_of_it(name):
    row = next(row for row in ROWS if row.name == name)
    outcome = tried(replace(row, within=10.0 * row.within))  # the machine may have others to serve
    assert not outcome.wrong, outcome
