"""Inject every fault of the rig in real time: `python -m tests.hil.faults [WORD ...]` (rows with a WORD in their name, or all).

A separate process runs the closed loop and its supervisor on the emulated rig in real time. Once the thrust has settled, the
fault is injected through the emulated buses, by a signal, or in the controller. The ESC's duty file is watched from outside, to
measure the time until the idle pulse is permanent. Exit code 1 if a row fails. The times depend on the machine's load, which is
printed before and after.
"""

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from hil.emulator.faults import OUTSIDE, WITHIN, sends
from tests.hil.disk import full
from tests.hil.injection import (
    STUCK_AFTER,
    Injected,
    Watched,
    fills,
    left_behind,
    load,
    nothing,
    now,
    started,
    stuck,
    until_idle,
    until_open,
    wait_for,
)

RAMP = 1800.0
"""ms: half a second to be sure of the fault at most, 1.5 s of ramp from a fully open throttle, the emulation's own delays."""

CUT = 100.0
"""ms: the project's promise for a loop that is killed, hung or ordered to stop at once."""

OPEN = 120.0
"""ms: the board's 100 ms after the last request, up to a tick since that request, and the board's loop time."""

REOPENED = 5.0
"""ms for which the throttle may be open after the first idle pulse: a loop that is suspended right before a pulse writes it
on resuming, and the supervisor overwrites it with the idle pulse within 1 ms."""

ALARM = 2000.0
"""ms until the twin's alarm for a change of 5 N, in whole blocks of half a second; its reaction takes additional time."""

WAITS = 1200.0
"""ms until a row on a full disk is late: a second, the rest of the file's last page, and the writer's pause."""

TRIES = 3
"""Runs until the thrust settles: on a busy machine the emulation itself may starve, which is not the injected fault."""

SEEN = 300.0
"""ms for a fault that is detected from revolutions: 50 ms or three revolutions, and the board's 200 ms for a stall."""


@dataclass(frozen=True)
class Row:
    """A fault, and the required outcome: the loop's last state ("gone": it reports none), the start of the reported cause, and
    the latest time of the idle pulse [ms] (None: only at the run's end). `inject`: by default the fault of this name in
    `hil.emulator.faults`. `load`: four other processes are busy."""

    name: str
    must: str
    inject: Callable[[Injected], float | None] | None = None
    state: str = "fault"
    cause: str = ""
    within: float | None = RAMP
    task: dict = field(default_factory=dict)
    load: bool = False
    relay: bool = False
    """Watch the relay in the ESC's supply, because no process is left to write a pulse."""
    alone: Callable[[], "Outcome"] | None = None
    """Runs the row in place of the closed loop."""

    def __post_init__(self):
        if self.name in WITHIN:
            self.task["sabotage"] = WITHIN[self.name]
        asks = sends(signal.SIGUSR1) if self.name in WITHIN else None
        object.__setattr__(self, "inject", self.inject or asks or OUTSIDE[self.name])


@dataclass(frozen=True)
class Outcome:
    """Outcome of a row; `wrong`: violated requirements."""

    happened: str
    state: str
    seen: Watched | None
    wrong: str


def disk_full(phase: str, name: str, must: str) -> Row:
    """A row for a command on a disk that is full from a phase on."""

    def alone() -> Outcome:
        became = full(phase)
        idle = "nothing opened" if became.pulse is None else f"pulse {int(became.pulse) / 1000:g} us at the end"
        return Outcome(f"{became.said}; {became.kept}; {idle}", f"exit {became.code}", None, became.wrong)

    return Row(name, must, nothing, within=None, alone=alone)


def goes_on(name: str, must: str, inject=None, **more) -> Row:
    return Row(name, must, inject, "safe", "", None, **more)


def wrong_sign(of: str, device: str) -> Row:
    cause = f"{device}: wrong polarity"
    return Row(f"wrong sign of the {of}", "ends at low speed", nothing, "fault", cause, 0.0, {"wrong": of})


STUCK = {"seconds": 30, "swing": True, "physics": {"hidden": ["rod_stuck"], "parameters": {"rod_stuck.after": STUCK_AFTER}}}
FAST = {"limits": {"omega_max": 5500.0, "omega_trip": 5501.0}, "sabotage": "flat out"}
"""The trip speed is one rpm above the limit, closer than the speed loop can hold it."""

SMALL = {"small": True, "seconds": 20}
RELAY = {"within": OPEN, "task": {"physics": {"lingers": 8.0}}, "relay": True}
PULLS = OUTSIDE["twin: 5 N too many"]
TWIN_RAMPS, TWIN_IDLES = ({"twin": what, "seconds": 10} for what in ("ramp", "idle"))

