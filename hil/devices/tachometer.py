"""The tachometer: an Arduino Uno that times one reflective mark and answers requests over a serial line.

A request is sent at a tick, and its answer is read at the next, so that the loop never waits. At most one request is
outstanding.
"""

import math
import termios
from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol

import serial

from hil.devices import frames
from hil.devices.clock import Clock
from hil.devices.frames import Frame, FrameReader, Hello, encoded
from hil.safety.faults import DeviceFault, FaultKind

BAUD = 500_000
"""The Uno's 16 MHz clock divides to it without a remainder."""
HELLO_WITHIN = 3.0
"""Opening the port resets the board; its bootloader takes a second or two [s]."""
ASK_AFTER, ASK_EVERY = 2.0, 0.25
"""A board that wasn't reset is asked for its greeting; not earlier, because bytes keep a bootloader from ending [s]."""
ANSWER_WITHIN = 0.011
"""After this a request counts as lost: at the third tick of 4 ms the next one goes out [s]."""
GONE = OSError, termios.error
"""Errors of a port whose adapter has dropped out. Those of the terminal's settings are no OSError; pyserial passes them on."""
_MOST_AT_ONCE = 512
_ANSWER_BYTES = frames.FROM_BOARD[frames.ANSWER] + frames.OVERHEAD


class Revolution(NamedTuple):
    """The rotor's last pass of the mark. `pulses`: passes since the board's reset; `period` of the last whole revolution [s],
    inf if none was measured; `age` of the pass [s] at the call that returned this; `stalled`: no pass for 200 ms; `sequence`:
    the request's number; `rejected`: edges rejected since the reset (modulo 256); `received`: when the answer was read [s];
    `closed`: the relay in the ESC's supply was closed; `silent`: it had opened for lack of requests."""

    pulses: int
    period: float
    age: float
    stalled: bool
    sequence: int
    rejected: int
    received: float
    closed: bool = False
    silent: bool = False

    @property
    def omega(self) -> float:
        """Mean speed over the last whole revolution [rpm]; 0 if there is none."""
        return 60.0 / self.period


class Port(Protocol):
    """The part of `serial.Serial` that is used; reads and writes return at once."""

    in_waiting: int

    def read(self, size: int) -> bytes: ...
    def write(self, data: bytes) -> int | None: ...
    def reset_input_buffer(self) -> None: ...
    def close(self) -> None: ...


