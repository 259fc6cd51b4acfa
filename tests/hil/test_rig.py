import math
import os
import time

import numpy as np
import pytest
from rigs import CALIBRATION, IDLE, LIMITS, Rows, asked, duties, serial_faults, virtual_rig

from hil.columns import COLUMNS, STATES
from hil.emulator.process import real_time_bench
from hil.emulator.rig import ZERO_SHIFT
from hil.emulator.rig import Rig as Emulated
from hil.physics.rig_model import FULL_RIG
from hil.realtime import real_time
from hil.rig import RAMP, Rig, RunEnded
from hil.safety.faults import Fault, FaultKind
from hil.safety.limits import Cut, Limits
from hil.safety.states import SafetyState
from vpp_fmu.kernel.simulation import Simulation


@pytest.fixture
def rig_and_log():
    rig, log = virtual_rig(COLUMNS)
    yield rig, log
    rig.close()


def steps(rig, count, omega_ref=3000.0):
    for _ in range(count):
        rig.step(omega_ref, 2.0)


def states(log):
    return [STATES[int(k)] for k in log["state"]]


def test_a_run_goes_through_its_states_and_comes_back(rig_and_log):
    rig, log = rig_and_log
    rig.start(3000.0, 2.0)
    rig.step(3000.0, 2.0)
    rig.stop()
    assert [state for _, state, _ in rig.transitions] == ["safe", "safe", "armed", "run", "ramp down", "safe"]
    found = states(log)
    assert list(dict.fromkeys(found)) == ["safe", "armed", "run", "ramp down"]
    assert duties(rig) == IDLE


def test_the_tare_finds_the_zero_that_moved(rig_and_log):
    rig, _ = rig_and_log
    rig.start(3000.0, 2.0)
    (tare,) = rig.tares
    assert tare.zero == pytest.approx(CALIBRATION.zero + ZERO_SHIFT, abs=5.0 * tare.error + 0.5)
    assert tare.noise * CALIBRATION.newton_per_count == pytest.approx(math.hypot(0.12, 0.047), rel=0.15)


def test_its_settled_readings_are_those_of_the_physical_model(rig_and_log):
    rig, _ = rig_and_log
    rig.start(4500.0, 6.0)
    shown = np.array([rig.step(4500.0, 6.0)[:2] for _ in range(1000)])
    settled = Simulation(FULL_RIG).start({"omega_ref": 4500.0, "beta_ref": 6.0})
    assert shown[:, 0].mean() == pytest.approx(settled["thrust"], abs=0.05)
    assert shown[:, 1].mean() == pytest.approx(settled["omega"], rel=2e-3)


def test_every_tick_is_a_row_at_its_time(rig_and_log):
    rig, log = rig_and_log
    rig.start(3000.0, 2.0)
    for _ in range(100):
        rig.step(3000.0, 2.0)
    rig.stop()
    assert len(log.rows) == rig.ticks.ticks
    np.testing.assert_allclose(np.diff(log["time"]), 0.004, atol=1e-9)
    assert not log["missed"].any()


def test_a_row_holds_the_sample_before_the_command_that_acts_from_it_on(rig_and_log):
    rig, log = rig_and_log
    rig.start(3000.0, 2.0)
    before = rig.last
    rig.step(3100.0, 3.0)
    assert (log["thrust"][-1], log["omega"][-1]) == (before.thrust, before.omega)
    assert (log["omega_wanted"][-1], log["beta_wanted"][-1]) == (3100.0, 3.0)
    assert (log["omega_ref"][-1], log["beta_ref"][-1]) == rig.acting


def test_the_limits_act_between_commands_and_outputs(rig_and_log):
    rig, log = rig_and_log
    rig.start(3000.0, 2.0)
    for _ in range(100):
        rig.step(9000.0, -40.0)
    assert rig.acting == (LIMITS.omega_max, LIMITS.beta_min)
    assert int(log["cut"][-1]) == Cut.OMEGA_RANGE | Cut.BETA_RANGE
    moves = np.diff(log["omega_ref"][-101:])
    assert moves.max() <= LIMITS.omega_slew * rig.dt + 1e-9


def test_the_first_tick_of_a_run_starts_from_the_idle_throttle(rig_and_log):
    rig, log = rig_and_log
    rig.start(3000.0, 2.0)
    first = states(log).index("run")
    assert not log["throttle"][:first].any()
    assert log["throttle"][first] < 0.01


