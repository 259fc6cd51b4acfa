"""The loop's side of the operator's page: start its process, send it the measurement's plan, notice its end.

The page reads the log's memory and the events beside the log directly, so a tick does nothing for it. Messages over the socket
are sent between the runs. The page returns a byte for each STOP, and the same signal as Ctrl-C.
"""

import contextlib
import json
import os
import socket
import subprocess
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

from hil.loop.log import ProcessLog, events_of
from vpp_fmu.errors import BadInput, VppError
from vpp_fmu.stopping import Stopped

STOP = b"stop"
STARTED = 20.0
"""Timeout of the page's start, s."""
PATIENCE = 1.0
"""Timeout of a message, s: a page that does not read is closed, and the rig does not wait."""
LOOKS = 64
"""Ticks between two checks that the page's process lives: a quarter of a second."""


class OperatorPage:
    """A page on the loopback address; `address` contains a random token. `told`: content of hil.json at the start.

    `broken`: why the page has ended, empty while it runs. BadInput if the extra is missing or the port is taken. As a context
    it is closed at the end.
    """

    def __init__(self, told: Mapping, port: int = 0):
        if find_spec("tornado") is None:
            raise BadInput("command line", "--watch", "no tornado", "the library, installed", "pip install 'vpp-fmu[watch]'")
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.settimeout(STARTED)
        self._broken, self._looks, self._stops = "", 0, 0
        self._process = subprocess.Popen(
            [sys.executable, "-m", "hil.page.server", str(theirs.fileno()), str(port)],
            pass_fds=(theirs.fileno(),),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is not for it
        )
        theirs.close()
        try:
            said = json.loads(self._socket.recv(4096) or b"{}")
        except TimeoutError:
            said = {}
        self._socket.settimeout(PATIENCE)
        if "address" not in said:
            self._socket.close()
            self._process.kill()
            self._process.wait()
            found = said.get("refused", f"a page that did not start (exit code {self._process.returncode})")
            raise BadInput("command line", "--watch", found, "a port of 127.0.0.1 that is free")
        self.address = said["address"]
        self._tell({"told": dict(told)})

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def broken(self) -> str:
        """Check the process at some of the ticks."""
        self._looks += 1
        if not self._broken and self._looks % LOOKS == 0 and self._process.poll() is not None:
            self._broken = f"its process {self.pid} has died (exit code {self._process.returncode})"
        return self._broken

    @property
    def pressed(self) -> bool:
        """Whether STOP was pressed so far."""
        with contextlib.suppress(OSError):  # on a socket with a timeout os.read does not wait, and recv does
            while os.read(self._socket.fileno(), 64) == STOP:
                self._stops += 1
        return self._stops > 0

    def part(self, name: str, **what) -> None:
        """Announce the next measurement. `grid`: the `speeds` [rpm] and `pitches` [deg] of a static map. `parts`: names of all
        parts, in order; `before`: logs of earlier attempts."""
        before = [str(events_of(Path(log))) for log in what.pop("before", ())]
        self._tell({"part": name, "before": before, **what})

    def follow(self, log: ProcessLog) -> None:
        columns = [column.name for column in log.columns]
        self._tell({"log": {"columns": columns, "slots": log.slots, "events": str(events_of(log.path))}}, log.shared)

    def end(self, how: str) -> None:
        """Announce that the run ended and why, once the rotor is at rest: STOP has no effect from now on."""
        self._looks = LOOKS - 1
        if not self.broken:
            self._tell({"ended": how})

    def close(self, how: str) -> None:
        """Show the end on the page, and end its process."""
        self.end(how)
        self._socket.close()
        try:
            self._process.wait(PATIENCE + 1.0)
        except subprocess.TimeoutExpired:  # a stopped process does no harm, but must not remain
            self._process.kill()
            self._process.wait()

    def __enter__(self):
        return self

    def __exit__(self, kind, error, _trace) -> None:
        """Show how the context ended. A failure of the page is one line on standard error."""
        foreseen = isinstance(error, VppError | Stopped)
        self.close("ended as planned" if error is None else " ".join(str(error).split()) if foreseen else kind.__name__)
        if self.broken:
            print(f"vpp hil: page: {self.broken}; the rig went on without it", file=sys.stderr)

    def _tell(self, message: dict, *descriptors: int) -> None:
        if self._broken:
            return
        try:
            socket.send_fds(self._socket, [json.dumps(message).encode()], descriptors)
        except OSError as error:
            self._broken = f"its process {self.pid} takes nothing ({(error.strerror or str(error)).lower()})"
