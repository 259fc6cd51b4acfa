"""The serial line to the tachometer's board, emulated: a pty that pyserial opens, or, under a virtual clock, a port in memory.

The pty is for real time only: its delays depend on the machine, so no run over it is the same twice.
"""

import contextlib
import errno
import fcntl
import os
import random
import select
import sys
import termios
import tty
from pathlib import Path

from hil.devices.clock import Clock
from hil.emulator.shared import SharedNumbers, refusal
from hil.emulator.uno import Uno

FAULTS = ("silent", "flipped", "garbage", "resets", "unplugged", "marks_lost", "marks_halved", "marks_doubled")
"""Faults that any process may set: numbers of answers to come that are lost, have one to three bits flipped, or are replaced by
random bytes (math.inf: all); number of resets of the board to come; 1: the plug is out; 1: the sensor sees no mark, every
second one, or one more between two."""

LOOK_EVERY = 0.1
"""Time between two checks for a hang-up of the host, while it sends no request, s."""

REQUEST_DELAY, ANSWER_DELAY = 0.0005, 0.001
"""Delays from the host's write to the board, and back: the bytes at 500 kBd and the USB's frames [s]."""


class SerialLine:
    """The board's end. Subclasses carry the bytes: `_hear(t)` returns (time, bytes) pairs of the host, `_say` sends to it."""

    def __init__(self, board: Uno, faults: str | os.PathLike, seed: int = 0):
        self.faults = SharedNumbers(faults, FAULTS, create=True)
        self._board, self._random = board, random.Random(seed)
        self._under_way: list[tuple[float, bytes]] = []

    def serve(self, t: float) -> None:
        """Emulate line and board up to time t [s]."""
        faults, board = self.faults, self._board
        if faults["unplugged"]:
            self._unplug()
            return
        if faults.take("resets"):
            board.reset(t)
        heard = self._hear(t)
        for when, data in heard:
            board.look(when, faults)
            self._send(board.heard(data, when), when)
        self._send(board.greeting(t), t)
        board.look(t, faults)
        while self._under_way and self._under_way[0][0] <= t:
            self._say(self._under_way.pop(0)[1])

    def _send(self, data: bytes, when: float) -> None:
        if not data or self.faults.take("silent"):
            return
        if self.faults.take("flipped"):
            data = self._flipped(data)
        elif self.faults.take("garbage"):
            data = self._random.randbytes(self._random.randint(1, 2 * len(data)))
        self._under_way.append((when + ANSWER_DELAY, data))

    def _flipped(self, data: bytes) -> bytes:
        number = int.from_bytes(data, "big")
        for bit in self._random.sample(range(8 * len(data)), self._random.randint(1, 3)):
            number ^= 1 << bit
        return number.to_bytes(len(data), "big")

    def _hear(self, t: float) -> list[tuple[float, bytes]]:
        raise NotImplementedError

    def _say(self, data: bytes) -> None:
        raise NotImplementedError

    def _unplug(self) -> None:
        raise NotImplementedError

    def close(self) -> None:
        self.faults.close()


class PtyLine(SerialLine):
    """A line in real time: `path` becomes a link to a terminal that a `serial.Serial` opens. Opening it resets the board."""

    def __init__(self, board: Uno, faults: str | os.PathLike, path: str | os.PathLike, seed: int = 0):
        super().__init__(board, faults, seed)
        self._path, (self._file, terminal) = Path(path), os.openpty()
        tty.setraw(terminal)
        os.set_blocking(self._file, False)
        self._path.unlink(missing_ok=True)
        self._path.symlink_to(os.ttyname(terminal))
        os.close(terminal)  # from now on a hang-up means that nobody has the port open
        self._poll, self._open, self._look_again = select.poll(), False, 0.0
        self._poll.register(self._file, select.POLLIN)

    def fileno(self) -> int:
        """For select: readable when the host has said something, or hung up."""
        return self._file

    def _hear(self, t):
        if self._file is None:
            return []
        waiting = int.from_bytes(fcntl.ioctl(self._file, termios.FIONREAD, bytes(4)), sys.byteorder)
        if not waiting and self._open and t < self._look_again:
            return []
        # While bytes are under way, a poll waits for the kernel's worker: tens of milliseconds on a busy machine. Right after
        # a request none are.
        data = [(t, os.read(self._file, waiting))] if waiting else []
        events, self._look_again = dict(self._poll.poll(0)).get(self._file, 0), t + LOOK_EVERY
        opened, self._open = not self._open, not events & select.POLLHUP
        if not self._open:
            self._under_way.clear()
            return []
        if opened:
            self._board.reset(t)
        return data

    def _say(self, data):
        with contextlib.suppress(BlockingIOError):  # nobody reads and the buffer is full: lost, as on a wire
            try:
                os.write(self._file, data)
            except OSError as error:
                if error.errno != errno.EIO:  # the host has just hung up
                    raise

    def _unplug(self):
        if self._file is not None:
            self._poll.unregister(self._file)
            os.close(self._file)
            self._file = None
            self._path.unlink(missing_ok=True)

    def close(self):
        self._unplug()
        super().close()


class MemoryLine(SerialLine):
    """A line under a virtual clock. `open_port` is the `port` argument of a Tachometer; the line itself is the open port."""

    def __init__(self, board: Uno, faults: str | os.PathLike, clock: Clock, seed: int = 0):
        super().__init__(board, faults, seed)
        self._clock, self._written, self._arrived = clock, [], bytearray()

    def open_port(self) -> "MemoryLine":
        """Open the port, which resets the board."""
        self._plugged()
        self._board.reset(self._clock.now())
        return self

    @property
    def in_waiting(self) -> int:
        self._plugged()
        return len(self._arrived)

    def read(self, size: int) -> bytes:
        self._plugged()
        data = bytes(self._arrived[:size])
        del self._arrived[:size]
        return data

    def write(self, data: bytes) -> int:
        """Send at this moment of the clock."""
        self._plugged()
        self._written.append((self._clock.now() + REQUEST_DELAY, data))
        return len(data)

    def reset_input_buffer(self) -> None:
        self._arrived.clear()

    def _plugged(self) -> None:
        if self.faults["unplugged"]:
            raise refusal(errno.EIO)

    def _hear(self, t):
        heard = [entry for entry in self._written if entry[0] <= t]
        self._written = self._written[len(heard) :]
        return heard

    def _say(self, data):
        self._arrived += data

    def _unplug(self):
        self._written.clear()
        self._arrived.clear()
