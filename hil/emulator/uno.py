"""The tachometer's board, emulated: the logic of `hil/firmware/tachometer` without registers."""

import math
from collections.abc import Callable

from hil.devices import frames
from hil.devices.frames import TICK, Answer, Frame, FrameReader, Hello, encoded
from hil.emulator.shared import SharedNumbers

REJECT, STALL, SILENCE = 1250, 50_000, 25_000
"""Edges closer than 5 ms are no marks; 200 ms without one is a stall; 100 ms without a request open the relay [ticks]."""
_LARGEST = 0xFFFF


class Rotor:
    """The mark's passes as the board's interrupt sees them. Times are ticks of 4 us on a counter of 32 bits."""

    def __init__(self):
        self.pulses = self.last = self.period = self.rejected = 0
        self.turning = False

    def edge(self, now: int) -> None:
        """Process a falling edge of the sensor's output."""
        since = now - self.last & 0xFFFFFFFF
        if self.turning and since < REJECT:
            self.rejected = self.rejected + 1 & 0xFF
            return
        self.period = since if self.turning and since <= STALL else 0
        self.turning, self.last, self.pulses = True, now, self.pulses + 1 & 0xFFFFFFFF

    def answer(self, now: int) -> Answer:
        """The answer at this time; a stall is noted."""
        if self.turning and (now - self.last & 0xFFFFFFFF) > STALL:
            self.turning, self.period = False, 0
        flags = (0 if self.turning else frames.STALLED) | (frames.MEASURED if self.period else 0)
        age = now - self.last & 0xFFFFFFFF if self.turning else _LARGEST
        return Answer(self.pulses, self.last, self.period, age, flags, self.rejected)


class Relay:
    """The relay in the ESC's supply, as the board controls it. Times are ticks, as the rotor's."""

    def __init__(self):
        self.closed = self.silent = False
        self._heard = 0

    def arm(self, now: int) -> None:
        """Close it, since the word has come."""
        self.closed, self.silent, self._heard = True, False, now

    def heard(self, now: int) -> None:
        self._heard = now

    def stop(self) -> None:
        self.closed = False

    def watch(self, now: int) -> None:
        """Open it if requests have stopped."""
        if self.closed and (now - self._heard & 0xFFFFFFFF) > SILENCE:
            self.closed, self.silent = False, True

    @property
    def flags(self) -> int:
        return (frames.CLOSED if self.closed else 0) | (frames.SILENT if self.silent else 0)


class Uno:
    """The board. `pulses(t)`: passes of the mark up to t, time of the last [s], period of the last whole revolution [s].

    `boot`: from a reset to its greeting [s].
    """

    def __init__(self, pulses: Callable[[float], tuple[int, float, float]], boot: float = 0.5):
        self._pulses, self._boot = pulses, boot
        self._seen = 0
        self._up: float | None = None  # when it will be up, while it boots
        self._since: float | None = None  # when it came up: its time's zero; None before the first reset and while it boots
        self._rotor, self._reader, self.relay = Rotor(), FrameReader(frames.FROM_HOST), Relay()

    def watch(self, t: float) -> bool:
        """Whether the relay is closed at time t [s]."""
        if self._since is not None:
            self.relay.watch(self._ticks(t))
        return self.relay.closed

    def reset(self, t: float) -> None:
        """Reset, as when the port is opened: it forgets everything and greets once it is up."""
        self._up, self._since = t + self._boot, None
        self._rotor, self._reader, self.relay = Rotor(), FrameReader(frames.FROM_HOST), Relay()

    def greeting(self, t: float) -> bytes:
        """The greeting, when the board has just come up at time t; else nothing."""
        if self._up is None or t < self._up:
            return b""
        self._since, self._up = self._up, None
        self._seen = self._pulses(t)[0]
        return self._hello(0)

    def look(self, t: float, faults: SharedNumbers) -> None:
        """Process the mark's passes up to time t."""
        if self._since is None:
            return
        count, last, period = self._pulses(t)
        passed, self._seen = count - self._seen, count
        for back in range(passed - 1, -1, -1):
            when = last - back * period if back else last
            if faults["marks_lost"] or (faults["marks_halved"] and (count - back) % 2):
                continue
            if faults["marks_doubled"] and math.isfinite(period):
                self._rotor.edge(self._ticks(when - 0.5 * period))
            self._rotor.edge(self._ticks(when))

    def heard(self, data: bytes, t: float) -> bytes:
        """The board's answer to bytes from the host at time t."""
        if self._since is None:
            return b""
        said = b""
        for frame in self._reader.feed(data):
            if frame.type == frames.ASK_ANSWER:
                self.relay.watch(self._ticks(t))
                self.relay.heard(self._ticks(t))
                answer = self._rotor.answer(self._ticks(t))
                flagged = answer._replace(flags=answer.flags | self.relay.flags)
                said += encoded(Frame(frames.ANSWER, frame.sequence, flagged.packed()))
            elif frame.type == frames.ARM:
                if frame.payload == frames.WORD:
                    self.relay.arm(self._ticks(t))
            elif frame.type == frames.STOP:
                self.relay.stop()
            else:
                said += self._hello(frame.sequence)
        return said

    def _ticks(self, t: float) -> int:
        return math.floor((t - self._since) * (1.0 / TICK)) & 0xFFFFFFFF

    @staticmethod
    def _hello(sequence: int) -> bytes:
        tick = round(TICK * 1e6)
        return encoded(Frame(frames.HELLO, sequence, Hello(frames.VERSION, tick, REJECT, STALL).packed()))
