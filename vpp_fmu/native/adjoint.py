"""Gradients over whole records by reverse mode: all parameters at the cost of a few simulations."""

import ctypes
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from vpp_fmu.errors import CompilerMissing, SimulationFailed
from vpp_fmu.kernel.schedule import FULL
from vpp_fmu.kernel.types import Model
from vpp_fmu.native.compiler import compiled
from vpp_fmu.native.simulator import completed, rows_source
from vpp_fmu.tracer import c_source, trace
from vpp_fmu.tracer.adjoints import c_adjoints

FAILURES = {-1: "out of memory", -2: FULL}


class Adjoint:
    """A model ready for gradients in the parameters `wrt` (default: all). CompilerMissing: no C compiler."""

    def __init__(self, model: Model, wrt: Iterable[str] | None = None):
        names = [p.name for p in model.parameters]
        self.model, self.wrt = model, tuple(names if wrt is None else wrt)
        self._chosen = [_position(names, name) for name in self.wrt]
        self._inputs = [s.name for s in model.inputs]
        self._record, self._pull_back = _compiled(model)
        self._entry = len(model.inputs) + len(model.states) + 1 + len(model.delays)
        self._a_row = 1.0  # entries per row; grows when steps are cut

    def record(
        self, parameters: Mapping[str, float], inputs: Mapping[str, np.ndarray], steps: np.ndarray, late: float = 0.0
    ) -> "Tape":
        """Run a record (arguments as `Simulator.simulate`) and store the data for the reverse sweep, linear in the steps."""
        values = np.array(list(self.model.values(parameters).values()))
        inputs = completed(self.model, inputs, steps)
        columns = np.column_stack([inputs[name] for name in self._inputs]).astype(float, order="C", copy=False)
        if len(steps) != len(columns) - 1:
            raise SimulationFailed(f"{self.model.name}: steps: found {len(steps)}, expected {len(columns) - 1}")
        steps, n = np.ascontiguousarray(steps, float), len(columns)
        outputs, taken = np.empty((n, len(self.model.outputs))), np.empty(n, ctypes.c_long)
        room, entries = 0, int(self._a_row * n)
        while room < entries:
            room = entries
            tape = np.empty((room, self._entry))
            entries = self._record(values, columns, steps, late, n, outputs, tape, room, taken)
            if entries < 0:
                raise SimulationFailed(f"{self.model.name}: {FAILURES[entries]}")
        self._a_row = max(self._a_row, entries / n)
        return Tape(outputs, self, values, columns, tape, taken)

    def gradient(self, parameters, inputs, steps, cotangents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(outputs (rows, outputs), derivatives (wrt,) of the sum of `cotangents` (rows, outputs) times outputs)."""
        tape = self.record(parameters, inputs, steps)
        return tape.outputs, tape.pull_back(cotangents)


@dataclass(frozen=True, eq=False)
class Tape:
    """A simulated record: its `outputs` (rows, outputs), and the reverse sweep, which can be repeated."""

    outputs: np.ndarray
    _adjoint: Adjoint
    _values: np.ndarray
    _inputs: np.ndarray
    _entries: np.ndarray
    _taken: np.ndarray

    def pull_back(self, cotangents: np.ndarray) -> np.ndarray:
        """Derivatives (wrt,) of the sum of `cotangents` (rows, outputs) times outputs; exact to rounding."""
        adjoint, weights = self._adjoint, np.empty_like(self.outputs)
        weights[:] = cotangents
        gradient = np.empty(len(adjoint.model.parameters))
        adjoint._pull_back(self._values, self._inputs, len(weights), self._entries, self._taken, weights, gradient)
        return gradient[adjoint._chosen]


def _position(names: list[str], name: str) -> int:
    if name not in names:
        raise KeyError(name)
    return names.index(name)


def _compiled(model: Model):
    program = trace(model)
    texts = [c_source(program), c_adjoints(program), "#define OBSERVED\n"]
    texts += [rows_source(model), (files("vpp_fmu.native") / "adjoint.c").read_text()]
    try:
        library = compiled("".join(texts))
    except CompilerMissing as missing:
        raise CompilerMissing(f"{missing}: the adjoint gradient needs one") from missing
    vector, whole = np.ctypeslib.ndpointer(float, flags="C"), np.ctypeslib.ndpointer(ctypes.c_long, flags="C")
    record, back, count = library.record_tape, library.pull_back, ctypes.c_long
    record.restype, record.argtypes = count, [vector, vector, vector, ctypes.c_double, count, vector, vector, count, whole]
    back.restype, back.argtypes = None, [vector, vector, count, vector, whole, vector, vector]
    return record, back
