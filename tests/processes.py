"""Start a command in a process group of its own, signal it at work, and list the processes of the group that survive."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

VPP = (sys.executable, "-c", "import sys; from vpp_fmu.app.cli import main; sys.exit(main())")
"""The command `vpp` of this checkout, whichever is installed."""

PATIENCE = 60.0
"""Longest wait [s] on a busy machine."""


@dataclass(frozen=True)
class Ended:
    """`code`: exit code (negative: killed by a signal); `error`: standard error; `left`: processes of the group that are still
    there after PATIENCE."""

    code: int
    error: str
    left: tuple[int, ...]


def signalled(words: Sequence[str], number: int, ready, to_all: bool = False, **environment: str) -> Ended:
    """Start `words`, send `number` (to the whole group, as a terminal does: `to_all`) as soon as `ready(process)`."""
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    process = subprocess.Popen(words, **pipes, text=True, start_new_session=True, env=os.environ | environment)
    try:
        _until(lambda: ready(process) or process.poll() is not None, process)
        (os.killpg if to_all else os.kill)(process.pid, number)
        _, error = process.communicate(timeout=PATIENCE)
        _until(lambda: not group(process.pid), process)
        return Ended(process.returncode, error, group(process.pid))
    finally:
        for pid in group(process.pid):
            os.kill(pid, signal.SIGKILL)


def group(leader: int) -> tuple[int, ...]:
    """Living processes of the group."""
    found = []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{pid}/stat", encoding="utf-8", errors="replace") as file:
                state, _, its_group = file.read().rpartition(")")[2].split()[:3]
        except OSError:
            continue
        if int(its_group) == leader and state != "Z":
            found.append(int(pid))
    return tuple(found)


def cpu_seconds(pid: int) -> float:
    """CPU time of a process without its children; 0 if it has ended."""
    try:
        with open(f"/proc/{pid}/stat", encoding="utf-8", errors="replace") as file:
            return sum(map(int, file.read().rpartition(")")[2].split()[11:13])) / os.sysconf("SC_CLK_TCK")
    except (FileNotFoundError, ProcessLookupError):
        return 0.0


def _until(condition, process) -> None:
    end = time.monotonic() + PATIENCE
    while not condition() and time.monotonic() < end:
        try:
            process.wait(timeout=0.05)
        except subprocess.TimeoutExpired:
            continue
        os.sched_yield()  # it has ended; the rest of its group has not
