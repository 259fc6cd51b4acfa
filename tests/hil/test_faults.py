"""A part of the fault table: bus faults in virtual time, and one row in real time. `python -m tests.hil.faults` runs all."""

import os

import pytest
from rigs import IDLE, duties, steps

from hil.loop import rig as hil_rig
from hil.loop.rig import RunEnded
from hil.safety.states import SafetyState
from tests.hil.faults import ROWS
from tests.hil.injection import Injected

ON_THE_BUSES = {
    row.name: row
    for row in ROWS
    if row.name.partition(":")[0] in ("serial", "Uno", "I2C", "ADC", "speed") and "20 x" not in row.name
}


@pytest.mark.parametrize("name", ON_THE_BUSES)
def test_a_fault_on_a_bus_ends_as_it_must(new_rig, monkeypatch, name):
    monkeypatch.setattr(hil_rig, "TARE_SAMPLES", 250)
    monkeypatch.setattr(hil_rig, "SETTLE", 0.5)
    row, (rig, log) = ON_THE_BUSES[name], new_rig()
    rig.start(4000.0, 2.0)
    esc = rig.bench.esc.duty_file
    row.inject(Injected(os.getpid(), esc.parents[3], esc))
    began = len(log.rows)
    if row.within is None:
        steps(rig, 150, 4000.0)
        assert rig.states.state is SafetyState.RUN
        assert abs(log["omega"][began:] - 4000.0).max() < 60.0  # no wrong value
    else:
        with pytest.raises(RunEnded, match=row.cause):
            steps(rig, 150, 4000.0)
        assert rig.states.state is SafetyState.FAULT
        assert duties(rig) == IDLE
        assert (len(log.rows) - began) * rig.dt <= 1e-3 * row.within + 0.1
        opened = log["throttle"][began:]
        assert opened.max() <= 1.1 * opened[0]  # no wrong reading opened the throttle
