"""Faults that can be injected into a run on the emulated rig, by name: through its buses, by signals, by writes to its outputs,
or in the controller.

In real time a process of its own injects them, because a loop that is killed or stopped cannot. It waits for a byte on standard
input, and ends when that closes. In virtual time the loop injects, and only faults without a time of their own are possible.
"""

import contextlib
import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from hil.devices.clock import VirtualClock
from hil.emulator import i2c, serial_line
from hil.emulator.rig import BUS, HAND, LINE, PULLED
from hil.emulator.shared import SharedNumbers
from hil.loop.bench import Bench
from vpp_fmu.errors import BadInput, near

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Target:
    """The number of the loop's process, the folder of the emulated rig, and the ESC's duty file."""

    pid: int
    at: Path
    esc: Path

    @contextlib.contextmanager
    def numbers(self, file: str) -> Iterator[SharedNumbers]:
        """The faults of a bus that any process may set."""
        names = {BUS: i2c.REGISTERS + i2c.STATE + i2c.FAULTS, LINE: serial_line.FAULTS, HAND: PULLED}[file]
        shared = SharedNumbers(self.at / file, names)
        try:
            yield shared
        finally:
            shared.close()

    def child(self, word: str) -> int:
        """Number of the loop's child whose command has this word."""
        return next(pid for pid, words in children_of(self.pid) if word in words)


Inject = Callable[[Target], None]


def children_of(process: int) -> list[tuple[int, str]]:
    """(number, command) of a process' children."""
    children = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    return [(int(pid), Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()) for pid in children]


def sets(file: str, name: str, value: float = math.inf, times: int = 1) -> Inject:
    """A fault of a bus, or the force [N] of a hand on the stand; set `times` times, 30 ms apart."""

    def inject(rig: Target) -> None:
        with rig.numbers(file) as numbers:
            for _ in range(times):
                numbers[name] = value
                time.sleep(0.03 * (times > 1))

    return inject


bus, line = partial(sets, BUS), partial(sets, LINE)


def brown_out(rig: Target) -> None:
    """A dip of the ADC's supply."""
    with rig.numbers(BUS) as numbers:
        i2c.brown_out(numbers)


def sends(*numbers: int, pause: float = 0.02) -> Inject:
    """Signals to the loop, `pause` s apart. Ctrl-C goes to the whole process group, as from a terminal."""

    def inject(rig: Target) -> None:
        for number in numbers:
            if number == signal.SIGINT:
                os.killpg(os.getpgid(rig.pid), number)
            else:
                os.kill(rig.pid, number)
            time.sleep(pause if len(numbers) > 1 else 0.0)

    return inject


def to_supervisor(number: int) -> Inject:
    return lambda rig: os.kill(rig.child("watchdog"), number)


def to_writer(number: int) -> Inject:
    """A signal to the log's writer; a stopped one hangs, as on a network disk that is gone."""
    return lambda rig: os.kill(rig.child("hil.loop.log"), number)


def to_all(rig: Target) -> None:
    """SIGKILL to the loop and its children, except the emulated rig, which is no process on a real rig."""
    for pid, words in children_of(rig.pid):
        if "emulator" not in words:
            os.kill(pid, signal.SIGKILL)
    os.kill(rig.pid, signal.SIGKILL)


def to_loop_and_supervisor(rig: Target) -> None:
    """SIGKILL to both processes that can write a pulse; the log's writer continues."""
    for pid in (rig.child("watchdog"), rig.pid):
        os.kill(pid, signal.SIGKILL)


def second_opener(rig: Target) -> None:
    """Another process tries to open the same outputs."""
    text = "import sys; from pathlib import Path; from hil.loop.bench import locked; locked(Path(sys.argv[1]))"
    command = [sys.executable, "-c", text, str(rig.esc.parents[1])]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert "in use by" in done.stderr


def writes(file: str, text: str) -> Inject:
    """Another program writes to one of the ESC's files."""

    def inject(rig: Target) -> None:
        rig.esc.with_name(file).write_text(text)

    return inject


AT_ONCE: dict[str, Inject] = {
    "serial: silent for 3 answers": line("silent", 3.0),
    "serial: silence": line("silent"),
    "serial: unplugged": line("unplugged", 1.0),
    "Uno: reset": line("resets", 1.0),
    "I2C: two NACKs": bus("not_acknowledged", 2.0),
    "I2C: NACK for good": bus("not_acknowledged"),
    "I2C: timeout": bus("timeout"),
    "ADC: one brown-out": brown_out,
    "ADC: frozen": bus("frozen", 1.0),
    "ADC: saturated": bus("overload", 5.0),
    "speed: 0 with an open throttle": line("marks_lost", 1.0),
    "speed: halved": line("marks_halved", 1.0),
    "speed: doubled": line("marks_doubled", 1.0),
    "twin: 5 N too many": sets(HAND, "force", 5.0),
    "PWM: switched off by others": writes("enable", "0\n"),
    "PWM: pulse changed by others": writes("duty_cycle", "1900000\n"),
}
"""Faults that are possible in virtual time, too."""

