"""The control loop over two FMU instances in one compiled function; the numbers equal those of `vpp_fmu.loop` to the bit."""

import ctypes
from collections.abc import Callable
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from vpp_fmu.native.compiler import compiled

CHUNK = 1000
"""Communication points between two returns to Python, which handle signals and report progress."""


class Entry(NamedTuple):
    """An FMI 2.0 instance in initialised state, as C sees it: addresses of the instance, of fmi2SetReal, fmi2DoStep and
    fmi2GetReal, of the value references of inputs and outputs; their numbers; addresses of their values."""

    instance: int
    set_real: int
    do_step: int
    get_real: int
    inputs: int
    outputs: int
    n_inputs: int
    n_outputs: int
    given: int
    shown: int


class _Side(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_size_t if name.startswith("n_") else ctypes.c_void_p) for name in Entry._fields)


class Failed(NamedTuple):
    """A failed step: its side (0: controller, 1: plant), communication point and FMI status."""

    side: int
    point: int
    status: int


def run_together(
    controller: Entry, plant: Entry, wanted: np.ndarray, dt: float, progress: Callable[[float], None]
) -> np.ndarray | Failed:
    """Rows (points, 5) of speed and pitch command [rpm, deg], thrust [N], speed [rpm] and pitch [deg] at each communication
    point, `dt` seconds apart, under `wanted` thrust (points,) N; or the failure. CompilerMissing.

    The plant is at rest and the controller new; inputs and outputs are in the order of `vpp_fmu.plants`.
    """
    run, count = _run_master(), len(wanted)
    sides = (_Side * 2)(_Side(*controller), _Side(*plant))
    wanted = np.ascontiguousarray(wanted, float)
    rows = np.empty((count, controller.n_outputs + plant.n_outputs))
    at, side = ctypes.c_long(), ctypes.c_int()
    for first in range(0, count, CHUNK):
        last = min(first + CHUNK, count)
        numbers = (ctypes.c_double(dt), first, last, count)
        status = run(sides, wanted.ctypes.data, *numbers, rows.ctypes.data, ctypes.byref(at), ctypes.byref(side))
        if status:
            return Failed(side.value, at.value, status)
        progress(first / count)
    return rows


@cache
def _run_master():
    function = compiled((files("vpp_fmu.native") / "master.c").read_text()).run_master
    pointer, number = ctypes.c_void_p, ctypes.c_long
    function.argtypes = [pointer, pointer, ctypes.c_double, number, number, number, pointer, pointer, pointer]
    return function
