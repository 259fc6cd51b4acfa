"""The board cuts the ESC's supply when its requests end, even if all processes are dead."""

import os
import signal
import time

import pytest
from rigs import LIMITS, steps

from hil.emulator.faults import children_of
from hil.emulator.rig import BYSTANDER, SHOWN
from hil.emulator.rig import EmulatedRig as Emulated
from hil.emulator.shared import SharedNumbers
from hil.loop.rig import RunEnded
from tests.hil.injection import started, wait_for


def bystander(rig):
    return SharedNumbers(rig.bench.esc.duty_file.parents[3] / SHOWN, BYSTANDER)


def test_the_relay_is_closed_for_each_run_and_open_before_and_after_it(new_rig):
    rig, log = new_rig()
    seen = bystander(rig)
    assert seen["relay"] == 0.0
    rig.start(3000.0, 2.0)
    assert seen["relay"] == 1.0
    assert [event["relay"] for event in log.events if "relay" in event] == ["closed"]
    rig.stop()
    for _ in range(2):
        rig.bench.clock.wait_until(rig.bench.clock.now() + 0.004)
    assert seen["relay"] == 0.0
    rig.start(3000.0, 2.0)  # the word again
    assert seen["relay"] == 1.0
    assert sum("tare" in event for event in rig.events) == 2
    seen.close()


def test_without_requests_the_supply_is_cut_and_thrust_falls_though_the_pulse_remains(new_rig):
    rig, _ = new_rig()
    rig.start(5000.0, 5.0)
    seen, clock, pulse = bystander(rig), rig.bench.clock, rig.bench.esc.duty_file.read_text()
    before, began = seen["thrust"], clock.now()
    while seen["relay"]:
        clock.wait_until(clock.now() + 0.001)
    assert clock.now() - began == pytest.approx(0.1, abs=0.008)  # after the last request, which was a tick ago
    clock.wait_until(clock.now() + 1.0)
    assert seen["thrust"] < 0.2 * before
    assert rig.bench.esc.duty_file.read_text() == pulse  # nobody has touched it
    seen.close()


def test_a_relay_that_opens_in_a_run_ends_it_at_once(new_rig):
    rig, _ = new_rig()
    rig.start(3000.0, 2.0)
    rig.bench.tachometer.stop()
    with pytest.raises(RunEnded, match="relay: relay open: found it open, expected it closed in a run: commanded"):
        steps(rig, 10)
    assert rig.states.state.value == "fault"


def test_a_relay_that_does_not_close_keeps_the_rotor_from_turning(new_rig, monkeypatch):
    rig, log = new_rig()
    monkeypatch.setattr(rig.bench.tachometer, "arm", lambda: None)
    with pytest.raises(RunEnded, match=r"relay: not ready: found open 0\.5 s after"):
        rig.start(3000.0, 2.0)
    assert log["throttle"].max() == 0.0


def test_supervisor_loop_and_writer_killed_at_once_leave_a_rotor_without_supply(tmp_path):
    """The last pulse remains on the pin, and no process is left to change it."""
    with started({"seconds": 20, "physics": {"lingers": 5.0}}, tmp_path) as (process, messages):
        here = wait_for(messages, "esc", process)
        assert wait_for(messages, "running", process), messages
        shown = SharedNumbers(f"{here['at']}/{SHOWN}", BYSTANDER)
        before = shown["thrust"]
        assert shown["relay"] == 1.0
        assert before > 3.0
        for pid in [*(p for p, words in children_of(process.pid) if "emulator" not in words), process.pid]:
            os.kill(pid, signal.SIGKILL)
        began = time.monotonic()
        while shown["relay"] and time.monotonic() - began < 5.0:
            time.sleep(0.001)
        took = time.monotonic() - began
        assert took < 1.0  # 0.12 s on an idle machine
        time.sleep(1.0)
        assert shown["thrust"] < 0.3 * before
        with open(here["esc"], "rb") as file:
            assert file.read().split(b"\n")[0] != b"%d" % here["idle"]  # the kernel leaves the throttle open
        shown.close()


def test_the_limits_are_those_of_the_papers_rig():
    assert Emulated().lingers == 0.0
    assert LIMITS.late < 0.1  # the loop gives up before the board does
