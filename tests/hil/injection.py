"""Start the loop under test in a separate process, inject faults from outside and watch the duty file of its ESC."""

import contextlib
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from hil.emulator.faults import Target
from hil.emulator.rig import BYSTANDER, SHOWN
from hil.emulator.shared import SharedNumbers

HERE = Path(__file__).resolve().parent

STUCK_AFTER = 8.0
"""s from the emulation's start until its pitch actuator sticks, if that is the fault."""


@dataclass(frozen=True)
class Injected(Target):
    """The process under test with its messages, and the emulated rig."""

    process: subprocess.Popen | None = None
    idle: bytes = b""
    opened: float = 0.0
    folder: Path = Path()


def fills(rig: Injected) -> None:
    """Another program fills the disk of the log."""
    fill(Path(f"/proc/{rig.pid}/root{rig.folder}"))


def fill(folder: Path) -> None:
    """Write to a file `filler` until the disk is full."""
    with contextlib.suppress(OSError), open(folder / "filler", "ab", buffering=0) as file:
        while True:
            file.write(bytes(4096))


def now(rig: Injected) -> None:
    """Create the file for which the FMU waits."""
    (rig.folder / "now").touch()


def nothing(rig: Injected) -> None:
    """No injection: the fault exists from the start."""


def stuck(rig: Injected) -> float:
    """Wait until the emulated actuator sticks; the time counts from the emulation's start."""
    time.sleep(max(0.0, rig.opened + STUCK_AFTER - time.monotonic()))
    return time.monotonic()


@contextlib.contextmanager
def load(count: int) -> Iterator[None]:
    """`count` busy processes."""
    hogs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait()


@contextlib.contextmanager
def started(task: dict, folder: Path) -> Iterator[tuple[subprocess.Popen, list[dict]]]:
    """The process in its own session, and its messages so far; on a disk of 16 MB if the task says `small`."""
    messages: list[dict] = []
    words = [sys.executable, str(HERE / "rig_process.py"), json.dumps({"seconds": 3, **task, "folder": str(folder)})]
    if task.get("small"):
        words = ["unshare", "-m", "sh", "-c", 'mount -t tmpfs -o size=16m none "$0" && exec "$@"', str(folder), *words]
    environment = {**os.environ, "PYTHONPATH": str(HERE.parents[1])}
    process = subprocess.Popen(words, stdout=subprocess.PIPE, env=environment, start_new_session=True)

    def read():
        for each in process.stdout:
            messages.append({**json.loads(each), "heard": time.monotonic()})

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    try:
        yield process, messages
    finally:
        process.kill()
        process.wait()
        reader.join(5.0)
        process.stdout.close()
        for each in messages[:1]:
            shutil.rmtree(each.get("at", folder), ignore_errors=True)


def wait_for(messages: list[dict], key: str, process: subprocess.Popen, seconds: float = 60.0) -> dict | None:
    """The first message with this key; None if the process ends without it, or after `seconds`."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        for each in list(messages):
            if key in each:
                return each
        if process.poll() is not None and not any(key in each for each in messages):
            time.sleep(0.2)  # the reader may still be at it
            return next((each for each in messages if key in each), None)
        time.sleep(0.005)
    return None


class Watched(NamedTuple):
    """ms from the injection to the first idle pulse, and for how long the throttle was seen open after that [ms]."""

    idle: float
    reopened: float


def until_idle(rig: Injected, inject: Callable[[Injected], float | None]) -> Watched | None:
    """Inject, and watch the ESC until it has idled for 0.8 s without interruption; None if it does not within a minute."""
    file, began, moment = os.open(rig.esc, os.O_RDONLY), time.monotonic(), []
    injector = threading.Thread(target=lambda: moment.append(inject(rig)))
    injector.start()
    first, idle_since, reopened, before = None, None, 0.0, began
    try:
        while idle_since is None or injector.is_alive() or before - idle_since < 0.8:
            now = time.monotonic()
            if os.pread(file, 32, 0).split(b"\n")[0] == rig.idle:
                idle_since, first = idle_since or now, first or now
            else:
                idle_since, reopened = None, reopened + (now - before) * (first is not None)
            before = now
            if now - began > 60.0:
                return None
            time.sleep(0.0002)
    finally:
        injector.join()
        os.close(file)
    return Watched(1e3 * (first - (moment[0] or began)), 1e3 * reopened)


def until_open(rig: Injected, inject: Callable[[Injected], None]) -> Watched | None:
    """Inject, and wait until the board has opened the relay."""
    shown = SharedNumbers(rig.at / SHOWN, BYSTANDER)
    began = time.monotonic()
    inject(rig)
    while shown["relay"] and time.monotonic() - began < 5.0:
        time.sleep(0.0005)
    took, still = time.monotonic() - began, shown["relay"]
    shown.close()
    return None if still else Watched(1e3 * took, 0.0)


def left_behind(folder: Path) -> str:
    """Summary of the files of a loop that is gone: its supervisor's report, and the log that its writer finishes."""
    end = time.monotonic() + 5.0
    while not (folder / "log.csv").exists() and time.monotonic() < end:
        time.sleep(0.05)
    log = folder / "log.csv"
    log = log if log.exists() else folder / ".log.csv.part"  # its writer was killed too
    rows = log.read_text().count("\n") - 1 if log.exists() else 0
    report = folder / "supervisor.log"
    acted = report.read_text().splitlines()[:1] if report.exists() else []
    return f"{acted[0].partition(': ')[2] if acted else 'nobody was left to act'}; {rows} rows in the log"
