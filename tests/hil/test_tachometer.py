import math
import os
import random
import threading
import time

import pytest
import serial
from rigs import within

from hil.devices.clock import MonotonicClock, VirtualClock
from hil.devices.frames import ANSWER, HELLO, Answer, Frame, Hello, encoded
from hil.devices.tachometer import BAUD, Tachometer
from hil.emulator.serial_line import MemoryLine, PtyLine
from hil.emulator.uno import Uno
from hil.safety.faults import DeviceFault, FaultKind

TICK = 0.004
MICROTICK = 4e-6
UP = 50.5
"""Time [s] at which a board that is reset at 50 s has booted, and begins to count."""


def marks(period: float, until: float = math.inf):
    """A rotor that turns evenly until some time and then stops."""

    def pulses(t):
        count = math.floor(min(t, until) / period)
        return count, count * period, period

    return pulses


class Loop:
    """A tachometer on an emulated line under a virtual clock, ticked as the rig does."""

    def __init__(self, folder, pulses, **board):
        self.clock = VirtualClock(50.0)
        self.line = MemoryLine(Uno(pulses, **board), folder / "line", self.clock)
        self.clock.listeners.append(self._follow)
        self.tachometer = Tachometer(self.line.open_port, self.clock)
        self.tachometer.hello()

    def _follow(self, t):
        for k in range(9, -1, -1):
            self.line.serve(t - k * TICK / 10)

    def tick(self):
        self.tachometer.request()
        self.clock.wait_until(self.clock.now() + TICK)
        return self.tachometer.poll()


@pytest.fixture
def loop(tmp_path):
    return Loop(tmp_path, marks(0.015))


def fault(call):
    with pytest.raises(DeviceFault) as raised:
        call()
    assert raised.value.device == "tachometer"
    return raised.value.kind


@pytest.mark.parametrize("omega", [400.0, 2000.0, 4000.0, 6000.0, 11_900.0])
def test_speed_count_and_age_follow_the_mark(tmp_path, omega):
    loop, period = Loop(tmp_path, marks(60.0 / omega)), 60.0 / omega
    first = math.floor(UP / period)
    for k in range(300):
        answer, now = loop.tick(), loop.clock.now()
        assert answer.received == now
        if k * TICK > 2 * period:
            # The period is rounded to whole ticks of the timer.
            assert answer.omega == pytest.approx(omega, rel=1.01 * MICROTICK / period)
            assert not answer.stalled
        arrived = now - TICK + 0.0005  # when the request reached the board
        assert answer.pulses == math.floor(arrived / period) - first
        if answer.pulses:
            assert answer.age == pytest.approx(arrived % period + TICK, abs=0.0006)


def test_a_stall_is_reported_after_200_ms_and_the_next_revolution_has_no_period(tmp_path):
    stops = 51.0
    turning = marks(0.02, stops)

    def pulses(t):  # on again after 0.5 s
        count, last, period = turning(t)
        if t > stops + 0.5:
            more = math.floor((t - stops - 0.5) / 0.02)
            return count + more, stops + 0.5 + more * 0.02 if more else last, period
        return count, last, period

    loop, seen = Loop(tmp_path, pulses), []
    while loop.clock.now() < 52.0:
        answer = loop.tick()
        seen.append((loop.clock.now(), answer))
    stalled = [t for t, answer in seen if answer.stalled and t > 50.9]
    assert stalled[0] == pytest.approx(stops + 0.2, abs=2 * TICK)
    assert stalled[-1] == pytest.approx(stops + 0.52, abs=2 * TICK)
    again = [answer for t, answer in seen if t > stalled[-1]]
    assert again[0].period == math.inf
    assert again[0].omega == 0.0
    assert again[-1].omega == pytest.approx(3000.0, rel=1e-3)


def test_silence_is_tolerated_for_50_ms(loop):
    loop.tick()
    begun = loop.clock.now()
    loop.line.faults["silent"] = math.inf
    while loop.clock.now() < begun + 0.048 - 1e-9:
        assert loop.tick() is None
    assert fault(loop.tick) is FaultKind.SILENT
    loop.line.faults["silent"] = 0
    loop.clock.wait_until(loop.clock.now() + 0.02)
    loop.tachometer.request()
    loop.clock.wait_until(loop.clock.now() + 0.02)
    assert loop.tachometer.poll() is not None  # it continues, because the ramp down needs the speed


def test_flipped_bits_never_give_a_wrong_value(tmp_path):
    """A random quarter of the answers is damaged; every answer that passes is correct."""
    loop, chance = Loop(tmp_path, marks(0.015)), random.Random(3)
    passed = 0
    first = math.floor(UP / 0.015)
    for k in range(5000):
        loop.line.faults["flipped"] = chance.random() < 1 / 4
        asked = loop.clock.now()
        answer = loop.tick()
        if answer is not None and k > 10:
            passed += 1
            assert answer.omega == pytest.approx(4000.0, rel=3e-4)
            assert math.floor((asked - 0.015) / 0.015) <= answer.pulses + first <= math.floor(loop.clock.now() / 0.015)
    counters = loop.tachometer.counters
    assert passed == pytest.approx(0.75 * 5000, rel=0.05)  # a damaged answer costs no other one
    assert counters["lost"] == pytest.approx(0.25 * 5000, rel=0.1)
    assert counters["damaged"] > 500


