"""A traced model in this process, one step at a time: compiled, or without a compiler as generated Python."""

import ctypes
from collections.abc import Mapping, Sequence

from vpp_fmu.errors import CompilerMissing, SimulationFailed
from vpp_fmu.kernel.schedule import FULL, DelayFull
from vpp_fmu.kernel.types import Model
from vpp_fmu.native.part import CompiledPart, InterpretedPart
from vpp_fmu.native.simulator import _say_once


class Stepper:
    """The model with its parameter values: `start`, then `step` by step. `parameters`: changes to the defaults, by name.

    Inputs and outputs are in the model's order.
    """

    def __init__(self, model: Model, parameters: Mapping[str, float] | None = None):
        values = list(model.values(parameters).values())
        self._name = model.name
        try:
            self._compile(model, values)
        except CompilerMissing as missing:
            _say_once(str(missing))
            part = InterpretedPart(model)
            self.start = lambda inputs: part.begin(values, inputs)
            self._advance = part.advance

    def _compile(self, model: Model, values: Sequence[float]) -> None:
        part = model.memo["part"] = model.memo.get("part") or CompiledPart(model)
        size = ctypes.CFUNCTYPE(ctypes.c_long)(part.addresses[0])
        begin = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 4)(part.addresses[1])
        advance = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p)(
            part.addresses[2]
        )
        memory, given = ctypes.create_string_buffer(size()), (ctypes.c_double * len(model.inputs))()
        own, shown = (ctypes.c_double * len(values))(*values), (ctypes.c_double * len(model.outputs))()

        def start(inputs: Sequence[float]) -> list[float]:
            given[:] = inputs
            begin(memory, own, given, shown)
            return shown[:]

        def step(inputs: Sequence[float], span: float) -> list[float]:
            given[:] = inputs
            if not advance(memory, given, span, shown):
                raise DelayFull(FULL)
            return shown[:]

        self.start, self._advance = start, step

    def step(self, inputs: Sequence[float], dt: float) -> list[float]:
        """Hold the inputs for dt seconds; returns the outputs at the end. SimulationFailed."""
        try:
            return self._advance(inputs, dt)
        except DelayFull as full:
            raise SimulationFailed(f"{self._name}: {full}") from full
