"""The supervisor's own process: the idle pulse on every output as soon as the loop is gone or silent.

Run as a script, with nothing but the standard library and no package around it, so that it starts at once and nothing of the
loop's process is alive in it. Arguments: descriptor of the shared page, file of the report, silence allowed [s], grace [s], the
kernel's workers that the loop has hurried (their processes and name, with commas), and for each output its duty file and idle
pulse [ns]. Standard input is the pipe from the loop: its end means the loop is gone, a
byte that it says goodbye. A loop that was stopped for its silence and does not come back within the grace is killed: it hangs
in code that hears no signal, and whoever waits for it would wait for ever.
"""

import contextlib
import ctypes
import mmap
import os
import select
import signal
import sys
import time

SLOTS = READY, ALIVE, BEAT, TRIPPED, CONFIRMED, FIFO = range(6)
"""Float64 numbers of the shared page. Times [s] on the monotonic clock, 0: not yet. READY, ALIVE, TRIPPED, FIFO (1: granted)
are the watchdog's, BEAT and CONFIRMED (a beat of a loop that knows) the loop's. Each is aligned: read and written whole."""

PRIORITY = 90  # above the loop's
WAKE = 0.02
"""s; at least as often the watchdog shows that it lives."""
HURRY = 0.001
"""s between two idle pulses until the loop confirms: a loop that was stopped between its last look at the page and the write
of a pulse does that write when it goes on. This is how long such a pulse can stand."""
CALM = 0.01
"""s between two idle pulses after that, and how long after the loop's end they go on."""
AFTER_END = 0.25


def main(page: int, report: int, silence: float, grace: float, lifted: list[str], outputs: list[tuple[int, bytes]]) -> int:
    """Watch until goodbye (returns 0) or until the loop is gone (returns 1)."""
    loop, ended = os.getppid(), False
    _not_for_the_oom_killer()
    numbers = memoryview(mmap.mmap(page, 8 * len(SLOTS))).cast("d")
    numbers[FIFO] = _real_time()
    for failed in write_idle(outputs):
        print(failed, file=sys.stderr, flush=True)
        return 2
    numbers[ALIVE] = numbers[READY] = time.monotonic()
    while True:
        now = time.monotonic()
        numbers[ALIVE] = now
        tripped, last = numbers[TRIPPED], numbers[BEAT]
        pause = HURRY if tripped and not numbers[CONFIRMED] else CALM if tripped else WAKE
        if last and not tripped:
            if now - last > silence:
                _trip(numbers, outputs, report, f"silent for {1e3 * (now - last):.1f} ms")
                continue
            pause = min(pause, last + silence - now)
        if select.select([0], [], [], pause + 1e-4)[0]:
            if os.read(0, 1):
                write_idle(outputs)
                return 0
            if not tripped:
                after = f"{1e3 * (time.monotonic() - last):.1f} ms after its last beat" if last else "before its first beat"
                _trip(numbers, outputs, report, f"gone, {after}")
            _keep_idle(outputs)
            put_back([int(worker) for worker in lifted[:-1]], lifted[-1])
            return 1
        if tripped:
            write_idle(outputs)
            if not ended and now - max(tripped, last) > grace and os.getppid() == loop:
                ended = True
                _tell(report, f"the loop did not come back within {grace:g} s; process {loop} is killed")
                os.kill(loop, signal.SIGKILL)


def _trip(numbers: memoryview, outputs: list[tuple[int, bytes]], report: int, why: str) -> None:
    # The page first: a loop that comes back to life between the two must see it before it writes a pulse.
    numbers[TRIPPED] = time.monotonic()
    failed = write_idle(outputs)
    written = time.monotonic()
    for descriptor, _ in outputs:
        with contextlib.suppress(OSError):  # sysfs has nothing to sync
            os.fsync(descriptor)
    _tell(report, f"the loop is {why}; " + ("; ".join(failed) or "idle pulse written"), written)


def _tell(report: int, what: str, at: float | None = None) -> None:
    with contextlib.suppress(OSError):  # the disk may be full
        os.write(report, f"{time.monotonic() if at is None else at:.6f} s: {what}\n".encode())


def write_idle(outputs: list[tuple[int, bytes]]) -> list[str]:
    """The idle pulse on every output; what failed. One that refuses must not keep the others waiting."""
    failed = []
    for descriptor, pulse in outputs:
        try:
            os.pwrite(descriptor, pulse, 0)
        except OSError as error:
            failed.append(f"idle pulse {pulse.decode().strip()} ns refused: {error.strerror}")
    return failed


def _keep_idle(outputs: list[tuple[int, bytes]]) -> None:
    """A child of the loop may live a little longer than the loop."""
    end = time.monotonic() + AFTER_END
    while time.monotonic() < end:
        time.sleep(CALM)
        write_idle(outputs)


def put_back(workers: list[int], name: str) -> None:
    """The kernel's workers of this name at their ordinary priority again; the number of one that has ended may be another's."""
    for worker in workers:
        with contextlib.suppress(OSError), open(f"/proc/{worker}/comm") as file:
            if file.read().startswith(name):
                os.sched_setscheduler(worker, os.SCHED_OTHER, os.sched_param(0))


def _not_for_the_oom_killer() -> None:
    """Memory that runs short must take any other process first; needs CAP_SYS_RESOURCE, as the unit in hil/systemd gives it."""
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w") as file:
        file.write("-1000")


def _real_time() -> bool:
    """Whether SCHED_FIFO was granted; memory is locked where that is allowed."""
    ctypes.CDLL(None).mlockall(1)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except PermissionError:
        return False
    return True


if __name__ == "__main__":
    # The terminal, the shell and whoever else ends programs mean the loop; the watchdog goes when that is idle.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP):
        signal.signal(number, signal.SIG_IGN)
    shared, file, allowed, patience, hurried, *rest = sys.argv[1:]
    try:
        log = os.open(file, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        opened = [(os.open(duty, os.O_WRONLY), b"%d\n" % int(idle)) for duty, idle in zip(rest[::2], rest[1::2], strict=True)]
    except OSError as error:
        sys.exit(f"{error.filename}: {error.strerror}")
    sys.exit(main(int(shared), log, float(allowed), float(patience), hurried.split(","), opened))