def test_an_answer_that_comes_too_late_is_not_taken_for_the_next_one(loop):
    loop.tick()
    loop.tachometer.request()
    late = encoded(Frame(ANSWER, 1, Answer(9999, 0, 2500, 0, 2, 0).packed()))
    loop.line._say(late)
    loop.clock.wait_until(loop.clock.now() + TICK)
    answer = loop.tachometer.poll()
    assert (answer.sequence, answer.pulses) == (2, answer.pulses)
    assert answer.pulses < 9999
    assert loop.tachometer.counters["late"] == 1


def test_a_reset_mid_run_is_a_fault(loop):
    for _ in range(10):
        loop.tick()
    loop.line.faults["resets"] = 1
    kinds = []
    for _ in range(round(0.6 / TICK)):
        try:
            loop.tick()
        except DeviceFault as error:
            kinds.append(error.kind)
    assert kinds[0] is FaultKind.SILENT  # while it boots
    assert FaultKind.RESTARTED in kinds  # its greeting
    assert kinds.count(FaultKind.RESTARTED) == 1
    assert loop.tick() is not None


def test_a_plug_that_is_pulled_is_a_fault_at_once(loop):
    loop.tick()
    loop.line.faults["unplugged"] = 1
    assert fault(loop.tachometer.poll) is FaultKind.UNPLUGGED
    assert fault(loop.tachometer.request) is FaultKind.UNPLUGGED


class Script:
    """A port whose far end answers each write by a function; only `greeting` comes without a write."""

    def __init__(self, greeting=b"", answer=lambda data: b""):
        self.written, self._to_read, self._answer, self.closed = [], greeting, answer, False

    in_waiting = property(lambda self: len(self._to_read))

    def read(self, size):
        data, self._to_read = self._to_read[:size], self._to_read[size:]
        return data

    def write(self, data):
        self.written.append(data)
        self._to_read += self._answer(data)

    def reset_input_buffer(self):
        pass

    def close(self):
        self.closed = True


GREETING = encoded(Frame(HELLO, 0, Hello(2, 4, 1250, 50000).packed()))


def test_a_board_that_was_not_reset_is_asked_after_two_seconds():
    clock = VirtualClock()
    port = Script(answer=lambda data: GREETING)
    Tachometer(lambda: port, clock).hello()
    assert clock.now() == pytest.approx(2.0, abs=0.02)
    assert port.written == [encoded(Frame(0x96, 0))]


@pytest.mark.parametrize(("received", "says"), [(b"", "found nothing in 3 s"), (b"junk", "4 bytes that are none")])
def test_no_greeting_within_three_seconds(received, says):
    clock, port = VirtualClock(), Script(received)
    with pytest.raises(DeviceFault, match=says) as raised:
        Tachometer(lambda: port, clock).hello()
    assert raised.value.kind is FaultKind.NOT_READY
    assert clock.now() == pytest.approx(3.0, abs=0.02)
    assert port.closed


def test_another_firmware_is_refused():
    port = Script(encoded(Frame(HELLO, 0, Hello(1, 4, 1250, 50000).packed())))
    with pytest.raises(DeviceFault, match="firmware: found version 1 and a timer of 4 us, expected 2 and 4 us"):
        Tachometer(lambda: port, VirtualClock()).hello()
    assert port.closed


@pytest.mark.parametrize("moment", ["before the first use", "while it waits for the greeting"])
def test_an_adapter_that_drops_out_is_reported(moment):
    """A real terminal whose other end closes: its settings then fail by termios.error, its bytes by OSError."""
    ours, theirs = os.openpty()
    other = os.fdopen(ours, "wb", buffering=0)

    def opened():
        port = serial.Serial(os.ttyname(theirs), BAUD, timeout=0, write_timeout=0)
        os.close(theirs)
        if moment == "before the first use":
            other.close()
        return port

    clock = VirtualClock()
    clock.listeners.append(lambda t: t > 1.0 and other.close())
    with pytest.raises(DeviceFault, match=r"tachometer: not ready: port .*: found ") as failed:
        Tachometer(opened, clock).hello()
    assert failed.value.kind is FaultKind.NOT_READY


@pytest.fixture
def terminal(tmp_path):
    """A real pty, served in a thread as the emulated rig's process does."""
    line = PtyLine(Uno(marks(0.015), boot=0.05), tmp_path / "line", tmp_path / "tty")
    ended = threading.Event()

    def serve():
        while not ended.is_set():
            line.serve(time.monotonic())
            time.sleep(0.0005)

    thread = threading.Thread(target=serve)
    thread.start()
    yield line, str(tmp_path / "tty")
    ended.set()
    thread.join()
    line.close()


def test_opening_the_pty_again_resets_the_board(terminal):
    line, path = terminal
    for _ in range(2):
        opened = time.monotonic()
        tachometer = Tachometer(path, MonotonicClock(), timeout=10.0)
        tachometer.hello()
        time.sleep(0.1)
        tachometer.request()
        pulses = within(5.0, tachometer.poll).pulses
        assert 3 < pulses <= (time.monotonic() - opened) / 0.015 + 1  # none from before it was opened
        tachometer.close()
        within(5.0, lambda: not line._open)


def test_a_line_full_of_garbage_costs_a_tick_no_more_than_512_bytes(loop):
    loop.tick()
    loop.line._say(bytes(100_000))
    before = loop.tachometer._reader.received
    loop.tachometer.poll()
    assert loop.tachometer._reader.received - before == 512
