import math
import os
import time

import numpy as np
import pytest
from rigs import CALIBRATION, IDLE, LIMITS, Rows, asked, duties, serial_faults, steps, transitions

from hil.emulator.faults import OUTSIDE, Target
from hil.emulator.process import real_time_bench
from hil.emulator.rig import ZERO_SHIFT
from hil.emulator.rig import EmulatedRig as Emulated
from hil.loop.columns import COLUMNS, STATES
from hil.loop.realtime import real_time
from hil.loop.rig import RAMP, RigPlant, RunEnded
from hil.safety.faults import Fault, FaultKind
from hil.safety.limits import Cut, Limits
from hil.safety.states import SafetyState
from hil.safety.tare import tare as tare_of


def states(log):
    return [STATES[int(k)] for k in log["state"]]


def test_a_run_goes_through_its_states_and_comes_back(new_rig):
    rig, log = new_rig()
    rig.start(3000.0, 2.0)
    rig.step(3000.0, 2.0)
    rig.stop()
    assert [state for _, state, _ in transitions(rig)] == ["safe", "armed", "run", "ramp down", "safe"]
    found = states(log)
    assert list(dict.fromkeys(found)) == ["safe", "armed", "run", "ramp down"]
    assert duties(rig) == IDLE


def test_the_tare_finds_the_zero_that_moved(new_rig, monkeypatch):
    (rig, _), found = new_rig(), []
    monkeypatch.setattr("hil.loop.rig.tare", lambda *given: found.append(tare_of(*given)) or found[-1])
    rig.start(3000.0, 2.0)
    (tare,) = found
    assert [event["tare"]["zero_counts"] for event in rig.events if "tare" in event] == [tare.zero]
    assert tare.zero == pytest.approx(CALIBRATION.zero + ZERO_SHIFT, abs=5.0 * tare.error + 0.5)
    assert tare.noise * CALIBRATION.newton_per_count == pytest.approx(math.hypot(0.12, 0.047), rel=0.15)


def test_the_limits_act_between_commands_and_outputs(new_rig):
    rig, log = new_rig()
    rig.start(3000.0, 2.0)
    for _ in range(100):
        rig.step(9000.0, -40.0)
    assert (log["omega_ref"][-1], log["beta_ref"][-1]) == (LIMITS.omega_max, LIMITS.beta_min)
    assert int(log["cut"][-1]) == Cut.OMEGA_RANGE | Cut.BETA_RANGE
    moves = np.diff(log["omega_ref"][-101:])
    assert moves.max() <= LIMITS.omega_slew * rig.dt + 1e-9


def test_a_controller_that_says_nan_ends_the_run_by_a_ramp(new_rig):
    rig, log = new_rig()
    rig.start(4000.0, 2.0)
    with pytest.raises(RunEnded, match="controller: not a number"):
        rig.step(math.nan, 2.0)
    assert rig.states.state is SafetyState.FAULT
    assert duties(rig) == IDLE
    throttle = log["throttle"][np.array(states(log)) == "ramp down"]
    assert (np.diff(throttle) < 0.0).all()
    assert -np.median(np.diff(throttle)) == pytest.approx(rig.dt / RAMP)
    with pytest.raises(RunEnded):  # it is latched
        rig.step(4000.0, 2.0)


def test_a_silent_tachometer_freezes_the_throttle_and_ends_the_run(new_rig):
    rig, log = new_rig()
    rig.start(4000.0, 2.0)
    steps(rig, 20, 4000.0)
    faults = serial_faults(rig)
    faults["silent"] = math.inf
    faults.close()
    began = len(log.rows)
    with pytest.raises(RunEnded, match="tachometer"):
        steps(rig, 100, 5000.0)  # a loop that did not freeze would open the throttle
    held = [k for k in range(began, len(log.rows)) if states(log)[k] == "run"]
    assert 0.04 <= len(held) * rig.dt <= 0.1
    assert np.ptp(log["throttle"][held[7:]]) == 0.0


def test_the_operator_ends_a_run_in_order(new_rig):
    signals = asked(None)
    rig, _ = new_rig(signals=signals)
    rig.start(3000.0, 2.0)
    signals.asked = Fault("operator", FaultKind.INTERRUPTED, "Ctrl-C")
    with pytest.raises(RunEnded, match="Ctrl-C"):
        steps(rig, 2)
    assert rig.states.state is SafetyState.SAFE
    assert duties(rig) == IDLE


def test_a_log_that_cannot_be_written_ends_the_run_by_a_ramp(new_rig):
    rig, log = new_rig()
    rig.start(4000.0, 2.0)
    log.broken = "no space left on device"
    with pytest.raises(RunEnded, match="log: log lost: no space left on device"):
        steps(rig, 3)
    assert "ramp down" in [state for _, state, _ in transitions(rig)]
    assert duties(rig) == IDLE


def test_in_real_time_the_same_rig_runs_in_a_separate_process():
    """Faults that are set in this process act in the other."""
    bench = real_time_bench(Emulated(seed=1), CALIBRATION)
    log, folder = Rows(COLUMNS), bench.esc.duty_file.parents[3]
    rig = RigPlant(bench, Limits(late=0.1, missed_share=0.5), log)  # tolerates a busy machine
    began = time.monotonic()
    with real_time():
        rig.idle(250)
    assert 0.99 <= time.monotonic() - began < 10.0
    assert duties(rig) == IDLE
    assert np.ptp(log["counts"]) > 0
    for fault in ("ADC: frozen", "serial: unplugged"):
        OUTSIDE[fault](Target(os.getpid(), folder, bench.esc.duty_file))
        rig.idle(25)
    assert {FaultKind.FROZEN, FaultKind.UNPLUGGED} <= {fault.kind for fault in rig.states.faults}
    rig.close()
    assert len(log.rows) == 300
    assert not folder.exists()
    with pytest.raises(ChildProcessError):
        os.waitpid(-1, os.WNOHANG)
