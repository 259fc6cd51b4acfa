"""Emulated rigs, rows of logs and profiles that several test files share."""

import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from hil.devices.calibration import read_calibration
from hil.emulator.rig import LINE, virtual_bench
from hil.emulator.rig import EmulatedRig as Emulated
from hil.emulator.serial_line import FAULTS
from hil.emulator.shared import SharedNumbers
from hil.loop.columns import COLUMNS
from hil.loop.rig import RigPlant
from hil.loop.session import Setup
from hil.safety.limits import Limits
from vpp_fmu.files import OutputFolder
from vpp_fmu.record import Record, write_record

ROOT = Path(__file__).parents[2]
CALIBRATION = read_calibration(ROOT / "hil" / "emulator" / "calibration.json")
LIMITS = Limits()


def setup(emulated=None, **more) -> Setup:
    """An emulated rig in virtual time."""
    return Setup(CALIBRATION, LIMITS, emulated or Emulated(seed=1), virtual=True, **more)


class Rows:
    """A log that keeps its rows by column."""

    def __init__(self, columns):
        self._names, self.rows, self.events, self.broken, self.warning = [c.name for c in columns], [], [], "", ""
        self.done = 0.0

    def put(self, *row):
        self.rows.append(row)

    def note(self, event):
        self.events.append(event)

    def __getitem__(self, name):
        return np.array([row[self._names.index(name)] for row in self.rows], float)


def virtual_rig(emulated=None, limits=LIMITS, columns=COLUMNS, **more):
    """(rig, its log) in virtual time."""
    log = Rows(columns)
    return RigPlant(virtual_bench(emulated or Emulated(seed=1), CALIBRATION), limits, log, **more), log


def transitions(rig) -> list[tuple[float, str, str]]:
    """(time [s], state, why) of a rig's events."""
    return [(event["time"], event["state"], event["why"]) for event in rig.events if "state" in event]


def steps(rig, count, omega_ref=3000.0) -> None:
    """Hold commands for `count` ticks."""
    for _ in range(count):
        rig.step(omega_ref, 2.0)


def serial_faults(rig) -> SharedNumbers:
    """The faults of the emulated rig's serial line, to be set."""
    return SharedNumbers(rig.bench.esc.duty_file.parents[3] / LINE, FAULTS)


def duties(rig) -> tuple[int, int]:
    """Duty of the ESC's and the LAC's output [ns]."""
    files = (rig.bench.esc.duty_file, rig.bench.lac.duty_file)
    return tuple(int(file.read_text().split()[0]) for file in files)


IDLE = (round(1e9 * CALIBRATION.esc_idle), round(1e9 * CALIBRATION.lac_idle))


def within(seconds, reached):
    """The result of `reached()` once it is true; a shared machine may take its time."""
    deadline = time.monotonic() + seconds
    while not (found := reached()):
        assert time.monotonic() < deadline
        time.sleep(0.002)
    return found


def step_profile(first=1.5, second=12.0, hold=2.0) -> Record:
    """The paper's step, up and down."""
    return Record({"time": hold * np.arange(4.0), "thrust_set": np.array([first, second, first, first])}, "step")


def begun(folder, hold, *words) -> subprocess.Popen:
    """`vpp hil run` over `step_profile` in real time, in a separate process; its files are in `folder`/out."""
    profile = write_record(OutputFolder(folder), "step.csv", step_profile(hold=hold))
    command = [sys.executable, "-m", "tests.hil.quick_vpp", "hil", "run", "--profile", str(profile), *words]
    own = {"env": {**os.environ, "PYTHONPATH": str(ROOT)}, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([*command, "-o", str(folder / "out")], **own)


def asked(fault):
    """Signals that request `fault`, or nothing."""
    return SimpleNamespace(asked=fault)
