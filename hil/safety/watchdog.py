"""The supervisor's process: it writes the idle pulse to every output as soon as the loop is gone or silent.

It runs as a script with the standard library only and outside of any package, so that it starts at once and shares no state
with the loop's process. Arguments: descriptor of the shared page, report file, allowed silence [s], grace [s], the kernel's
workers whose priority the loop raised (process numbers and name, with commas), and for each output its duty file and idle pulse
[ns]. Standard input is a pipe from the loop: its end means that the loop is gone, a byte means goodbye. A silent loop that does
not come back within the grace is killed: it hangs in code that ignores signals, and its caller would wait for ever.
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
"""Float64 numbers of the shared page: times [s] on the monotonic clock, 0: not yet. The watchdog writes READY, ALIVE, TRIPPED
and FIFO (1: granted), the loop BEAT and CONFIRMED (a beat that has seen TRIPPED). Each is aligned, so it is read and written
whole."""

PRIORITY = 90  # above the loop's
WAKE = 0.02
"""Longest time between two signs of life of the watchdog, s."""
HURRY = 0.001
"""Interval of idle pulses until the loop confirms, s. A loop that was suspended between its last check of the page and the
write of a pulse still writes it when it resumes; such a pulse lasts for this time at most."""
CALM = 0.01
"""Interval of idle pulses after that, and how long they continue after the loop's end, s."""
AFTER_END = 0.25


def main(page: int, report: int, silence: float, grace: float, lifted: list[str], outputs: list[tuple[int, bytes]]) -> int:
    """Watch until goodbye (returns 0) or until the loop is gone (returns 1); 2: an output refused the first idle pulse."""
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
    # First TRIPPED, then the pulses: a loop that resumes between the two must see it before it writes a pulse.
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
    """Write the idle pulse to every output, also if one refuses it; returns the failures in words."""
    failed = []
    for descriptor, pulse in outputs:
        try:
            os.pwrite(descriptor, pulse, 0)
        except OSError as error:
            failed.append(f"idle pulse {pulse.decode().strip()} ns refused: {error.strerror}")
    return failed


def _keep_idle(outputs: list[tuple[int, bytes]]) -> None:
    """Repeat the idle pulse for AFTER_END s, since a child of the loop may live a little longer than the loop."""
    end = time.monotonic() + AFTER_END
    while time.monotonic() < end:
        time.sleep(CALM)
        write_idle(outputs)


def put_back(workers: list[int], name: str) -> None:
    """Restore the ordinary priority of the kernel's workers; the name is checked, since process numbers are reused."""
    for worker in workers:
        with contextlib.suppress(OSError), open(f"/proc/{worker}/comm") as file:
            if file.read().startswith(name):
                os.sched_setscheduler(worker, os.SCHED_OTHER, os.sched_param(0))


def _not_for_the_oom_killer() -> None:
    """If memory runs short, the kernel must end other processes first; needs CAP_SYS_RESOURCE, as in hil/systemd."""
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w") as file:
        file.write("-1000")


def _real_time() -> bool:
    """Whether SCHED_FIFO was granted; memory is locked if that is allowed."""
    ctypes.CDLL(None).mlockall(1)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except PermissionError:
        return False
    return True


if __name__ == "__main__":
    # Signals of the terminal or the shell are meant for the loop; the watchdog ends after the loop is idle.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP):
        signal.signal(number, signal.SIG_IGN)
    shared, file, allowed, patience, hurried, *rest = sys.argv[1:]
    try:
        log = os.open(file, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        opened = [(os.open(duty, os.O_WRONLY), b"%d\n" % int(idle)) for duty, idle in zip(rest[::2], rest[1::2], strict=True)]
    except OSError as error:
        sys.exit(f"{error.filename}: {error.strerror}")
    sys.exit(main(int(shared), log, float(allowed), float(patience), hurried.split(","), opened))
