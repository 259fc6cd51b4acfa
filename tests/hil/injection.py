"""Start the loop under test in a separate process, inject faults from outside and watch the duty file of its ESC."""

import contextlib
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from hil.emulator import i2c, serial_line
from hil.emulator.rig import BUS, BYSTANDER, HAND, LINE, PULLED, SHOWN
from hil.emulator.shared import SharedNumbers

HERE = Path(__file__).resolve().parent

STUCK_AFTER = 8.0
"""s from the emulation's start until its pitch actuator sticks, if that is the fault."""


@dataclass
class Injected:
    """The process under test, its files, and the shared numbers of its buses."""

    process: subprocess.Popen
    at: Path
    esc: Path
    idle: bytes
    opened: float
    folder: Path = Path()

    @contextlib.contextmanager
    def numbers(self, file: str) -> Iterator[SharedNumbers]:
        names = i2c.REGISTERS + i2c.STATE + i2c.FAULTS if file == BUS else serial_line.FAULTS
        shared = SharedNumbers(self.at / file, names)
        try:
            yield shared
        finally:
            shared.close()

    def supervisor(self) -> int:
        """Process number of the supervisor."""
        return next(pid for pid, words in children_of(self.process.pid) if "watchdog" in words)


def children_of(process: int) -> list[tuple[int, str]]:
    """(number, command) of a process' children."""
    children = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    return [(int(pid), Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()) for pid in children]


def bus(name: str, value: float = math.inf):
    def inject(rig: Injected) -> None:
        with rig.numbers(BUS) as numbers:
            numbers[name] = value

    return inject


def line(name: str, value: float = math.inf, times: int = 1):
    """Set a fault of the serial line `times` times, 30 ms apart."""

    def inject(rig: Injected) -> None:
        with rig.numbers(LINE) as numbers:
            for _ in range(times):
                numbers[name] = value
                time.sleep(0.03 * (times > 1))

    return inject


def brown_out(rig: Injected) -> None:
    with rig.numbers(BUS) as numbers:
        i2c.brown_out(numbers)


def sends(*numbers: int, pause: float = 0.02):
    """Signals to the loop, `pause` s apart. Ctrl-C goes to the whole process group, as from a terminal."""

    def inject(rig: Injected) -> None:
        for number in numbers:
            send = os.killpg if number == signal.SIGINT else os.kill
            send(rig.process.pid, number)
            time.sleep(pause if len(numbers) > 1 else 0.0)

    return inject


def to_supervisor(number: int):
    return lambda rig: os.kill(rig.supervisor(), number)


def to_all(rig: Injected) -> None:
    """SIGKILL to the loop and its children, except the emulated rig, which is no process on a real rig."""
    for pid, words in children_of(rig.process.pid):
        if "emulator" not in words:
            os.kill(pid, signal.SIGKILL)
    os.kill(rig.process.pid, signal.SIGKILL)


def to_loop_and_supervisor(rig: Injected) -> None:
    """SIGKILL to both processes that can write a pulse; the log's writer continues."""
    for pid in (rig.supervisor(), rig.process.pid):
        os.kill(pid, signal.SIGKILL)


def pulls(force: float):
    """An external force [N] on the stand, beside the thrust."""

    def inject(rig: Injected) -> None:
        shared = SharedNumbers(rig.at / HAND, PULLED)
        shared["force"] = force
        shared.close()

    return inject


def to_writer(rig: Injected) -> None:
    os.kill(next(pid for pid, words in children_of(rig.process.pid) if "hil.log" in words), signal.SIGKILL)


def stops_writer(rig: Injected) -> None:
    """The log's writer hangs, as on a network disk that is gone."""
    os.kill(next(pid for pid, words in children_of(rig.process.pid) if "hil.log" in words), signal.SIGSTOP)


def fills(rig: Injected) -> None:
    """Another program fills the disk of the log."""
    fill(Path(f"/proc/{rig.process.pid}/root{rig.folder}"))


def fill(folder: Path) -> None:
    """Write to a file `filler` until the disk is full."""
    with contextlib.suppress(OSError), open(folder / "filler", "ab", buffering=0) as file:
        while True:
            file.write(bytes(4096))


def now(rig: Injected) -> None:
    """Create the file for which the FMU waits."""
    (rig.folder / "now").touch()


def second_opener(rig: Injected) -> None:
    """Another process tries to open the same outputs."""
    text = "import sys; from pathlib import Path; from hil.bench import locked; locked(Path(sys.argv[1]))"
    environment = {**os.environ, "PYTHONPATH": str(HERE.parents[1])}
    command = [sys.executable, "-c", text, str(rig.esc.parents[1])]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert "in use by" in done.stderr


def writes(file: str, text: str):
    """Another program writes to one of the ESC's files."""

    def inject(rig: Injected) -> None:
        rig.esc.with_name(file).write_text(text)

    return inject


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