def test_a_controller_that_says_nan_ends_the_run_by_a_ramp(rig_and_log):
    rig, log = rig_and_log
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


def test_a_silent_tachometer_freezes_the_throttle_and_ends_the_run(rig_and_log):
    rig, log = rig_and_log
    rig.start(4000.0, 2.0)
    for _ in range(20):
        rig.step(4000.0, 2.0)
    faults = serial_faults(rig)
    faults["silent"] = math.inf
    began = len(log.rows)
    with pytest.raises(RunEnded, match="tachometer"):
        steps(rig, 100, 5000.0)  # a loop that did not freeze would open the throttle
    faults.close()
    held = [k for k in range(began, len(log.rows)) if states(log)[k] == "run"]
    assert 0.04 <= len(held) * rig.dt <= 0.1
    assert np.ptp(log["throttle"][held[7:]]) == 0.0


def test_the_operator_ends_a_run_in_order(rig_and_log):
    _, _ = rig_and_log
    signals = asked(None)
    rig, _ = virtual_rig(COLUMNS, signals=signals)
    try:
        rig.start(3000.0, 2.0)
        signals.asked = Fault("operator", FaultKind.INTERRUPTED, "Ctrl-C")
        with pytest.raises(RunEnded, match="Ctrl-C"):
            steps(rig, 2)
        assert rig.states.state is SafetyState.SAFE
        assert duties(rig) == IDLE
    finally:
        rig.close()


def test_the_operator_may_stop_before_anything_turns():
    rig, log = virtual_rig(COLUMNS, signals=asked(Fault("operator", FaultKind.INTERRUPTED, "Ctrl-C")))
    with pytest.raises(RunEnded, match="Ctrl-C"):
        rig.start(3000.0, 2.0)
    rig.close()
    assert set(states(log)) == {"safe"}


def test_a_run_that_lasts_too_long_is_ended():
    rig, _ = virtual_rig(COLUMNS, limits=Limits(run_time=5.0))
    rig.start(3000.0, 2.0)
    with pytest.raises(RunEnded, match="run time"):
        steps(rig, 2000)
    rig.close()


def test_one_rig_runs_twice_and_tares_twice(rig_and_log):
    rig, _ = rig_and_log
    for _ in range(2):
        rig.start(3000.0, 2.0)
        rig.stop()
    assert len(rig.tares) == 2


def test_the_same_seed_gives_the_same_run_to_the_bit():
    def rows(seed):
        rig, log = virtual_rig(COLUMNS, Emulated(seed=seed))
        rig.start(3000.0, 2.0)
        for k in range(200):
            rig.step(3000.0 + 5.0 * k, 2.0)
        rig.close()
        return np.array(log.rows, float)

    np.testing.assert_array_equal(rows(3), rows(3))
    assert not np.array_equal(rows(3), rows(4), equal_nan=True)


@pytest.mark.parametrize(("lost", "tolerated"), [(6, True), (1000, False)])
def test_a_late_answer_after_a_break_gets_the_patience_of_a_run(lost, tolerated):
    rig, _ = virtual_rig(COLUMNS)
    clock, faults = rig.bench.clock, serial_faults(rig)
    clock.wait_until(clock.now() + 1.0)  # the last answer is as old as the break is long
    faults["silent"] = lost
    try:
        rig.idle(5)
        assert [fault.kind for fault in rig.states.faults][:1] == ([] if tolerated else [FaultKind.SILENT])
    finally:
        faults.close()
        rig.close()


def test_in_real_time_the_same_rig_runs_in_a_separate_process():
    bench = real_time_bench(Emulated(seed=1), CALIBRATION)
    log, folder = Rows(COLUMNS), bench.esc.duty_file.parents[3]
    rig = Rig(bench, Limits(late=0.1, missed_share=0.5), log)  # tolerates a busy machine
    began = time.monotonic()
    with real_time():
        rig.idle(250)
    assert 0.99 <= time.monotonic() - began < 10.0
    assert duties(rig) == IDLE
    rig.close()
    assert len(log.rows) == 250
    assert np.ptp(log["counts"]) > 0
    assert not folder.exists()
    with pytest.raises(ChildProcessError):
        os.waitpid(-1, os.WNOHANG)
