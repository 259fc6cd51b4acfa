"""Ctrl-C, SIGTERM and a closed terminal end a verb cleanly: resources are released, one line is printed, and the exit code is
the signal's.

The handler raises in the main thread, so that every `with` and `finally` runs. An FMU's own Python would take the exception
for an error of its model, so within its calls the signal is deferred until they return (`foreign`, `act`). Code that never
returns (an FMU that hangs) would suppress the signal. So a second thread receives it too, and ends the process GRACE later.
"""

import contextlib
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from types import CodeType, FrameType
from typing import TypeVar

from vpp_fmu.scratch import remove_scratch

GRACE = 5.0
"""Maximum time from a signal to the end, s: longer than a fit in another thread, shorter than the 10 s after which service
managers and containers kill."""

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""The handled signals that the system has."""


class Stopped(KeyboardInterrupt):
    """A signal ended the verb. `number`: of the signal; `code`: the exit code of the process."""

    def __init__(self, number: int):
        self.number, self.code = number, 128 + number
        super().__init__(signal.Signals(number).name)


def said(verb: str, why: Stopped) -> str:
    """The message, one line."""
    return f"{verb}: stopped by {why}; files that were not complete are not kept"


F = TypeVar("F", bound=Callable)

_foreign: set[CodeType] = set()
_kept: list[int] = []


def foreign(function: F) -> F:
    """Mark a function that calls foreign code: a signal during the call is deferred until `act`."""
    _foreign.add(function.__code__)
    return function


def act() -> None:
    """Raise Stopped for a deferred signal."""
    if _kept:
        raise Stopped(_kept.pop())


def _in_foreign(frame: FrameType | None) -> bool:
    while frame:
        frame = frame.f_back  # the function itself may be interrupted, the foreign code may not
        if frame and frame.f_code in _foreign:
            return True
    return False


@contextlib.contextmanager
def stoppable(verb: str) -> Iterator[None]:
    """Within this context a first signal raises Stopped, further ones do nothing. An ignored signal (nohup) stays ignored.

    Outside of the main thread, which alone receives signals, it does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number, frame):
        for each in before:
            signal.signal(each, signal.SIG_IGN)  # the release of resources must not be interrupted
        if _in_foreign(frame):
            _kept.append(number)
        else:
            raise Stopped(number)

    before = {n: signal.getsignal(n) for n in SIGNALS if signal.getsignal(n) in (signal.SIG_DFL, signal.default_int_handler)}
    with _watched(verb, before, stop):
        for each in before:
            signal.signal(each, stop)
        try:
            yield
            act()
        finally:
            _kept.clear()
            for each, handler in before.items():
                signal.signal(each, handler)


@contextlib.contextmanager
def unbroken() -> Iterator[None]:
    """Within this context, of a few milliseconds, a signal is deferred until its end."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came = []
    before = {
        n: signal.getsignal(n) for n in SIGNALS if signal.getsignal(n) is not None
    }  # None: a handler that Python did not install
    for number in before:
        signal.signal(number, lambda number, _frame: came.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])


@contextlib.contextmanager
def _watched(verb: str, numbers, stop) -> Iterator[None]:
    """A thread that ends the process if the main thread does not within GRACE of a signal."""
    ended, (heard, tell) = threading.Event(), socket.socketpair()  # not a pipe: Windows wants a socket

    def watch():
        while byte := heard.recv(1):
            ours = byte[0] in numbers and signal.getsignal(byte[0]) in (stop, signal.SIG_IGN)  # a rig in use has its own
            if ours and not ended.wait(GRACE):
                remove_scratch()
                why = Stopped(byte[0])
                print(said(verb, why), file=sys.stderr, flush=True)
                os._exit(why.code)

    tell.setblocking(False)
    earlier = signal.set_wakeup_fd(tell.fileno(), warn_on_full_buffer=False)
    thread = threading.Thread(target=watch, name="stopping", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        signal.set_wakeup_fd(earlier)
        tell.close()
        thread.join()
        heard.close()
