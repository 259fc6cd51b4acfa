"""The clock of the rig's code: the machine's, or a virtual one that moves only in `wait_until`."""

import ctypes
import errno
import os
import time
from collections.abc import Callable
from typing import Protocol

_TIMER_ABSTIME = 1


class Clock(Protocol):
    """Seconds on a scale that only goes forward, with an arbitrary zero."""

    def now(self) -> float:
        """The time [s]."""

    def wait_until(self, when: float) -> float:
        """Sleep until the time is `when` [s]; returns the delay after that [s], 0 or more. A past time returns at once."""


class MonotonicClock:
    """The machine's monotonic clock; setting the time of day doesn't move it.

    Sleeps to an absolute time (clock_nanosleep, TIMER_ABSTIME): unlike with relative sleeps, the duration of the loop's work
    does not accumulate. Linux only.
    """

    def __init__(self):
        self._sleep = ctypes.CDLL(None, use_errno=True).clock_nanosleep
        self._sleep.argtypes = [ctypes.c_int, ctypes.c_int, ctypes.POINTER(_Timespec), ctypes.POINTER(_Timespec)]
        self._until = _Timespec()
        self._address = ctypes.pointer(self._until)

    def now(self):
        return time.monotonic()

    def wait_until(self, when):
        late = time.monotonic() - when
        if late >= 0.0:
            return late
        self._until.seconds, self._until.nanoseconds = divmod(round(when * 1e9), 1_000_000_000)
        # Python runs signal handlers between two calls; the deadline stays the same.
        while code := self._sleep(time.CLOCK_MONOTONIC, _TIMER_ABSTIME, self._address, None):
            if code != errno.EINTR:
                raise OSError(code, os.strerror(code))
        return max(0.0, time.monotonic() - when)


class _Timespec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class VirtualClock:
    """A clock that moves only in `wait_until`, and then at once; each of `listeners` is called with the new time [s].

    With it a run of many minutes takes as long as its arithmetic, and is the same every time.
    """

    def __init__(self, start: float = 0.0):
        self._now = start
        self.listeners: list[Callable[[float], None]] = []

    def now(self):
        return self._now

    def wait_until(self, when):
        if when <= self._now:
            return self._now - when
        self._now = when
        for follow in self.listeners:
            follow(when)
        return 0.0
