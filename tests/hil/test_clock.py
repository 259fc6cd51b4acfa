import signal

import pytest

from hil.devices.clock import MonotonicClock, VirtualClock


def test_the_virtual_clock_moves_only_when_somebody_waits():
    clock, notified = VirtualClock(5.0), []
    clock.listeners.append(notified.append)
    assert clock.now() == 5.0
    assert clock.wait_until(5.004) == 0.0
    assert clock.now() == 5.004
    assert notified == [5.004]


def test_the_past_returns_at_once_with_its_lateness():
    clock = MonotonicClock()
    began = clock.now()
    assert clock.wait_until(began - 3.0) == pytest.approx(3.0, abs=0.5)
    assert clock.now() - began < 0.5


def test_a_signal_does_not_shorten_a_wait():
    clock, handled = MonotonicClock(), []
    before = signal.signal(signal.SIGALRM, lambda *_: handled.append(clock.now()))
    try:
        when = clock.now() + 0.06
        signal.setitimer(signal.ITIMER_REAL, 0.01, 0.01)
        late = clock.wait_until(when)
        assert 0.0 <= late <= clock.now() - when
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        assert clock.now() >= when
        assert handled[0] < when  # the handler ran in the middle of the wait, not behind it
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
