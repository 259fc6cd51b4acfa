"""The studies' rig: physics in C (rig.c), compiled on first use; all quantities normalised as in the paper, time in s."""

import ctypes
import functools
import hashlib
import os
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SOURCE = Path(__file__).parent / "rig.c"

STEP = 0.0005
"""Of the rig's own integration, s."""

ROW = 0.004
"""From row to row of a record, s."""

BASE = ("tau_w1", "tau_w2", "tau_b1", "tau_b2", "c20", "c11", "c21", "c12", "c30")

_COMMAND = "pitch_delay late_up deadband pitch_step travel_max travel_stop slew"
_PITCH = "deadzone stop_band stop restart speed_min speed_max rate pitch_asym stall_speed stall_time stall_band last_stage"
_LINKAGE = "friction torsion backlash warm"
_SUPPLY = "speed_max_w sag droop volt_gain volt_share discharge"
_SPEED = "speed_delay speed_last speed_asym damping ramp hunt_hz hunt_zeta coupling coupling_stiff"
_THRUST = "map_w map_w2b2 map_wb3 stall fade fade_time fade_load inflow inflow_time feedthrough wash wash_time"
_CELL = "ring_hz ring_zeta cell_time creep bias drift"
OPTIONS = tuple(" ".join([_COMMAND, _PITCH, _LINKAGE, _SUPPLY, _SPEED, _THRUST, _CELL]).split())
"""What can be switched on in rig.c; 0 is off."""

PAPER = {"tau_w1": 0.172, "tau_w2": 0.053, "tau_b1": 0.2, "tau_b2": 0.07}
PAPER |= {"c20": 0.355, "c11": 0.064, "c21": 0.8, "c12": -0.16, "c30": -0.081}
"""The paper's fine-tuned set, with a faster pitch actuator."""


class _Rig(ctypes.Structure):
    _fields_ = [(name, ctypes.c_double) for name in (*BASE, *OPTIONS)]


@dataclass(frozen=True)
class Run:
    """What happened, without noise, each (rows,): speed, pitch and load-cell force, normalised; speed as the tachometer
    shows it [rpm]; revolutions since the start."""

    omega: np.ndarray
    beta: np.ndarray
    load: np.ndarray
    shown: np.ndarray
    turn: np.ndarray


def run(settings: Mapping[str, float], w_ref: np.ndarray, b_ref: np.ndarray, jitter: np.ndarray | None = None) -> Run:
    """The rig under normalised commands (rows,). `jitter` [s]: by what each pulse of the mark comes late."""
    unknown = set(settings) - {*BASE, *OPTIONS}
    if unknown:
        raise KeyError(*unknown)
    rows, pulses = len(w_ref), 300 * round(ROW * len(w_ref) + 4.0)
    jitter = np.zeros(pulses) if jitter is None else np.resize(jitter, pulses)
    inputs = [np.ascontiguousarray(a, float) for a in (w_ref, b_ref)]
    outputs = [np.empty(rows) for _ in range(5)]
    rig = _Rig(**{name: float(value) for name, value in settings.items()})
    pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (*inputs, np.ascontiguousarray(jitter), *outputs)]
    head = ctypes.byref(rig), ctypes.c_long(rows), ctypes.c_long(round(ROW / STEP)), *pointers[:2], ctypes.c_double(0.3)
    _library().run(*head, *pointers[2:])
    return Run(*outputs)


@functools.cache
def _library() -> ctypes.CDLL:
    fields = " ".join(f"double {name};" for name in (*BASE, *OPTIONS))
    text = f"struct rig {{ {fields} }};\n{SOURCE.read_text()}"
    folder = Path(tempfile.gettempdir(), f"vpp-rig-{os.getuid()}")
    folder.mkdir(exist_ok=True)
    path = folder / f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.so"
    if not path.exists():
        made = path.with_suffix(f".{os.getpid()}")
        command = ["cc", "-O2", "-shared", "-fPIC", "-x", "c", "-", "-o", str(made), "-lm"]
        subprocess.run(command, input=text.encode(), check=True)
        made.replace(path)  # at once: another process may be doing the same
    return ctypes.CDLL(str(path))
