"""Commands, references and FMU handles that several test files share."""

import atexit
import json
from collections.abc import Mapping
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave, fmi2CallbackAllocateMemoryTYPE, fmi2CallbackFreeMemoryTYPE, fmi2CallbackFunctions
from fmpy.fmi2 import fmi2CallbackLoggerTYPE as Logger

from tests.studies.cases import WHOLE
from vpp_fmu.errors import BadInput, CompilerMissing
from vpp_fmu.export import native_fmu
from vpp_fmu.fmu import Fmu, FmuInstance
from vpp_fmu.invariants import random_steps, reference, slopes
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import BASE, LIBRARY, plant
from vpp_fmu.kernel.types import Effect, Model, Parameter
from vpp_fmu.native import Simulator
from vpp_fmu.native.compiler import compiler

__all__ = ["random_steps", "reference", "slopes"]

NO_COMPILER = ""
try:
    compiler()
except CompilerMissing as missing:
    NO_COMPILER = f"native FMUs: {missing}"
"""Why this machine compiles nothing; empty if it does."""
needs_compiler = pytest.mark.skipif(bool(NO_COMPILER), reason=NO_COMPILER or "there is a compiler")

OPTIONAL = tuple(e for e in LIBRARY if e.off is not None)
ALL_ON = plant(e.name for e in OPTIONAL)
FAST_PITCH = {"tau_beta_2": 0.05}
"""The paper tunes its controllers on the fine-tuned set with a faster pitch actuator (section 4.2)."""


def refusal(call, *arguments) -> str:
    """The message of the BadInput that a call must raise, in one line."""
    with pytest.raises(BadInput) as refused:
        call(*arguments)
    message = str(refused.value)
    assert "\n" not in message
    return message


def declared(path: Path, **entries) -> Path:
    """A rig.json with these entries."""
    path.write_text(json.dumps({"format": "vpp-rig/1", **entries}))
    return path


def named(effect: Effect, values: Mapping[str, float]) -> dict[str, float]:
    """An effect's values under their full names."""
    return {effect.full(name): value for name, value in values.items()}


PROBES = {name: value for e in OPTIONAL for name, value in named(e, e.probe).items()}
MODELS = {"plain": (BASE, {}), "all_on": (ALL_ON, PROBES), "controller": (CONTROLLER, {})}


def native(name: str, version: str = "2.0") -> bytes:
    """The native FMU of one of MODELS."""
    return native_fmu(*MODELS[name], version=version)


_simulators: dict[tuple, Simulator] = {}


def simulator(model: Model, wrt: tuple[str, ...] = ()) -> Simulator:
    """The simulator of a model, built once; models are distinguished by the names of their effects."""
    key = model.name, tuple(e.name for e in model.effects), wrt
    if key not in _simulators:
        _simulators[key] = Simulator(model, wrt)
    return _simulators[key]


def slope_errors(model: Model, values: Mapping[str, float], wrt, inputs, steps, smooth: float = 0.9) -> dict[str, float]:
    """Largest distance of each parameter's tangents from central differences, as a share of their size; of parameters that can
    be varied in both directions. At least a share `smooth` of the rows has a valid difference."""
    values, declared = model.values(values), {p.name: p for p in model.parameters}
    tangents = simulator(model, tuple(wrt)).sensitivities(values, inputs, steps)[1]
    errors = {}
    for j, name in enumerate(wrt):
        p = declared[name]
        if not p.choices and p.minimum < values[name] < p.maximum:
            numeric, valid, size = slopes(model, values, name, inputs, steps)
            assert valid.mean() > smooth, f"{name}: hardly a row where differences agree"
            errors[name] = float((np.where(valid, np.abs(tangents[:, :, j] - numeric), 0.0) / size).max())
    return errors


SHORT_CAMPAIGN = {"size": "paper", "rate": 100, "noise": "white", "level": 1.0, "strength": 1.0, "seconds": 20.0} | WHOLE
"""Factors of a campaign of the studies' emulator that has every file and takes a few seconds to diagnose."""


def shorten_tuning(change) -> None:
    """One search per controller, in one round, for tests of what is done with the gains. `change(name, value)` replaces an
    attribute."""
    change("identification.tune.tune.STARTS", (1.0,))
    change("identification.tune.tune.SHAKES", (0, 0))
    change("identification.tune.search.ROUNDS", 1)


def two_lags(t, tau_1: float, tau_2: float) -> np.ndarray:
    """Unit step response of two different lags in a row, 0 for t <= 0 (textbook form of eqs. 13 to 15)."""
    t = np.maximum(t, 0.0)
    return 1.0 - (tau_1 * np.exp(-t / tau_1) - tau_2 * np.exp(-t / tau_2)) / (tau_1 - tau_2)


