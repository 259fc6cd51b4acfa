"""Every fault of the rig, injected for real: `python -m tests.hil.faults [WORD ...]` (rows with a WORD in their name, or all).

A process of its own runs the closed loop on the emulated rig in real time, with its supervisor. When the thrust stands, the
fault is injected: through the emulated buses, by a signal, or in the controller. The duty file of the ESC is watched from
outside: how long until the idle pulse stood, for good. Exit code 1 if a row is not as it must be.
"""

import contextlib
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from hil.emulator import i2c, serial_line
from hil.emulator.rig import BUS, LINE
from hil.emulator.shared import SharedNumbers

RAMP = 1800.0
"""ms: half a second to be sure of the fault at most, 1.5 s of ramp from a fully open throttle, the emulation's own delays."""

CUT = 100.0
"""ms, as the project promises for a loop that is gone, hung or told to stop at once."""

SEEN = 300.0
"""ms for what must first be seen in the revolutions: 50 ms or three of them, and the board's 200 ms for a stall."""

HERE = Path(__file__).resolve().parent


@dataclass
class Injected:
    """The process under test: where its files are, and the numbers of its buses."""

    process: subprocess.Popen
    at: Path
    esc: Path
    idle: bytes
    opened: float

    @contextlib.contextmanager
    def numbers(self, file: str) -> Iterator[SharedNumbers]:
        names = i2c.REGISTERS + i2c.STATE + i2c.FAULTS if file == BUS else serial_line.FAULTS
        shared = SharedNumbers(self.at / file, names)
        try:
            yield shared
        finally:
            shared.close()

    def supervisor(self) -> int:
        """Its process."""
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        return next(int(pid) for pid in children if b"watchdog" in Path(f"/proc/{pid}/cmdline").read_bytes())


def bus(name: str, value: float = math.inf):
    def inject(rig: Injected) -> None:
        with rig.numbers(BUS) as numbers:
            numbers[name] = value

    return inject


def line(name: str, value: float = math.inf, times: int = 1):
    """`times`: so often, 30 ms apart."""

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


def nothing(rig: Injected) -> None:
    """What is wrong was wrong from the start."""


def stuck(rig: Injected) -> float:
    """Wait for the time at which the emulated actuator gets stuck; it counts from the emulation's start."""
    time.sleep(max(0.0, rig.opened + STUCK_AFTER - time.monotonic()))
    return time.monotonic()


@dataclass(frozen=True)
class Row:
    """A fault and what must come of it: the loop's last state ("gone": it has none to tell), what it names as the cause, how
    soon the idle pulse stands [ms]; None: not before the run's own end. `load`: four other processes are busy."""

    name: str
    must: str
    inject: Callable[[Injected], float | None]
    state: str = "fault"
    cause: str = ""
    within: float | None = RAMP
    task: dict = field(default_factory=dict)
    load: bool = False


@dataclass(frozen=True)
class Outcome:
    """What came of it; `wrong`: why that is not as it must be."""

    happened: str
    state: str
    idle: float | None
    wrong: str


def goes_on(name: str, must: str, inject, **more) -> Row:
    return Row(name, must, inject, "safe", "", None, **more)


STUCK_AFTER = 8.0
STUCK = {
    "seconds": 30,
    "swing": True,
    "physics": {"hidden": ["rod_stuck"], "parameters": {"rod_stuck.after": STUCK_AFTER}},
}
FAST = {"limits": {"omega_max": 5500.0, "omega_trip": 5501.0}, "sabotage": "flat out"}
"""The speed loop cannot hold the limit to one rpm."""

