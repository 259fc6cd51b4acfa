"""Detect stalls of this machine: times in which no program ran on a core, whatever its priority.

The host of a virtual machine may take a core away for tens of milliseconds (`steal` in /proc/stat). A rig in real time can't
distinguish that from a silent board or a lost supervisor, and shuts its rotor down as it should. The result of any other test
is then meaningless, so a failure counts as skipped.

Run as a script, with the descriptor of a file to write to: one thread a core, with a priority above every loop in real time,
logs when it was woken late.
"""

import contextlib
import os
import subprocess
import sys
import tempfile
import threading
import time

PERIOD = 0.004
"""s between two wake-ups: the period of the control loop."""

LONG = 0.01
"""s: a fifth of the time-out that loop, board and supervisor have for each other (0.05 s). One stall may hit each of them."""

MISSED = 0.1
"""s within a second: the share of ticks that a loop may miss, which many short stalls reach, too."""


def watch(core: int, out: int) -> None:
    """Write a line `start end` [s, monotonic] for each stall of a core, without end."""
    with contextlib.suppress(OSError):
        os.sched_setaffinity(0, {core})
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(95))
    due = time.monotonic()
    while True:
        time.sleep(PERIOD)
        now = time.monotonic()
        if now - due > 2.0 * PERIOD:  # it missed a tick
            os.write(out, f"{due} {now}\n".encode())
        due = now


class Stalls:
    """The watch during the tests, on every core that this process may use."""

    def __init__(self):
        self._file = tempfile.TemporaryFile(mode="ab+", buffering=0)  # noqa: SIM115 (open as long as the watch)
        shared = self._file.fileno()
        words = [sys.executable, "-I", "-S", __file__, str(shared)]
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, pass_fds=(shared,))
        self._process.wait()  # it leaves the watch to its child: to the tests, no process of theirs is alive

    def longest(self, since: float) -> float:
        """Longest stall [s] of a core since a time on the monotonic clock, 0 without any: a single one or, if they reach
        MISSED, the sum of short ones within a second."""
        self._file.seek(0)
        spans = [tuple(map(float, line.split())) for line in self._file.read().splitlines()]
        late = [(start, end - start) for start, end in spans if end > since]
        alone = max((length for _, length in late if length - PERIOD > LONG), default=0.0)
        together = max((sum(own for at, own in late if 0.0 <= at - start < 1.0) for start, _ in late), default=0.0)
        return max(alone, together) if together >= MISSED else alone

    def close(self) -> None:
        """End the watch."""
        self._process.stdin.close()
        self._file.close()


if __name__ == "__main__":
    if os.fork():
        os._exit(0)
    for own in os.sched_getaffinity(0):
        threading.Thread(target=watch, args=(own, int(sys.argv[1])), daemon=True).start()
    sys.stdin.read()  # until whoever asked is gone
