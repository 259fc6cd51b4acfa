"""When this machine stood still: the part of time in which none of its programs ran, whatever their priority.

A virtual machine's host may take a core away for tens of milliseconds (`steal` in /proc/stat). A rig in real time can't tell
that from a board that is silent or a supervisor that is gone, and takes its rotor down as it should: a test of anything else
says nothing then, whatever it says, and is skipped where it fails.

Run as a script, with the descriptor of a file to write to: one thread a core, above every loop in real time, writes down when
it was woken late.
"""

import contextlib
import os
import subprocess
import sys
import tempfile
import threading
import time

PERIOD = 0.004
"""s between two looks: the loop's."""

LONG = 0.01
"""s: a fifth of the patience that loop, board and supervisor have with each other (0.05 s): each of them may be met by one."""


MISSED = 0.1
"""s within one: the share of a second's ticks that a loop may miss, which many short ones take, too."""


def watch(core: int, out: int) -> None:
    """Write a line `start end` [s, monotonic] for each time a core stood still, without end."""
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
    """The watch while tests run, on every core that this process may use."""

    def __init__(self):
        self._file = tempfile.TemporaryFile(mode="ab+", buffering=0)  # noqa: SIM115 (open as long as the watch)
        shared = self._file.fileno()
        words = [sys.executable, "-I", "-S", __file__, str(shared)]
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, pass_fds=(shared,))
        self._process.wait()  # it leaves the watch to its child: to the tests, no process of theirs is alive

    def longest(self, since: float) -> float:
        """s, 0 without any: the longest time that a core stood still since a time on the monotonic clock, at once or, where
        that is MISSED or more, in short ones within a second."""
        self._file.seek(0)
        spans = [tuple(map(float, line.split())) for line in self._file.read().splitlines()]
        late = [(start, end - start) for start, end in spans if end > since]
        alone = max((length for _, length in late if length - PERIOD > LONG), default=0.0)
        together = max((sum(own for at, own in late if 0.0 <= at - start < 1.0) for start, _ in late), default=0.0)
        return max(alone, together) if together >= MISSED else alone

    def close(self) -> None:
        """No more watch."""
        self._process.stdin.close()
        self._file.close()


if __name__ == "__main__":
    if os.fork():
        os._exit(0)
    for own in os.sched_getaffinity(0):
        threading.Thread(target=watch, args=(own, int(sys.argv[1])), daemon=True).start()
    sys.stdin.read()  # until whoever asked is gone