ROWS = (
    goes_on("serial: 20 x 3 answers with bit flips", "no wrong value, goes on", line("flipped", 3.0, 20)),
    goes_on("serial: 20 x garbage", "no wrong value, goes on", line("garbage", 1.0, 20)),
    goes_on("serial: silent for 3 answers", "holds, goes on", line("silent", 3.0)),
    Row("serial: silence", "holds 50 ms, ramps down", line("silent"), cause="tachometer: "),
    Row("serial: unplugged", "ramps down", line("unplugged", 1.0), cause="tachometer: unplugged"),
    Row("Uno: reset", "ramps down", line("resets", 1.0), cause="tachometer: "),
    goes_on("I2C: two NACKs", "tries again, goes on", bus("not_acknowledged", 2.0)),
    Row("I2C: NACK for good", "retries, ramps down", bus("not_acknowledged"), cause="adc: refused"),
    Row("I2C: timeout", "ramps down", bus("timeout"), cause="adc: timeout"),
    goes_on("ADC: one brown-out", "writes its settings anew, goes on", brown_out),
    Row("ADC: frozen", "ramps down", bus("frozen", 1.0), cause="adc: frozen"),
    Row("ADC: saturated", "ramps down", bus("overload", 5.0), cause="adc: saturated"),
    Row(
        "speed: 0 with an open throttle", "idle at once", line("marks_lost", 1.0), cause="tachometer: no rotation", within=SEEN
    ),
    Row("speed: halved", "ramps down", line("marks_halved", 1.0), cause="tachometer: "),
    Row("speed: doubled", "ramps down", line("marks_doubled", 1.0), cause="tachometer: "),
    Row("pitch actuator: stuck", "ramps down", stuck, cause="pitch actuator: stuck", within=20000.0, task=STUCK),
    Row("over-speed", "idle at once", sends(signal.SIGUSR1), cause="rig: over-speed", task=FAST),
    goes_on("loop: pause of 10 ms", "counts, goes on", sends(signal.SIGUSR1), task={"sabotage": 0.01}),
    Row("loop: pause of 100 ms", "idle at once", sends(signal.SIGUSR1), within=CUT, task={"sabotage": 0.1}),
    Row("loop: pause of 1000 ms", "idle at once", sends(signal.SIGUSR1), within=CUT, task={"sabotage": 1.0}),
    Row("controller: NaN", "ramps down", sends(signal.SIGUSR1), cause="controller: not a number", task={"sabotage": "nan"}),
    Row("SIGINT", "ramps down", sends(signal.SIGINT), "safe", "operator: interrupted"),
    Row("SIGINT twice", "idle at once", sends(signal.SIGINT, signal.SIGINT), cause="operator: interrupted", within=CUT),
    Row("SIGTERM", "idle at once, ends", sends(signal.SIGTERM), cause="operator: terminated", within=CUT),
    Row("SIGKILL", "supervisor: idle", sends(signal.SIGKILL), "gone", within=CUT),
    Row("SIGKILL under load", "supervisor: idle", sends(signal.SIGKILL), "gone", within=CUT, load=True),
    Row("SIGSEGV", "supervisor: idle", sends(signal.SIGSEGV), "gone", within=CUT),
    Row("SIGSEGV under load", "supervisor: idle", sends(signal.SIGSEGV), "gone", within=CUT, load=True),
    Row("SIGSTOP", "supervisor: idle", sends(signal.SIGSTOP), "gone", within=CUT),
    Row("SIGSTOP under load", "supervisor: idle", sends(signal.SIGSTOP), "gone", within=CUT, load=True),
    Row("SIGSTOP, SIGCONT", "idle, stays so", sends(signal.SIGSTOP, signal.SIGCONT, pause=0.3), within=CUT),
    Row("supervisor: SIGKILL", "ramps down", to_supervisor(signal.SIGKILL), cause="supervisor: supervisor lost"),
    Row("supervisor: SIGSTOP", "ramps down", to_supervisor(signal.SIGSTOP), cause="supervisor: supervisor lost"),
    goes_on("supervisor: SIGINT", "nothing", to_supervisor(signal.SIGINT)),
    goes_on("supervisor: SIGTERM", "nothing", to_supervisor(signal.SIGTERM)),
    goes_on("disk full", "goes on, says what was lost", nothing, task={"full": True}),
    goes_on("clock set back by 1 h", "nothing", sends(signal.SIGUSR1), task={"sabotage": "clock back"}),
    Row("PWM: refused at arm", "does not arm", nothing, "safe", "esc: not ready", 0.0, {"refuse": "enable"}),
)


@contextlib.contextmanager
def load(wanted: bool) -> Iterator[None]:
    """Four busy processes."""
    hogs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(4 * wanted)]
    try:
        yield
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait()


@contextlib.contextmanager
def started(task: dict, folder: Path) -> Iterator[tuple[subprocess.Popen, list[dict]]]:
    """The process in a session of its own, and what it has said so far; on a disk of 64 kB if the task says `full`."""
    told, words = [], [sys.executable, str(HERE / "rig_process.py"), json.dumps({"seconds": 3, **task, "folder": str(folder)})]
    if task.get("full"):
        words = ["unshare", "-m", "sh", "-c", 'mount -t tmpfs -o size=64k none "$0" && exec "$@"', str(folder), *words]
    environment = {**os.environ, "PYTHONPATH": str(HERE.parents[1])}
    process = subprocess.Popen(words, stdout=subprocess.PIPE, env=environment, start_new_session=True)

    def read():
        for each in process.stdout:
            told.append({**json.loads(each), "heard": time.monotonic()})

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    try:
        yield process, told
    finally:
        process.kill()
        process.wait()
        reader.join(5.0)
        process.stdout.close()
        for each in told[:1]:
            shutil.rmtree(each.get("at", folder), ignore_errors=True)