def normalised(omega, beta):
    """Speed and pitch in the paper's units."""
    return omega / 6000.0, (beta + 5.0) / 15.0


def paper_map(omega, beta):
    """The paper's final thrust model, N."""
    w, b = normalised(omega, beta)
    return 15.0 * (0.355 * w**2 + 0.064 * w * b + 0.8 * w**2 * b - 0.16 * w * b**2 - 0.081 * w**3)


def steps_through(t, at, values, response) -> np.ndarray:
    """Response at `t` to a command that takes each of `values` at the time in `at`, at rest on the first before."""
    moved = np.diff(values, prepend=values[0])
    return values[0] + sum(move * response(t - when) for move, when in zip(moved, at, strict=True))


def speed_delay() -> Effect:
    """An effect from outside the package: dead time of the speed command."""
    delay = Parameter("delay", "s", 0.0, 0.0, 1.0, "dead time", 0.05)
    return Effect(
        "test_speed_delay",
        "dead time of the speed command",
        parameters=(delay,),
        off={"delay": 0.0},
        probe={"delay": 0.03},
        delays={"omega_ref": "delay"},
    )


TWO_DELAYS = plant(["pitch_delay", "test_speed_delay"], (*LIBRARY, speed_delay()))


def stepped(fmu: Fmu, inputs: Mapping[str, np.ndarray], dt: float = 0.004) -> np.ndarray:
    """Thrust, omega, beta (rows,) of an FMU: at the start, and after each step of `dt` seconds under held inputs."""
    instance = FmuInstance(fmu, list(inputs), ["thrust", "omega", "beta"])
    rows = np.column_stack(list(inputs.values())).tolist()
    shown, step = [instance.start(rows[0])], instance.stepper(dt)
    shown += [step(row) for row in rows[:-1]]
    instance.close()
    return np.array(shown)


class Slave:
    """An fmpy slave that keeps what the FMU logs and takes variables by name."""

    def __init__(self, fmu: Fmu, initialised: bool = True):
        self.messages: list[str] = []
        self.references = {name: v.valueReference for name, v in fmu.variables.items()}
        self.types = {name: v.type for name, v in fmu.variables.items()}
        identifier = fmu.description.coSimulation.modelIdentifier
        self.fmi = FMU2Slave(
            guid=fmu.description.guid, unzipDirectory=fmu.folder, modelIdentifier=identifier, instanceName=identifier
        )
        self._callbacks = fmi2CallbackFunctions()  # must outlive the instance
        self._callbacks.logger = Logger(lambda _env, _name, _status, _category, text: self.messages.append(text.decode()))
        self._callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
        self._callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(fmpy.free)
        self.fmi.instantiate(callbacks=self._callbacks, loggingOn=True)
        self.freed, self.time = False, 0.0
        atexit.register(self._at_end)  # an instance that outlives the interpreter's end takes the process down
        if initialised:
            self.initialise()

    def enter(self, **values: float) -> "Slave":
        """Enter the initialization mode and set these variables in it."""
        self.time = 0.0
        self.fmi.setupExperiment(startTime=0.0)
        self.fmi.enterInitializationMode()
        self.set(**values)
        return self

    def initialise(self, **values: float) -> "Slave":
        """The same, and leave the initialization mode."""
        self.enter(**values)
        self.fmi.exitInitializationMode()
        return self

    def set(self, **values: float) -> None:
        """Set variables."""
        for kind, convert in (("Real", float), ("Boolean", bool), ("Integer", int)):
            chosen = [name for name in values if self.types[name] == kind]
            if chosen:
                setter = getattr(self.fmi, f"set{kind}")
                setter([self.references[name] for name in chosen], [convert(values[name]) for name in chosen])

    def get(self, *names: str) -> list[float]:
        """Values of variables."""
        found = {}
        for kind in ("Real", "Boolean", "Integer"):
            chosen = [name for name in names if self.types[name] == kind]
            if chosen:
                getter = getattr(self.fmi, f"get{kind}")
                found |= zip(chosen, map(float, getter([self.references[name] for name in chosen])), strict=True)
        return [found[name] for name in names]

    def step(self, inputs: Mapping[str, float], dt: float, *names: str) -> list[float]:
        """Hold inputs for a step from the end of the last one; values of variables at its end."""
        self.set(**inputs)
        self.fmi.doStep(self.time, dt)
        self.time += dt
        return self.get(*names)

    def kept(self):
        """The state of the instance and its time."""
        return self.fmi.getFMUstate(), self.time

    def restore(self, kept) -> None:
        """Return to a kept state."""
        state, self.time = kept
        self.fmi.setFMUstate(state)

    def free(self) -> None:
        """Free the instance."""
        self.freed = True
        self.fmi.freeInstance()

    def _at_end(self) -> None:
        if not self.freed:
            self.fmi.fmi2FreeInstance(self.fmi.component)
