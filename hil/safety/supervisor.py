"""The loop's side of the supervisor: start its process, send heartbeats, learn whether it has stopped the rotor.

PWM outlives the process that set it: after a crash the last pulse stays on the pin. So a second process holds the duty files
open and writes the idle pulse when the loop is gone or silent; see `hil/safety/watchdog.py`.
"""

import mmap
import os
import subprocess
import sys
import time
from collections.abc import Sequence

from hil.loop.realtime import WORKERS
from hil.safety import watchdog
from hil.safety.faults import DeviceFault, Fault, FaultKind

SILENCE = 0.05
"""Time without a heartbeat, s, after which the rotor is stopped: twelve ticks."""

GRACE = 3.0
"""Time, s, from the stop of the rotor until a loop that stays silent is killed."""

LOST = 0.1
"""Time without a sign of the watchdog, s, that is a fault: five of its periods, so that a busy machine is none."""

STARTED = 5.0
"""Timeout of the process's start, s."""


class Supervisor:
    """A separate process that monitors this one.

    `outputs`: (duty file, idle pulse [s]); the PWM must be set up already, since the supervisor first writes the idle pulse as
    a test. `report`: a file to which it adds a line if it acts. From the first `beat` on, it stops the rotor after `silence` s
    without one, and kills this process after `grace` s more. `keep`: descriptors that it also holds open, such as the rig's
    lock. `lifted`: the kernel's workers whose priority `realtime` raised; it restores them if this process dies. `fifo`:
    whether it runs in real time. DeviceFault NOT_READY: it could not start, or an output refused the idle pulse.
    """

    def __init__(
        self,
        outputs: Sequence[tuple[str | os.PathLike, float]],
        report: str | os.PathLike,
        silence: float = SILENCE,
        grace: float = GRACE,
        keep: Sequence[int] = (),
        lifted: Sequence[int] = (),
    ):
        size = 8 * len(watchdog.SLOTS)
        shared = os.memfd_create("hil-supervisor")
        os.ftruncate(shared, size)
        self._memory = mmap.mmap(shared, size)
        self._page = memoryview(self._memory).cast("d")
        files = [word for path, idle in outputs for word in (os.fspath(path), str(round(idle * 1e9)))]
        hurried = ",".join([*map(str, lifted), WORKERS])
        task = [str(shared), os.fspath(report), str(silence), str(grace), hurried, *files]
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", watchdog.__file__, *task],
            pass_fds=(shared, *keep),
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,  # so that the terminal's signals do not reach it
        )
        os.close(shared)
        self._wait_until_ready()
        self.fifo = bool(self._page[watchdog.FIFO])

    def _wait_until_ready(self) -> None:
        end = time.monotonic() + STARTED
        while not self._page[watchdog.READY]:
            if self._process.poll() is not None or time.monotonic() > end:
                self._process.kill()
                _, output = self._process.communicate()
                detail = " ".join(output.decode(errors="replace").split()) or "found no start, expected one"
                raise DeviceFault("supervisor", FaultKind.NOT_READY, detail)
            time.sleep(0.002)

    @property
    def pid(self) -> int:
        return self._process.pid

    def beat(self) -> Fault | None:
        """Send a heartbeat, once a tick right before its pulses. If it returns a fault these must be idle pulses.

        SUPERVISOR_TRIPPED: the supervisor has set the outputs to idle, for good. SUPERVISOR_LOST: it shows no sign of life.
        """
        now = time.monotonic()
        self._page[watchdog.BEAT] = now
        if self._page[watchdog.TRIPPED]:
            self._page[watchdog.CONFIRMED] = now
            return Fault("supervisor", FaultKind.SUPERVISOR_TRIPPED, "found a silent loop; the outputs are at idle")
        silent = now - self._page[watchdog.ALIVE]
        if silent > LOST:
            found = f"found no sign of process {self.pid} for {1e3 * silent:.0f} ms, expected one within {1e3 * LOST:.0f} ms"
            return Fault("supervisor", FaultKind.SUPERVISOR_LOST, found)
        return None

    def close(self) -> None:
        """Say goodbye, after the idle pulse is on every output. The supervisor writes it once more, and ends."""
        try:
            self._process.communicate(b"q", timeout=1.0)
        except subprocess.TimeoutExpired:  # a stopped process does no harm, but must not remain
            self._process.kill()
            self._process.communicate()
        self._page.release()
        self._memory.close()
