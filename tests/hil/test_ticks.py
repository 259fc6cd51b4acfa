import pytest

from hil.devices.clock import VirtualClock
from hil.loop.ticks import Ticks


def test_ticks_come_at_whole_multiples_of_the_period():
    clock = VirtualClock(7.0)
    ticks = Ticks(clock, 0.004)
    for k in range(1, 1001):
        tick = ticks.wait()
        assert (tick.slot, tick.late, tick.missed) == (k, 0.0, 0)
        assert clock.now() == 7.0 + k * 0.004  # no sum of errors
    assert (ticks.ticks, ticks.missed, ticks.time) == (1000, 0, 4.0)


def test_missed_slots_are_skipped_and_the_phase_stays():
    clock = VirtualClock()
    ticks = Ticks(clock, 0.004)
    ticks.wait()
    clock.wait_until(0.0185)  # slots 2, 3 have passed, 4 runs
    late = ticks.wait()
    assert (late.slot, late.missed) == (4, 2)
    assert late.late == pytest.approx(0.0105)
    ticks.wait()
    assert clock.now() == 0.02  # not 0.0185 + 0.004
    assert (ticks.ticks, ticks.missed, ticks.slot) == (3, 2, 5)


@pytest.mark.parametrize(("done", "late"), [(0.0039, 0.0), (0.0079, 0.0039)])
def test_a_tick_in_time_or_a_little_late_keeps_its_slot(done, late):
    clock = VirtualClock()
    ticks = Ticks(clock, 0.004)
    clock.wait_until(done)
    tick = ticks.wait()
    assert (tick.slot, tick.missed) == (1, 0)
    assert tick.late == pytest.approx(late)
    assert clock.now() == max(done, 0.004)
