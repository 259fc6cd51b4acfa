"""Ctrl-C, SIGTERM and a closed terminal end a verb in order: what it holds is let go, then one line and the signal's exit code.

The handler raises in the main thread, so that every `with` and `finally` on the way out does its part. An FMU's own Python
would take that for an error of its model: within its calls the signal is kept, and acts after them (`foreign`, `act`). Code
that never comes back to the interpreter (an FMU that hangs) would swallow the signal so: a second thread hears it too and,
GRACE later, ends the process itself.
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
"""s from a signal to the end, at most: longer than a fit that runs in another thread, shorter than the 10 s after which
service managers and containers kill."""

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Those of them that the system has."""


class Stopped(KeyboardInterrupt):
    """A signal has asked for the end. `number`: which; `code`: what the process then exits with."""

    def __init__(self, number: int):
        self.number, self.code = number, 128 + number
        super().__init__(signal.Signals(number).name)


def said(verb: str, why: Stopped) -> str:
    """The one line."""
    return f"{verb}: stopped by {why}; files that were not complete are not kept"


F = TypeVar("F", bound=Callable)

_foreign: set[CodeType] = set()
_kept: list[int] = []


def foreign(function: F) -> F:
    """Mark a function that calls somebody else's code: a signal that comes while that runs is kept until `act`."""
    _foreign.add(function.__code__)
    return function


def act() -> None:
    """Raise Stopped for a signal that was kept."""
    if _kept:
        raise Stopped(_kept.pop())


def _in_foreign(frame: FrameType | None) -> bool:
    while frame:
        frame = frame.f_back  # the function itself may be left at any point, what it has called may not
        if frame and frame.f_code in _foreign:
            return True
    return False


@contextlib.contextmanager
def stoppable(verb: str) -> Iterator[None]:
    """Within: a first signal raises Stopped, further ones do nothing. A signal that is ignored already (nohup) stays ignored.

    In another than the main thread, which no signal reaches, this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number, frame):
        for each in before:
            signal.signal(each, signal.SIG_IGN)  # letting go is not to be torn
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
    """Within, for a few milliseconds: a signal is kept until the end, and acts then."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came = []
    before = {n: signal.getsignal(n) for n in SIGNALS if signal.getsignal(n) is not None}  # None: not of Python's making
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
    """A thread that ends the process where the main thread does not within GRACE of a signal."""
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