class Tachometer:
    """The board at `port`: a device's path, or a function that opens another Port. `timeout` [s]: tolerated time without an
    answer.

    DeviceFault: NOT_READY from `hello`; from `poll` SILENT (no bytes), GARBLED (bytes, but no valid answer), UNPLUGGED,
    RESTARTED. `counters`: requests lost, answers without an open request, frames with a wrong CRC, bytes dropped.
    """

    name = "tachometer"

    def __init__(self, port: str | Callable[[], Port], clock: Clock, timeout: float = 0.05):
        self._open, self._clock, self._timeout = port, clock, timeout
        self._port: Port | None = None
        self._reader = FrameReader(frames.FROM_BOARD)
        self._sequence, self._asked = 0, None
        self._due: dict[int, float] = {}
        self._answered = 0.0
        self._received_then = self._heard_then = 0
        self._lost = self._late = 0

    @property
    def counters(self) -> Mapping[str, int]:
        """Counters of recovered errors."""
        reader = self._reader
        return {"lost": self._lost, "late": self._late, "damaged": reader.damaged, "dropped bytes": reader.dropped}

    def hello(self) -> Hello:
        """Open the port and wait for the board's greeting."""
        clock = self._clock
        try:
            self._port = self._opened()
            self._port.reset_input_buffer()
            self._reader.forget()
            begun = asked = clock.now()
            while clock.now() - begun < HELLO_WITHIN:
                clock.wait_until(clock.now() + 0.005)
                found = [frames.read_hello(frame) for frame in self._frames() if frame.type == frames.HELLO]
                if found:
                    return self._agreed(found[-1])
                if clock.now() - begun >= ASK_AFTER and clock.now() - asked >= ASK_EVERY:
                    asked = clock.now()
                    self._port.write(encoded(Frame(frames.ASK_HELLO, 0)))
        except GONE as error:
            self.close()
            raise DeviceFault(self.name, FaultKind.NOT_READY, f"port {self._open}: found {_reason(error)}") from error
        self.close()
        heard = f"{self._reader.received} bytes that are none" if self._reader.received else "nothing"
        detail = f"port {self._open}: found {heard} in {HELLO_WITHIN:g} s, expected a greeting"
        raise DeviceFault(self.name, FaultKind.NOT_READY, detail)

    def request(self) -> None:
        """Ask for the rotor's state, unless an answer is still due. A damaged answer is no longer due."""
        now, heard = self._clock.now(), self._reader.received
        if self._asked is not None:
            if now - self._asked < ANSWER_WITHIN and heard - self._heard_then < _ANSWER_BYTES:
                return
            self._lost += 1
        self._sequence, self._asked, self._heard_then = (self._sequence + 1) % 256, now, heard
        self._due = {number: asked for number, asked in self._due.items() if now - asked < self._timeout}
        self._due[self._sequence] = now
        self._say(frames.ASK_ANSWER, sequence=self._sequence)

    def arm(self) -> None:
        """Close the relay in the ESC's supply; the next answers report it. Requests keep it closed; 0.1 s without opens it."""
        self._say(frames.ARM, frames.WORD)

    def stop(self) -> None:
        """Open the relay."""
        self._say(frames.STOP)

    def _say(self, kind: int, payload: bytes = b"", sequence: int = 0) -> None:
        try:
            if self._port is not None:
                self._port.write(encoded(Frame(kind, sequence, payload)))
        except GONE as error:
            raise DeviceFault(self.name, FaultKind.UNPLUGGED, f"found {_reason(error)}, expected an open port") from error

    def poll(self) -> Revolution | None:
        """The newest answer, if it was not returned yet; else None.

        On a busy machine an answer may arrive after its request counts as lost. It is still valid, and its age is right.
        """
        now, answer = self._clock.now(), None
        try:
            heard = self._frames()
        except GONE as error:
            raise DeviceFault(self.name, FaultKind.UNPLUGGED, f"found {_reason(error)}, expected an open port") from error
        for frame in heard:
            if frame.type == frames.HELLO:
                raise DeviceFault(self.name, FaultKind.RESTARTED, "found a new greeting, expected one at the start")
            asked = self._due.pop(frame.sequence, None) if frame.type == frames.ANSWER else None
            if asked is not None:
                answer = self._revolution(frame, now, asked)
                self._due = {number: later for number, later in self._due.items() if later > asked}
                self._asked = self._asked if self._due else None
                self._answered, self._received_then = now, self._reader.received
            else:
                self._late += 1
        if now - self._answered > self._timeout:
            self._refuse(now)
        return answer

    def close(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    def _opened(self) -> Port:
        if isinstance(self._open, str):
            return serial.Serial(self._open, BAUD, timeout=0, write_timeout=0, exclusive=True)
        return self._open()

    def _frames(self) -> list[Frame]:
        # Bounded: a line full of garbage must not cost the loop its tick.
        waiting = min(self._port.in_waiting, _MOST_AT_ONCE)
        return self._reader.feed(self._port.read(waiting)) if waiting else []

    def _agreed(self, hello: Hello) -> Hello:
        if (hello.version, hello.tick) != (frames.VERSION, round(frames.TICK * 1e6)):
            self.close()
            needed = f"{frames.VERSION} and {1e6 * frames.TICK:g} us"
            detail = f"firmware: found version {hello.version} and a timer of {hello.tick} us, expected {needed}"
            raise DeviceFault(self.name, FaultKind.NOT_READY, detail)
        self._asked, self._due = None, {}
        self._answered, self._received_then = self._clock.now(), self._reader.received
        return hello

    def _revolution(self, frame: Frame, now: float, asked: float) -> Revolution:
        answer = frames.read_answer(frame)
        # The board states the age when it answers, at most a line's delay after the request.
        age = frames.TICK * answer.age + now - asked
        period = frames.TICK * answer.period if answer.flags & frames.MEASURED else math.inf
        stalled, closed, silent = (bool(answer.flags & flag) for flag in (frames.STALLED, frames.CLOSED, frames.SILENT))
        return Revolution(answer.pulses, period, age, stalled, frame.sequence, answer.rejected, now, closed, silent)

    def _refuse(self, now: float) -> None:
        received = self._reader.received - self._received_then
        kind = FaultKind.GARBLED if received else FaultKind.SILENT
        detail = f"found no valid answer for {1e3 * (now - self._answered):.0f} ms in {received} bytes, expected one"
        raise DeviceFault(self.name, kind, detail)


def _reason(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error.args[-1])
