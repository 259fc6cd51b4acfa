"""The studies' rig: physics in C (rig.c), compiled on first use; quantities normalised by the rig's own scales, time in s."""

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

FRAME = ("step", "slow", "full")
BASE = ("tau_w1", "tau_w2", "tau_b1", "tau_b2", "c20", "c11", "c21", "c12", "c30")

_COMMAND = "pitch_delay late_up deadband pitch_step travel_max travel_stop slew"
_PITCH = "deadzone stop_band stop restart speed_min speed_max rate pitch_asym stall_speed stall_time stall_band last_stage"
_LINKAGE = "friction torsion backlash warm"
_SUPPLY = "speed_max_w sag droop volt_gain volt_share discharge"
_SPEED = "speed_delay speed_last speed_asym damping ramp hunt_hz hunt_zeta coupling coupling_stiff"
_THRUST = "map_w map_w2b2 map_wb3 stall fade fade_time fade_load inflow inflow_time feedthrough wash wash_time"
_CELL = "ring_hz ring_zeta cell_time creep bias drift vibration reading_delay speed_late"
_UNLISTED = "servo_load gear gear_pitch esc_step drain drain_time torque torque_load coast notch parting surge untwist"
_UNLISTED += " untwist_time friction_cell bend"
OPTIONS = tuple(" ".join([_COMMAND, _PITCH, _LINKAGE, _SUPPLY, _SPEED, _THRUST, _CELL, _UNLISTED]).split())
"""Options of rig.c; 0 is off."""

PAPER = {"tau_w1": 0.172, "tau_w2": 0.053, "tau_b1": 0.2, "tau_b2": 0.07}
PAPER |= {"c20": 0.355, "c11": 0.064, "c21": 0.8, "c12": -0.16, "c30": -0.081}
"""The paper's fine-tuned set, with a faster pitch actuator."""

_TIMES = "tau_w1 tau_w2 tau_b1 tau_b2 pitch_delay late_up stall_time speed_delay coupling inflow_time feedthrough wash_time"
_TIMES += " surge untwist_time"
_RATES = "torque torque_load coast slew speed_min speed_max rate stall_speed ramp hunt_hz ring_hz"
POWER = dict.fromkeys(f"{_TIMES} cell_time reading_delay speed_late".split(), 1) | dict.fromkeys(_RATES.split(), -1)
"""Exponent of time in each setting that scales with how fast a rig is. Warming, discharge and creep have their own time."""


def in_time(settings: Mapping[str, float], slow: float) -> dict[str, float]:
    """Settings of a rig of the paper's speed on one that is `slow` times slower."""
    return {name: value * slow ** POWER[name] if name in POWER else value for name, value in settings.items()}


class _Rig(ctypes.Structure):
    _fields_ = [(name, ctypes.c_double) for name in (*FRAME, *BASE, *OPTIONS)]


@dataclass(frozen=True)
class Frame:
    """Integration and reading of a rig: `row` s from row to row, about `step` s of integration, `slow` times slower than the
    paper's rig, `full` speed [rpm]."""

    row: float
    step: float
    slow: float
    full: float


@dataclass(frozen=True)
class Run:
    """Signals of a run, without noise, each (rows,): speed, pitch and load-cell force, normalised; speed as the tachometer
    reads it [rpm]; revolutions since the start."""

    omega: np.ndarray
    beta: np.ndarray
    load: np.ndarray
    shown: np.ndarray
    turn: np.ndarray


def run(
    settings: Mapping[str, float],
    frame: Frame,
    w_ref: np.ndarray,
    b_ref: np.ndarray,
    angle: float = 0.3,
    jitter: np.ndarray | None = None,
) -> Run:
    """The rig under normalised commands (rows,). `angle`: that of the mark at the start [revolutions]; `jitter`: delay of each
    pulse of the mark [s], (pulses(...),) or longer."""
    unknown = set(settings) - {*BASE, *OPTIONS}
    if unknown:
        raise KeyError(*unknown)
    rows, sub = len(w_ref), int(np.ceil(frame.row / frame.step - 1e-9))
    jitter = np.zeros(pulses(frame, rows)) if jitter is None else jitter
    inputs = [np.ascontiguousarray(a, float) for a in (w_ref, b_ref)]
    outputs = [np.empty(rows) for _ in range(5)]
    own = {"step": frame.row / sub, "slow": frame.slow, "full": frame.full}
    rig = _Rig(**own, **{name: float(value) for name, value in settings.items()})
    late = np.ascontiguousarray(jitter, float)
    pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (*inputs, late, *outputs)]
    head = ctypes.byref(rig), ctypes.c_long(rows), ctypes.c_long(sub), *pointers[:2], ctypes.c_double(angle)
    _library().run(*head, ctypes.c_long(len(late)), *pointers[2:])
    return Run(*outputs)


def pulses(frame: Frame, rows: int) -> int:
    """An upper bound of the mark's pulses in a record of so many rows, including the time before it."""
    return int(1.5 * frame.full / 60.0 * (rows * frame.row + 2.0 * frame.slow)) + 100


@functools.cache
def _library() -> ctypes.CDLL:
    fields = " ".join(f"double {name};" for name in (*FRAME, *BASE, *OPTIONS))
    text = f"struct rig {{ {fields} }};\n{SOURCE.read_text()}"
    folder = Path(tempfile.gettempdir(), f"vpp-rig-{os.getuid()}")
    folder.mkdir(exist_ok=True)
    path = folder / f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.so"
    if not path.exists():
        made = path.with_suffix(f".{os.getpid()}")
        command = ["cc", "-O2", "-shared", "-fPIC", "-x", "c", "-", "-o", str(made), "-lm"]
        subprocess.run(command, input=text.encode(), check=True)
        made.replace(path)  # atomic, because another process may do the same
    return ctypes.CDLL(str(path))
