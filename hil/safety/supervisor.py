"""The loop's side of the supervisor: start its process, show it life, hear whether it has stopped the rotor.

PWM outlives the process that set it: after a crash the last pulse stays on the pin. So a second process holds the duty files
open and writes the idle pulse when the loop is gone or silent; see `hil/watchdog.py`.
"""

import mmap
import os
import subprocess
import sys
import time
from collections.abc import Sequence

from hil.realtime import WORKERS
from hil.safety import watchdog
from hil.safety.faults import DeviceFault, Fault, FaultKind

SILENCE = 0.05
"""s without a heartbeat after which the rotor is stopped: twelve ticks."""

GRACE = 3.0
"""s that a loop which was stopped for its silence has to come back, before it is killed."""

LOST = 0.1
"""s without a sign of the watchdog after which the loop gives up: five times its pace, so that a busy machine is no fault."""

STARTED = 5.0
"""s; a process that hasn't started by then won't."""


class Supervisor:
    """A process of its own that watches this one.

    Outputs are (duty file, idle pulse [s]); the PWM must be set up already, since the idle pulse is written at the start to
    show that it can be. `report` is a file that the process adds a line to if it has to act. From the first `beat` on,
    `silence` s without one trips it, and `grace` s more end this process. `keep`: descriptors that it holds open with this
    process, such as the rig's lock. `lifted`: the kernel's workers that `hil.realtime` has hurried for this process, to be put
    back behind it. `fifo`: whether it runs in real time. DeviceFault NOT_READY: it could not start, or an output refused the
    idle pulse.
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
            start_new_session=True,  # what the terminal sends to its foreground is not for it
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
        """The process."""
        return self._process.pid

    def beat(self) -> Fault | None:
        """Once a tick, right before its pulses: the loop lives. Only without a fault may they be other than idle.

        SUPERVISOR_TRIPPED: the outputs were taken to idle, for good. SUPERVISOR_LOST: nobody listens.
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
        """Goodbye: the loop has written the idle pulse on every output. The supervisor writes it once more, and ends."""
        try:
            self._process.communicate(b"q", timeout=1.0)
        except subprocess.TimeoutExpired:  # stopped: it can't harm, but it mustn't stay
            self._process.kill()
            self._process.communicate()
        self._page.release()
        self._memory.close()
