"""The emulated rig in real time: physics and far ends of the buses in a separate process, a step a millisecond.

Run as a module. The one argument is JSON: the folder, which contains the calibration, and the emulated rig. The process prints
"ready" on standard output, and ends when standard input closes, that is with its parent.
"""

import contextlib
import json
import os
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

from hil.devices.calibration import Calibration, read_calibration, to_json
from hil.devices.clock import MonotonicClock
from hil.emulator.rig import LINE, PORT, EmulatedRig, Emulation, bench_in, folder
from hil.emulator.serial_line import PtyLine
from hil.loop.bench import Bench
from hil.loop.realtime import real_time
from hil.loop.ticks import Ticks
from hil.safety.faults import DeviceFault, FaultKind

PERIOD = 0.001
"""Time between two steps, s."""
PRIORITY = 70
"""Below the loop's, which must not wait for the emulated rig."""
CALIBRATION = "calibration.json"


def real_time_bench(rig: EmulatedRig, calibration: Calibration, truth: Calibration | None = None) -> Bench:
    """An emulated rig in a separate process; `truth` as in `virtual_bench`. DeviceFault NOT_READY if it does not start."""
    ends, clock = contextlib.ExitStack(), MonotonicClock()
    with contextlib.ExitStack() as undo:
        undo.callback(ends.close)
        at = ends.enter_context(folder())
        (at / CALIBRATION).write_text(to_json(truth or calibration))
        _start(rig, at, ends)
        bench = bench_in(at, clock, calibration, truth or calibration, str(at / PORT), f"in real time, in {at}", ends)
        undo.pop_all()
    return bench


def _start(rig: EmulatedRig, at: Path, ends: contextlib.ExitStack) -> None:
    task = json.dumps({"folder": str(at), "rig": asdict(rig)})
    process = subprocess.Popen(
        [sys.executable, "-m", "hil.emulator.process", task],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,  # so that Ctrl-C reaches only the loop
    )

    def stop() -> None:
        process.stdin.close()
        process.wait()
        process.stdout.close()

    ends.callback(stop)
    if process.stdout.readline() != b"ready\n":
        raise DeviceFault("emulated rig", FaultKind.NOT_READY, "found its process ended, expected it ready")


def main(task: dict) -> None:
    """Serve until standard input ends."""
    clock, at = MonotonicClock(), Path(task["folder"])
    rig = EmulatedRig(**{**task["rig"], "hidden": tuple(task["rig"]["hidden"])})
    emulation = Emulation(rig, read_calibration(at / CALIBRATION), at, clock.now())
    emulation.line = PtyLine(emulation.board, at / LINE, at / PORT, rig.seed)
    os.set_blocking(0, False)
    with contextlib.closing(emulation), real_time(PRIORITY):
        ticks = Ticks(clock, PERIOD)
        print("ready", flush=True)
        end = None
        while end is None or clock.now() < end:
            if end is None and _ended():
                end = clock.now() + rig.lingers
            ticks.wait()
            emulation.serve(clock.now())


def _ended() -> bool:
    try:
        return not os.read(0, 1)
    except BlockingIOError:
        return False


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
