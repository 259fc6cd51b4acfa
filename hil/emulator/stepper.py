"""A model advanced step by step from its present state: compiled, or without a compiler by its functions in Python."""

import ctypes
import weakref
from collections.abc import Mapping, Sequence
from importlib.resources import files

from vpp_fmu.errors import CompilerMissing, SimulationFailed
from vpp_fmu.kernel.schedule import FULL
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.kernel.types import Model
from vpp_fmu.native.compiler import compiled
from vpp_fmu.tracer import c_source, trace

MOST = 4096
"""Largest number of steps in one call."""


class Stepper:
    """A model with its parameters (changes to the defaults), settled at `inputs`, by name. `is_compiled`: not interpreted."""

    def __init__(self, model: Model, parameters: Mapping[str, float], inputs: Mapping[str, float]):
        self.model = model
        self.outputs = tuple(s.name for s in model.outputs)
        try:
            self.advance, self.is_compiled = _compiled(self, parameters, inputs), True
        except CompilerMissing:
            self.advance, self.is_compiled = _interpreted(model, parameters, inputs), False

    def advance(self, inputs: Sequence[float], dt: float, count: int) -> list[list[float]]:
        """`count` (1 to MOST) steps of dt [s] under `inputs`, in the model's order; the outputs at the end of each."""
        raise NotImplementedError("chosen at the start")


def _compiled(owner: Stepper, parameters: Mapping[str, float], inputs: Mapping[str, float]):
    model = owner.model
    text = c_source(trace(model)) + (files("vpp_fmu.kernel") / "schedule.c").read_text()
    library = compiled(text + (files("hil.emulator") / "stepper.c").read_text())
    library.begin.restype, library.end.restype = ctypes.c_void_p, None
    n_in, n_out = len(model.inputs), len(model.outputs)
    values = list(model.values(parameters).values())
    held, shown = (ctypes.c_double * n_in)(*(inputs[s.name] for s in model.inputs)), (ctypes.c_double * (n_out * MOST))()
    instance = ctypes.c_void_p(library.begin((ctypes.c_double * len(values))(*values), held))
    if not instance:
        raise MemoryError
    weakref.finalize(owner, library.end, instance)
    step, count_of, step_of = library.advance, ctypes.c_long, ctypes.c_double

    def advance(inputs, dt, count):
        held[:] = inputs
        if not step(instance, held, step_of(dt), count_of(count), shown):
            raise SimulationFailed(f"{model.name}: {FULL}")
        return [shown[k : k + n_out] for k in range(0, count * n_out, n_out)]

    return advance


def _interpreted(model: Model, parameters: Mapping[str, float], inputs: Mapping[str, float]):
    simulation, names = Simulation(model, parameters), [s.name for s in model.inputs]
    simulation.start(inputs)

    def advance(inputs, dt, count):
        held = dict(zip(names, inputs, strict=True))
        return [list(simulation.advance(held, dt).values()) for _ in range(count)]

    return advance