def wait_for(told: list[dict], key: str, process: subprocess.Popen) -> dict | None:
    """What the process says with this key; None if it ends without."""
    end = time.monotonic() + 60.0
    while time.monotonic() < end:
        for each in list(told):
            if key in each:
                return each
        if process.poll() is not None and not any(key in each for each in told):
            time.sleep(0.2)  # the reader may still be at it
            return next((each for each in told if key in each), None)
        time.sleep(0.005)
    return None


def until_idle(rig: Injected, inject: Callable[[Injected], float | None]) -> float | None:
    """Inject; ms from then on after which the ESC was never seen open again. None: it was never seen idle for 0.8 s."""
    file, began, idle_since, moment = os.open(rig.esc, os.O_RDONLY), time.monotonic(), None, []
    injector = threading.Thread(target=lambda: moment.append(inject(rig)))
    injector.start()
    last = began
    try:
        while idle_since is None or injector.is_alive() or time.monotonic() - idle_since < 0.8:
            now = time.monotonic()
            if os.pread(file, 32, 0).split(b"\n")[0] == rig.idle:
                idle_since = idle_since or now
            else:
                last, idle_since = now, None
            if now - began > 60.0:
                return None
            time.sleep(0.0002)
    finally:
        injector.join()
        os.close(file)
    return 1e3 * (last - (moment[0] or began))


def tried(row: Row) -> Outcome:
    """Inject a row's fault and judge what came of it."""
    with tempfile.TemporaryDirectory() as folder, started(row.task, Path(folder)) as (process, told):
        here = wait_for(told, "esc", process)
        if here is None:
            return judged(row, wait_for(told, "ended", process), 0.0)
        rig = Injected(process, Path(here["at"]), Path(here["esc"]), b"%d" % here["idle"], here["heard"])
        if not wait_for(told, "running", process):
            return judged(row, wait_for(told, "ended", process), None)
        with load(row.load):
            time.sleep(0.2 * row.load)
            idle = until_idle(rig, row.inject)
        if row.state == "gone":
            process.kill()
            return judged(row, None, idle, left_behind(Path(folder)))
        return judged(row, wait_for(told, "ended", process), idle)


def told_by(end: dict) -> str:
    """The cause in full, and the kinds of what followed."""
    causes = [why for _, state, why in end["transitions"] if state in ("ramp down", "fault")]
    later = [": ".join(why.split(": ")[:2]) for why in causes if why != end["ended"] and ": " in why]
    return "; then ".join([end["ended"] or end.get("failure") or "ran to its end", *later])


def left_behind(folder: Path) -> str:
    """What a loop that is gone has left: its supervisor's report, and the log that its writer finishes."""
    end = time.monotonic() + 5.0
    while not (folder / "log.csv").exists() and time.monotonic() < end:
        time.sleep(0.05)
    rows = (folder / "log.csv").read_text().count("\n") - 1 if (folder / "log.csv").exists() else 0
    return f"{(folder / 'supervisor.log').read_text().partition(': ')[2].strip()}; {rows} rows in the log"


def judged(row: Row, end: dict | None, idle: float | None, left: str = "") -> Outcome:
    """Hold what came against what must."""
    state, happened = (end["state"], told_by(end)) if end else ("gone", left)
    wrong = []
    if state != row.state:
        wrong.append(f"state {state}, must be {row.state}")
    if row.within is None:
        if end and end["ended"]:
            wrong.append("ended early")
        if end and end.get("jump", 0.0) > 200.0:
            wrong.append(f"speed jumped by {end['jump']:.0f} rpm in a tick")
    elif idle is None or idle > row.within:
        wrong.append(f"idle after {idle} ms, must be within {row.within:g} ms")
    if not happened.startswith(row.cause):
        wrong.append(f"cause must be {row.cause!r}")
    return Outcome(happened, state, None if row.within is None else idle, "; ".join(wrong))


def main(words: list[str]) -> int:
    """Try the rows and print them; 1 if one is wrong."""
    rows = [row for row in ROWS if not words or any(word in row.name for word in words)]
    print(f"{'fault':39} {'must':34} {'idle [ms]':>9}  {'state':6} what happened", flush=True)
    bad = 0
    for row in rows:
        outcome = tried(row)
        idle = "-" if outcome.idle is None else f"{outcome.idle:.1f}"
        print(f"{row.name:39} {row.must:34} {idle:>9}  {outcome.state:6} {outcome.happened}", flush=True)
        if outcome.wrong:
            bad += 1
            print(f"    WRONG: {outcome.wrong}", flush=True)
    print(f"{len(rows) - bad} of {len(rows)} as they must be")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
