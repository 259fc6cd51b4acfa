"""python -m tests.hil.silent [--runs N] [--seconds S] [--kept FILE]: how often is an answering board taken for silent, and why?

The closed loop runs on the emulated rig in real time, alone and then beside `--load` busy processes and programs that start
and end. Runs that end with "silent" or "stale" of the tachometer are counted. Each line has the longest stall of a core
(`tests/stalls.py`: the host suspended it) and the longest transit of bytes through a separate pseudo-terminal, both ends in
real time. Kernel workers of ordinary priority carry these bytes: unless they are hurried (`hil/realtime.py`), a starting
program delays them although no core stalls.

Each run has its own rig (`seed`). `--kept` appends a line of JSON to FILE after each run; runs found there are counted and not
repeated, so the same command continues an interrupted series.
"""

import argparse
import fcntl
import json
import os
import pty
import signal
import struct
import subprocess
import sys
import tempfile
import termios
import threading
import time
import tty
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from tests.hil.faults import causes_of
from tests.hil.injection import load, started, wait_for
from tests.stalls import Stalls

AIM = 0
"""Highest number of runs that may end for a silent board while no core stalls."""
PATIENCE = 0.05
"""s of silence that end a run."""
BYTES = 20
"""Approximate length of an answer of the board."""


def carried(seconds: float) -> None:
    """Print the longest transit [s] of bytes through a pseudo-terminal within `seconds`; runs as a separate process."""
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(80))
    longest, end = 0.0, time.monotonic() + seconds
    while time.monotonic() < end:
        began = time.monotonic()
        os.write(ours, bytes(BYTES))
        while not struct.unpack("i", fcntl.ioctl(theirs, termios.FIONREAD, bytes(4)))[0]:
            time.sleep(0.0002)
        longest = max(longest, time.monotonic() - began)
        os.read(theirs, 4 * BYTES)
        time.sleep(0.004)
    print(longest)


@contextmanager
def busy(count: int):
    """`count` busy processes, and programs that start and end one after the other, as on a machine in use."""
    stop = threading.Event()

    def programs():
        while not stop.is_set():
            subprocess.run([sys.executable, "-c", "import numpy, scipy.optimize"], check=False)

    thread = threading.Thread(target=programs, daemon=True)
    with load(count):
        if count:
            thread.start()
        try:
            yield
        finally:
            stop.set()
            if count:
                thread.join()


STARTS = 60.0
"""s that a run may take beyond its own seconds; without an answer until then it is ended and counts as something else."""


class Made(NamedTuple):
    """A run: number of busy processes, number of the run, reason of an early end ("" if none), longest stall and longest
    transit through the pseudo-terminal [s]."""

    load: int
    run: int
    why: str
    stood: float
    took: float


def once(seconds: float, load: int, run: int, stalls: Stalls) -> Made:
    """Make a run."""
    with ExitStack() as ends:
        ends.enter_context(busy(load))
        folder = Path(ends.enter_context(tempfile.TemporaryDirectory()))
        command = [sys.executable, "-m", "tests.hil.silent", "--carried", str(seconds)]
        probe = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        began = time.monotonic()
        process, messages = ends.enter_context(started({"seconds": seconds, "seed": run}, folder))
        end = wait_for(messages, "ended", process, seconds + STARTS)
        stood = stalls.longest(since=began)
        took = float(probe.communicate()[0] or "nan")
        return Made(load, run, causes_of(end) if end is None or end["ended"] else "", stood, took)


def main(arguments: list[str]) -> int:
    """Run and print; 1 if more than AIM runs end for a silent board while no core stalls."""
    parser = argparse.ArgumentParser(prog="python -m tests.hil.silent", description=__doc__)
    parser.add_argument("--runs", type=int, default=200, metavar="N", help="idle, and as many loaded (default: 200)")
    parser.add_argument("--seconds", type=float, default=20.0, metavar="S", help="of each (default: 20)")
    parser.add_argument("--load", type=int, default=2, metavar="N", help="busy processes (default: 2)")
    parser.add_argument("--kept", type=Path, metavar="FILE", help="keep each run there, and go on behind those that it holds")
    parser.add_argument("--carried", type=float, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.carried:
        carried(options.carried)
        return 0
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # leave the contexts, so that the busy processes end
    made = {(one.load, one.run): one for one in kept(options.kept)} if options.kept else {}
    stalls, bad = Stalls(), 0
    try:
        for load in dict.fromkeys((0, options.load)):
            bad += _series(options, load, stalls, made)
    finally:
        stalls.close()
    return int(bad > AIM)


def kept(path: Path) -> list[Made]:
    """The runs in a file of `--kept`; an incomplete line is ignored."""
    found, text = [], path.read_text() if path.exists() else ""
    for line in text.splitlines():
        with suppress(ValueError, TypeError):
            found.append(Made(**json.loads(line)))
    if text and not text.endswith("\n"):
        path.write_text(text + "\n")
    return found


def _series(options, load: int, stalls: Stalls, made: dict[tuple[int, int], Made]) -> int:
    silent = alone = stood_still = other = 0
    for k in range(1, options.runs + 1):
        one, before = made.get((load, k)), ", made before"
        if one is None:
            one, before = once(options.seconds, load, k, stalls), ""
            if options.kept:
                with open(options.kept, "a") as file:
                    file.write(json.dumps(one._asdict()) + "\n")
        of_board = "tachometer: silent" in one.why or "tachometer: stale" in one.why
        silent, other = silent + of_board, other + (bool(one.why) and not of_board)
        alone, stood_still = alone + (of_board and not one.stood), stood_still + bool(one.stood)
        said = f"stall {1e3 * one.stood:3.0f} ms, pseudo-terminal {1e3 * one.took:5.1f} ms, {one.why or 'ran to its end'}"
        print(f"load {load}, run {k} of {options.runs}{before}: {said}", flush=True)
    counts = f"{silent} of {options.runs} ended for a silent board, {alone} of them while no core stood still (aim: {AIM})"
    print(f"load {load}: {counts}; {other} ended for something else; in {stood_still} runs a core stood still\n", flush=True)
    return alone


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