OUTSIDE: dict[str, Inject] = AT_ONCE | {
    "serial: 20 x 3 answers with bit flips": line("flipped", 3.0, 20),
    "serial: 20 x garbage": line("garbage", 1.0, 20),
    "SIGINT": sends(signal.SIGINT),
    "SIGINT twice": sends(signal.SIGINT, signal.SIGINT),
    "SIGTERM": sends(signal.SIGTERM),
    "SIGHUP: the terminal is gone": sends(signal.SIGHUP),
    "SIGQUIT": sends(signal.SIGQUIT),
    "SIGKILL": sends(signal.SIGKILL),
    "SIGSEGV": sends(signal.SIGSEGV),
    "SIGSTOP": sends(signal.SIGSTOP),
    "SIGSTOP, SIGCONT": sends(signal.SIGSTOP, signal.SIGCONT, pause=0.3),
    "supervisor: SIGKILL": to_supervisor(signal.SIGKILL),
    "supervisor: SIGSTOP": to_supervisor(signal.SIGSTOP),
    "supervisor: SIGINT": to_supervisor(signal.SIGINT),
    "supervisor: SIGTERM": to_supervisor(signal.SIGTERM),
    "log's writer: SIGSTOP": to_writer(signal.SIGSTOP),
    "log's writer: SIGKILL": to_writer(signal.SIGKILL),
    "killed together": to_all,
    "loop and supervisor killed": to_loop_and_supervisor,
    "second opener": second_opener,
}
"""Faults that another process injects."""

WITHIN: dict[str, str | float] = {
    "loop: pause of 10 ms": 0.01,
    "loop: pause of 100 ms": 0.1,
    "loop: pause of 1000 ms": 1.0,
    "controller: NaN": "nan",
    "clock set back by 1 h": "clock back",
}
"""Faults of the loop itself, as reactions of `Saboteur`."""

FAULTS = (*OUTSIDE, *WITHIN)


def check_fault(name: str, virtual: bool) -> None:
    """BadInput for an unknown fault, or one that needs real time."""
    if name not in FAULTS:
        raise BadInput("command line", "--inject", repr(name), f"one of {'; '.join(FAULTS)}{near(name, FAULTS)}")
    if virtual and name not in AT_ONCE and name != "controller: NaN":
        raise BadInput("command line", "--inject", f"{name!r} with --virtual", "a run in real time: it has processes to stop")


class Saboteur:
    """A controller that does the wrong thing once `asked` is set: it gives "nan", goes "flat out", sets the "clock back", or
    pauses for so many seconds."""

    def __init__(self, controller, sabotage: str | float | None):
        self._controller, self._sabotage, self.asked = controller, sabotage, False

    def start(self, thrust_set, thrust):
        self._controller.start(thrust_set, thrust)

    def step(self, thrust_set, thrust):
        commands = self._controller.step(thrust_set, thrust)
        if self.asked:
            self.asked = self._sabotage in ("nan", "flat out")
            if self._sabotage == "nan":
                return math.nan, math.nan
            if self._sabotage == "flat out":
                return 6000.0, 0.0
            if self._sabotage == "clock back":
                before = time.time
                time.time = lambda: before() - 3600.0
            else:
                time.sleep(self._sabotage)
        return commands

    def close(self):
        self._controller.close()


class Injector:
    """Injects the fault `name` into the run on an emulated bench, or into its controller, when it is called."""

    def __init__(self, name: str, bench: Bench, controller: Saboteur):
        self.name, self._controller, self._process = name, controller, None
        esc = bench.esc.duty_file
        self._target = Target(os.getpid(), esc.parents[3], esc)
        if name in OUTSIDE and not isinstance(bench.clock, VirtualClock):
            task = json.dumps([name, *map(str, (self._target.pid, self._target.at, esc))])
            words = [sys.executable, "-m", "hil.emulator.faults", task]
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "bufsize": 0}
            self._process = subprocess.Popen(words, start_new_session=True, **pipes)  # Ctrl-C must not reach it
            self._process.stdout.readline()  # its imports are done

    def __call__(self) -> None:
        if self._process:
            self._process.stdin.write(b"x")
        elif self.name in WITHIN:
            self._controller.asked = True
        else:
            OUTSIDE[self.name](self._target)

    def close(self) -> None:
        if self._process:
            self._process.stdin.close()
            self._process.wait()
            self._process.stdout.close()


def main(name: str, pid: str, at: str, esc: str) -> None:
    print("ready", flush=True)
    if os.read(0, 1):
        OUTSIDE[name](Target(int(pid), Path(at), Path(esc)))


if __name__ == "__main__":
    main(*json.loads(sys.argv[1]))
