"""Real-time conditions of a loop: priority scheduling, locked memory, no garbage collection.

Measured on two cores at 250 Hz with an absolute deadline: the 99th percentile of lateness is 1.1 ms without these conditions
and 0.08 ms with them, also under load. Each needs a permission; without it the loop still runs and reports what is missing.
"""

import contextlib
import ctypes
import gc
import os
import resource
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from hil.safety.watchdog import put_back

PRIORITY = 80
"""Above the kernel's interrupt threads (50), which the loop doesn't wait for; below its migration and watchdog threads (99)."""

WORKERS = "kworker/u"
"""Prefix of the kernel's threads that pass received bytes of a serial line or a pty to its reader (flush_to_ldisc). At their
ordinary priority this took up to 217 ms while a browser started, although both ends of the line ran in real time and no core
stalled."""
LIFTED = 60
"""Their raised priority: below the loop's, which they must not delay, and above all ordinary processes."""

_CURRENT, _FUTURE = 1, 2  # flags of mlockall


@dataclass(frozen=True)
class Granted:
    """The granted conditions, and those refused in words. `lifted`: the kernel's workers whose priority this process has
    raised; another process restores it if this one is killed."""

    fifo: bool
    locked: bool
    hurried: bool
    frozen: int
    refusals: tuple[str, ...]
    lifted: tuple[int, ...] = ()

    def __str__(self) -> str:
        granted = ["SCHED_FIFO"] * self.fifo + ["locked memory"] * self.locked
        granted += ["serial lines hurried"] * self.hurried + [f"{self.frozen} objects frozen"]
        return "; ".join([", ".join(granted), *self.refusals])


@contextlib.contextmanager
def real_time(priority: int = PRIORITY) -> Iterator[Granted]:
    """The calling thread in real time within the context. Threads and processes that it starts are ordinary ones."""
    refusals: list[str] = []
    # Present objects are excluded from later collections, and automatic ones are off: one takes 17 ms with numpy loaded.
    was_on = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        with _fifo(priority, refusals) as fifo, _locked(refusals) as locked, _hurried(refusals) as lifted:
            hurried = lifted is not None
            yield Granted(fifo, locked, hurried, gc.get_freeze_count(), tuple(refusals), tuple(lifted or ()))
    finally:
        gc.unfreeze()
        if was_on:
            gc.enable()


@contextlib.contextmanager
def _fifo(priority: int, refusals: list[str]) -> Iterator[bool]:
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except PermissionError:
        refusals.append("no SCHED_FIFO: other programs may delay the loop (rtprio in limits.conf, see hil/README.md)")
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(0, *before)


@contextlib.contextmanager
def _locked(refusals: list[str]) -> Iterator[bool]:
    libc = ctypes.CDLL(None, use_errno=True)
    # Under a limit, _FUTURE may make a later allocation fail, which would end the loop.
    unlimited = os.geteuid() == 0 or resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    if libc.mlockall(_CURRENT | _FUTURE if unlimited else _CURRENT):
        reason = os.strerror(ctypes.get_errno()).lower()
        refusals.append(f"memory not locked ({reason}): a page may come from disk (memlock in limits.conf, see hil/README.md)")
        yield False
        return
    try:
        yield True
    finally:
        libc.munlockall()


@contextlib.contextmanager
def _hurried(refusals: list[str]) -> Iterator[list[int] | None]:
    """Raise the kernel's ordinary workers to real time. Yields those that were raised, None if that is refused."""
    lifted: list[int] = []
    try:
        for worker in _workers():
            with contextlib.suppress(ProcessLookupError):  # they come and go
                if os.sched_getscheduler(worker) == os.SCHED_OTHER:
                    os.sched_setscheduler(worker, os.SCHED_FIFO, os.sched_param(LIFTED))
                    lifted.append(worker)
    except PermissionError:
        refusals.append("serial lines not hurried: a program that starts may delay them by 0.1 s (see hil/README.md)")
        yield None
        return
    try:
        yield lifted
    finally:
        put_back(lifted, WORKERS)


def _workers() -> list[int]:
    """Processes whose names begin with WORKERS; a container may see none."""
    found = []
    for name in Path("/proc").glob("[0-9]*/comm"):
        with contextlib.suppress(OSError):
            if name.read_text().startswith(WORKERS):
                found.append(int(name.parent.name))
    return found
