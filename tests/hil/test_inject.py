"""Faults that a user injects into a run on the emulated rig."""

import json
import signal

import pytest
from rigs import begun, setup, step_profile, transitions

from hil.emulator.faults import AT_ONCE, FAULTS, OUTSIDE, WITHIN
from hil.loop.cycle import PERIOD
from hil.loop.log import read_events
from hil.run import run_on_rig
from hil.safety.states import SafetyState
from tests.hil.faults import ROWS
from vpp_fmu.app.cli import main
from vpp_fmu.plants import KernelController

pytestmark = pytest.mark.usefixtures("short_waits")

CAUSES = {row.name: row for row in ROWS}
"""The required outcomes, of the table in real time."""


def test_every_fault_that_can_be_injected_is_a_row_of_the_table():
    assert {name for name in FAULTS if not name.startswith("twin: ")} <= set(CAUSES)
    assert any(row.inject is OUTSIDE["twin: 5 N too many"] for row in ROWS)
    for name, row in CAUSES.items():
        assert row.inject is OUTSIDE.get(name, row.inject)
        assert row.task.get("sabotage") == WITHIN.get(name, row.task.get("sabotage"))


@pytest.mark.sampled("name")
@pytest.mark.parametrize("name", [*(name for name in AT_ONCE if not name.startswith("twin: ")), "controller: NaN"])
def test_in_virtual_time_it_ends_as_the_table_says_at_the_time_that_was_asked_for(name, tmp_path):
    row, profile = CAUSES[name], step_profile(5.0, 8.0, hold=1.0)
    done = run_on_rig(setup(), KernelController(), profile, tmp_path, inject=(name, 0.8))
    assert done.ended.startswith(row.cause)
    assert bool(done.ended) == (row.state == "fault")
    assert done.session.rig.states.state is SafetyState(row.state)
    (came,) = [at for at, _, why in transitions(done.session.rig) if why == f"injected: {name}"]
    closed = done.log.time[done.log["omega_wanted"] == done.log["omega_wanted"]][0]
    assert came == pytest.approx(closed + 0.8, abs=0.005)
    if done.ended:
        assert 0.8 - PERIOD <= done.record.time[-1] < 0.8 + 1e-3 * (row.within or 0.0)
    else:
        assert done.record.time[-1] == pytest.approx(3.0, abs=0.005)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["serial: silense"], "Did you mean serial: silence"),
        (["?"], "; ".join(FAULTS)),
        (["SIGKILL"], "expected a run in real time"),
        (["serial: silence", "4"], "found 4, expected one number from 0 to 3 s"),
        (["serial: silence", "soon"], "found soon, expected one number"),
        (["serial: silence", "1", "2"], "found 1 2, expected one number"),
        (["SIGKILL", "--rig", "fmu", "x.fmu"], "--inject: found --rig fmu, expected an emulated rig"),
    ],
)
def test_another_one_is_refused_in_one_line(words, says, tmp_path, refused):
    (tmp_path / "p.csv").write_text("time,thrust_set\n0,4\n3,4\n")
    run = ["hil", "run", *["--virtual"] * ("--rig" not in words), "--profile", tmp_path / "p.csv", "-o", tmp_path / "out"]
    assert says in refused(*run, "--inject", *words)
    assert not list(tmp_path.rglob("hil.json"))


def test_the_report_and_hil_json_tell_of_it(tmp_path):
    (tmp_path / "p.csv").write_text("time,thrust_set\n0,4\n2,4\n")
    run = ["hil", "run", "--virtual", "--profile", str(tmp_path / "p.csv"), "-o", str(tmp_path / "out")]
    assert main([*run, "--inject", "serial: silence", "0.5"]) == 2
    assert json.loads((tmp_path / "out" / "hil.json").read_text())["injected"] == {"fault": "serial: silence", "after": 0.5}
    assert "injected: serial: silence" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.xdist_group("real time")
def test_in_real_time_a_loop_is_killed_by_another_process(tmp_path):
    process = begun(tmp_path, 2.0, "--inject", "SIGKILL", "0.5")
    process.communicate(timeout=90)
    assert process.returncode == -signal.SIGKILL
    (events,) = (tmp_path / "out" / "runs").glob("*/*.events.jsonl")
    assert any(event.get("why") == "injected: SIGKILL" for event in read_events(events))
