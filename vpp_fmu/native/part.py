"""A traced model as one part of a loop, moved from one communication point to the next: compiled, or as generated Python."""

import ctypes
from collections.abc import Sequence
from functools import partial
from importlib.resources import files

from vpp_fmu.kernel.schedule import DelayLine, run_held, run_sampled
from vpp_fmu.kernel.types import Model
from vpp_fmu.native.compiler import compiled
from vpp_fmu.tracer import c_source, python_source, trace


class CompiledPart:
    """A model's library, and the addresses of its functions for `loop.c`. CompilerMissing."""

    def __init__(self, model: Model):
        source = c_source(trace(model)) + (files("vpp_fmu.kernel") / "schedule.c").read_text()
        library = compiled(source + (files("vpp_fmu.native") / "part.c").read_text())
        functions = library.part_size, library.part_begin, library.part_advance
        self.addresses = tuple(ctypes.cast(function, ctypes.c_void_p).value for function in functions)


class InterpretedPart:
    """The same as generated Python: the same numbers, more slowly."""

    def __init__(self, model: Model):
        program = trace(model)
        self._model, self._layout, self._code = model, program.layout, {}
        exec(python_source(program), self._code)
        self._first, self._last = len(model.inputs), len(model.inputs) + len(model.outputs)

    def begin(self, parameters: Sequence[float], inputs: Sequence[float]) -> list[float]:
        """Start at rest on `inputs`; returns the outputs."""
        layout, model = self._layout, self._model
        self._v = [*inputs, *[0.0] * len(layout.outputs), *parameters, *[0.0] * len(layout.states)]
        self._delays, self._wait, self._prepared = [None] * self._first, 0.0, (None, None)
        for name, parameter in model.delays:
            self._delays[layout.inputs.index(name)] = self._v[layout.index["parameter", parameter]]
        self._lines = [None if delay is None else DelayLine(u) for u, delay in zip(inputs, self._delays, strict=True)]
        self._largest = self._code["largest_step"](self._v)
        if model.sample_time is not None:
            self._period = self._v[layout.index["parameter", model.sample_time]]
        self._code["start"](self._v, [])
        return self._v[self._first : self._last]

    def advance(self, inputs: Sequence[float], span: float) -> list[float]:
        """Hold `inputs` for `span` seconds; returns the outputs at the end. DelayFull if commands change too often."""
        if self._model.sample_time is None:
            run_held(self._lines, self._delays, list(inputs), span, self._largest, self._step)
        else:
            self._wait = run_sampled(self._wait, self._period, span, partial(self._step, inputs))
        return self._v[self._first : self._last]

    def _step(self, acting, dt):
        self._v[: self._first] = acting
        if self._prepared[0] != dt:
            self._prepared = dt, self._code["prepare"](self._v, dt, (0.0,) * len(self._model.delays))
        self._code["step"](self._v, self._prepared[1], [])