ROWS = (
    goes_on("serial: 20 x 3 answers with bit flips", "no wrong value, goes on"),
    goes_on("serial: 20 x garbage", "no wrong value, goes on"),
    goes_on("serial: silent for 3 answers", "holds, goes on"),
    Row("serial: silence", "holds 50 ms, ramps down", cause="tachometer: "),
    Row("serial: unplugged", "ramps down", cause="tachometer: unplugged"),
    Row("Uno: reset", "ramps down", cause="tachometer: "),
    goes_on("I2C: two NACKs", "tries again, goes on"),
    Row("I2C: NACK for good", "retries, ramps down", cause="adc: refused"),
    Row("I2C: timeout", "ramps down", cause="adc: timeout"),
    goes_on("ADC: one brown-out", "writes its settings anew, goes on"),
    Row("ADC: frozen", "ramps down", cause="adc: frozen"),
    Row("ADC: saturated", "ramps down", cause="adc: saturated"),
    Row("speed: 0 with an open throttle", "idle at once", cause="tachometer: no rotation", within=SEEN),
    Row("speed: halved", "ramps down", cause="tachometer: "),
    Row("speed: doubled", "ramps down", cause="tachometer: "),
    Row("pitch actuator: stuck", "ramps down", stuck, cause="pitch actuator: stuck", within=20000.0, task=STUCK),
    Row("over-speed", "idle at once", sends(signal.SIGUSR1), cause="rig: over-speed", task=FAST),
    goes_on("loop: pause of 10 ms", "counts, goes on"),
    Row("loop: pause of 100 ms", "idle at once", within=CUT),
    Row("loop: pause of 1000 ms", "idle at once", within=CUT),
    Row("controller: NaN", "ramps down", cause="controller: not a number"),
    Row("SIGINT", "ramps down", cause="operator: interrupted", state="safe"),
    Row("SIGINT twice", "idle at once", cause="operator: interrupted", within=CUT),
    Row("SIGTERM", "idle at once, ends", cause="operator: terminated", within=CUT),
    Row("SIGHUP: the terminal is gone", "idle at once, ends", cause="operator: terminated", within=CUT),
    Row("SIGQUIT", "supervisor: idle", state="gone", within=CUT),
    Row("SIGKILL", "supervisor: idle", state="gone", within=CUT),
    Row("SIGKILL under load", "supervisor: idle", OUTSIDE["SIGKILL"], "gone", within=CUT, load=True),
    Row("SIGSEGV", "supervisor: idle", state="gone", within=CUT),
    Row("SIGSEGV under load", "supervisor: idle", OUTSIDE["SIGSEGV"], "gone", within=CUT, load=True),
    Row("SIGSTOP", "supervisor: idle", state="gone", within=CUT),
    Row("SIGSTOP under load", "supervisor: idle", OUTSIDE["SIGSTOP"], "gone", within=CUT, load=True),
    Row("SIGSTOP, SIGCONT", "idle, stays so", within=CUT),
    Row("supervisor: SIGKILL", "ramps down", cause="supervisor: supervisor lost"),
    Row("supervisor: SIGSTOP", "ramps down", cause="supervisor: supervisor lost"),
    goes_on("supervisor: SIGINT", "nothing"),
    goes_on("supervisor: SIGTERM", "nothing"),
    Row("disk full: filled by others", "waits 1 s, ramps down", fills, cause="log: log lost", within=WAITS + RAMP, task=SMALL),
    disk_full("small", "disk full: too small for the run", "nothing turns, one line"),
    disk_full("start", "disk full: before the start", "nothing turns, one line"),
    disk_full("run", "disk full: in a run", "ramps down, says why everywhere"),
    disk_full("end", "disk full: at the end", "idle, all files"),
    disk_full("campaign", "disk full: in a campaign", "idle, one line, goes on by --resume"),
    goes_on("clock set back by 1 h", "nothing"),
    Row("killed together", "the board opens the relay", state="gone", **RELAY),
    Row("killed together, under load", "the board opens the relay", OUTSIDE["killed together"], "gone", load=True, **RELAY),
    Row("loop and supervisor killed", "the board opens the relay", state="gone", **RELAY),
    Row("twin: 5 N too many, ramp", "ramps down", PULLS, "fault", "twin: twin's alarm", ALARM + RAMP, TWIN_RAMPS),
    Row("twin: 5 N too many, idle", "idle", PULLS, "fault", "twin: twin's alarm", ALARM + CUT, TWIN_IDLES),
    goes_on("twin: 5 N too many, note", "says so, goes on", PULLS, task={"twin": "note", "seconds": 6}),
    Row("FMU: hangs", "idle, the loop is killed", now, "gone", within=CUT, task={"fmu": "hangs"}),
    Row("FMU: exits", "idle", now, "gone", within=CUT, task={"fmu": "exits"}),
    Row("FMU: crashes", "idle", now, "gone", within=CUT, task={"fmu": "crashes"}),
    Row("FMU: errs", "ramps down", now, cause="controller: failed", task={"fmu": "errs"}),
    Row("FMU: slow", "ramps down", now, cause="loop: overrun", task={"fmu": "slow"}),
    Row("log's writer: SIGSTOP", "waits 1 s, ramps down", cause="log: log lost", within=WAITS + RAMP),
    Row("log's writer: SIGKILL", "ramps down", cause="log: log lost"),
    goes_on("second opener", "refused, goes on"),
    Row("PWM: switched off by others", "idle at once", cause="esc: output lost", within=CUT),
    Row("PWM: pulse changed by others", "idle at once", cause="esc: output lost", within=CUT),
    wrong_sign("load cell", "load cell"),
    wrong_sign("pitch", "pitch actuator"),
    Row("PWM: refused at arm", "does not arm", nothing, "safe", "esc: not ready", 0.0, {"refuse": "enable"}),
)


