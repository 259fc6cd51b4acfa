"""Many plants, each with its own parameters and commands, moved by one compiled call; without a compiler in Python."""

import ctypes
from importlib.resources import files

import numpy as np

from vpp_fmu.errors import CompilerMissing, SimulationFailed
from vpp_fmu.kernel.schedule import FULL, DelayFull
from vpp_fmu.kernel.types import Model
from vpp_fmu.native.compiler import compiled
from vpp_fmu.native.part import InterpretedPart
from vpp_fmu.native.simulator import _say_once
from vpp_fmu.tracer import c_lanes, c_source, trace


class ManyPlants:
    """`count` instances of a model, with one communication step `dt` [s]. Each instance's numbers are those of `Simulation`,
    to the bit, whatever the others do. Measured inputs of effects keep their start values."""

    def __init__(self, model: Model, count: int, dt: float):
        self.model, self.count, self.dt = model, count, dt
        self.outputs = tuple(s.name for s in model.outputs)
        self._inputs = np.zeros((count, len(model.inputs)))
        self._inputs[:, 2:] = list(model.measured_inputs.values())
        self._shown = np.zeros((count, len(self.outputs)))
        try:
            self._compile(model)
        except CompilerMissing as missing:
            _say_once(str(missing))
            self._library, self._parts = None, [InterpretedPart(model) for _ in range(count)]

    def _compile(self, model: Model) -> None:
        if "many" not in model.memo:
            program = trace(model)
            after = files("vpp_fmu.kernel") / "schedule.c", *(files("vpp_fmu.native") / name for name in ("part.c", "many.c"))
            model.memo["many"] = compiled("".join((c_source(program), c_lanes(program), *(p.read_text() for p in after))))
        self._library = library = model.memo["many"]
        size, vector, real = ctypes.c_long, np.ctypeslib.ndpointer(float, flags="C"), ctypes.c_double
        library.many_size.argtypes, library.many_size.restype = [size], size
        whole = np.ctypeslib.ndpointer(np.dtype("long"), flags="C")
        library.many_begin.argtypes = [ctypes.c_void_p, whole, size, vector, vector, real, vector]
        library.many_advance.argtypes = [ctypes.c_void_p, size, vector, real, size, vector]
        library.many_advance.restype = size
        self._memory = np.zeros(library.many_size(self.count) // 8)

    def begin(self, which: np.ndarray, parameters: np.ndarray, commands: np.ndarray) -> np.ndarray:
        """Start the instances `which` (some,) at rest on `commands` (some, 2) [rpm, deg] with `parameters` (some, parameters)
        in the model's order. Returns their outputs (some, outputs)."""
        self._inputs[which, :2] = commands
        shown, inputs = np.empty((len(which), len(self.outputs))), self._inputs[which]
        if self._library is None:
            for k, n in enumerate(which.tolist()):
                shown[k] = self._parts[n].begin(parameters[k].tolist(), inputs[k].tolist())
            return shown
        rows = np.ascontiguousarray(parameters, float)
        at = np.ascontiguousarray(which, np.dtype("long"))
        self._library.many_begin(self._memory.ctypes.data, at, len(which), rows, inputs, self.dt, shown)
        return shown

    def advance(self, commands: np.ndarray, hold: int = 1) -> np.ndarray:
        """Hold `commands` (count, 2) [rpm, deg] for `hold` steps. Returns the outputs (count, outputs) at their end; the next
        call overwrites them. SimulationFailed: a delay has no room for more changes."""
        self._inputs[:, :2] = commands
        if self._library is None:
            return self._advance_parts(hold)
        done = self._library.many_advance(self._memory.ctypes.data, self.count, self._inputs, self.dt, hold, self._shown)
        if done < self.count:
            raise SimulationFailed(f"{self.model.name} {done}: {FULL}")
        return self._shown

    def _advance_parts(self, hold: int) -> np.ndarray:
        for n, part in enumerate(self._parts):
            try:
                for _ in range(hold):
                    self._shown[n] = part.advance(self._inputs[n].tolist(), self.dt)
            except DelayFull as full:
                raise SimulationFailed(f"{self.model.name} {n}: {full}") from full
        return self._shown