def tried(row: Row) -> Outcome:
    """Inject a row's fault and judge the outcome."""
    if row.alone:
        return row.alone()
    for _ in range(TRIES):
        outcome = once(row)
        if isinstance(outcome, Outcome):
            return outcome
    return Outcome(f"no run came far enough to inject it; the last: {outcome}", "", None, "not tried")


def once(row: Row) -> Outcome | str:
    """Outcome of one run, or the reason why it ended before the fault could be injected."""
    with tempfile.TemporaryDirectory() as folder, started(row.task, Path(folder)) as (process, messages):
        here = wait_for(messages, "esc", process)
        if here is None:
            end = wait_for(messages, "ended", process)
            return judged(row, end, None) if row.inject is nothing else causes_of(end)
        own = process, b"%d" % here["idle"], here["heard"], Path(folder)
        rig = Injected(process.pid, Path(here["at"]), Path(here["esc"]), *own)
        if not wait_for(messages, "running", process):
            end = wait_for(messages, "ended", process)
            return judged(row, end, None) if row.within == 0.0 else causes_of(end)
        with load(4 * row.load):
            time.sleep(0.2 * row.load)
            seen = (until_open if row.relay else until_idle)(rig, row.inject)
        if row.state == "gone":
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(5.0 if "fmu" in row.task else 0.0)  # the supervisor ends one that hangs
            process.kill()
            return judged(row, None, seen, left_behind(Path(folder)))
        return judged(row, wait_for(messages, "ended", process), seen)


def causes_of(end: dict | None) -> str:
    """The cause in full, and the kinds of the later causes."""
    if end is None:
        return "it said nothing"
    causes = [one["why"] for one in end["transitions"] if one["state"] in ("ramp down", "fault")]
    later = [": ".join(why.split(": ")[:2]) for why in causes if why != end["ended"] and ": " in why]
    return "; then ".join([end["ended"] or end.get("failure") or "ran to its end", *later])


def judged(row: Row, end: dict | None, seen: Watched | None, left: str = "") -> Outcome:
    """Compare the outcome with the row's requirements."""
    state, happened = (end["state"], causes_of(end)) if end else ("gone", left)
    wrong = []
    if state != row.state:
        wrong.append(f"state {state}, must be {row.state}")
    if row.within is None:
        if end and end["ended"]:
            wrong.append("ended early")
        if end and end.get("jump", 0.0) > 200.0:
            wrong.append(f"speed jumped by {end['jump']:.0f} rpm in a tick")
    elif row.within and (seen is None or seen.idle > row.within or seen.reopened > REOPENED):
        wrong.append(f"{seen}, must be idle within {row.within:g} ms and stay so")
    if not happened.startswith(row.cause):
        wrong.append(f"cause must be {row.cause!r}")
    return Outcome(happened, state, seen if row.within else None, "; ".join(wrong))


def main(words: list[str]) -> int:
    """Run the rows and print them; 1 if one fails."""
    rows = [row for row in ROWS if not words or any(word in row.name for word in words)]
    print(_load())
    print(f"{'fault':39} {'must':34} {'idle [ms]':>9}  {'state':6} what happened", flush=True)
    bad = 0
    worst: dict[str, list[float]] = {"idle, at once": [], "idle, else": [], "relay open": []}
    for row in rows:
        outcome = tried(row)
        idle = "-" if outcome.seen is None else f"{outcome.seen.idle:.1f}"
        print(f"{row.name:39} {row.must:34} {idle:>9}  {outcome.state:6} {outcome.happened}", flush=True)
        if outcome.seen and outcome.seen.reopened:
            print(f"    the throttle was seen open for another {outcome.seen.reopened:.1f} ms", flush=True)
        if outcome.seen:
            kind = "relay open" if row.relay else "idle, at once" if row.within == CUT else "idle, else"
            worst[kind].append(outcome.seen.idle)
        if outcome.wrong:
            bad += 1
            print(f"    WRONG: {outcome.wrong}", flush=True)
    print(f"{len(rows) - bad} of {len(rows)} as they must be")
    for what, times in worst.items():
        if times:
            print(f"{what}: {max(times):.1f} ms at most, of {len(times)}")
    print(_load())
    return 1 if bad else 0


def _load() -> str:
    return f"{os.cpu_count()} cores, load {' '.join(f'{x:.1f}' for x in os.getloadavg())}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
