"""Commands, references and FMU handles that several test files share."""

import atexit
from collections.abc import Mapping

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave, fmi2CallbackAllocateMemoryTYPE, fmi2CallbackFreeMemoryTYPE, fmi2CallbackFunctions
from fmpy.fmi2 import fmi2CallbackLoggerTYPE as Logger

from vpp_fmu.fmu import Fmu
from vpp_fmu.kernel.plant import BASE, LIBRARY, plant
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.kernel.types import Effect, Model, Parameter
from vpp_fmu.native import Simulator

OPTIONAL = tuple(e for e in LIBRARY if e.off is not None)
ALL_ON = plant(e.name for e in OPTIONAL)
FAST_PITCH = {"tau_beta_2": 0.05}
"""The paper tunes its controllers on the fine-tuned set with a faster pitch actuator (section 4.2)."""


def named(effect: Effect, values: Mapping[str, float]) -> dict[str, float]:
    """An effect's values under their full names."""
    return {effect.full(name): value for name, value in values.items()}


PROBES = {name: value for e in OPTIONAL for name, value in named(e, e.probe).items()}


def random_steps(rows: int, hold: int, seed: int = 0, model: Model = BASE) -> dict[str, np.ndarray]:
    """Speed and pitch commands over the rig's whole range, each held for 1 to `hold` rows; any other input of the model
    wanders by a tenth around its nominal value."""
    rng = np.random.default_rng(seed)

    def steps(low, high):
        lengths = rng.integers(1, hold + 1, rows)
        return np.repeat(rng.uniform(low, high, rows), lengths)[:rows]

    ranges = {"omega_ref": (2000.0, 6000.0), "beta_ref": (-5.0, 10.0)}
    return {u.name: steps(*ranges.get(u.name, (0.9 * u.nominal, 1.1 * u.nominal))) for u in model.inputs}


def reference(model: Model, parameters: Mapping[str, float], inputs: Mapping[str, np.ndarray], steps) -> np.ndarray:
    """What `Simulator.simulate` returns, from the model's functions as they stand."""
    simulation = Simulation(model, parameters)
    names = [s.name for s in model.inputs]
    rows = list(zip(*(np.asarray(inputs[name]).tolist() for name in names), strict=True))
    shown = [list(simulation.start(dict(zip(names, rows[0], strict=True))).values())]
    for row, dt in zip(rows, np.asarray(steps).tolist(), strict=False):
        shown.append(list(simulation.advance(dict(zip(names, row, strict=True)), dt).values()))
    return np.array(shown)


_simulators: dict[tuple, Simulator] = {}


def simulator(model: Model, wrt: tuple[str, ...] = ()) -> Simulator:
    """The model's simulator, made once; a model is known by its effects' names."""
    key = model.name, tuple(e.name for e in model.effects), wrt
    if key not in _simulators:
        _simulators[key] = Simulator(model, wrt)
    return _simulators[key]


def slopes(model: Model, values: Mapping[str, float], name: str, inputs, steps):
    """Numeric derivatives of the outputs in a parameter: (central differences, where they are to be trusted, their size).

    A row is trusted where the curve is smooth: both one-sided differences agree, and so do those at h and h / 4. What
    switches at a threshold is flat in it between switches.
    """
    nominal = next(p.nominal for p in model.parameters if p.name == name)
    h = 1e-5 * max(abs(values[name]), 1e-2 * nominal)
    small = 2e-3 * np.array([s.nominal for s in model.outputs]) / nominal

    def at(change):
        return simulator(model).simulate({**values, name: values[name] + change}, inputs, steps)

    below, here, above = at(-h), at(0.0), at(h)
    wide, narrow = (above - below) / (2.0 * h), (at(h / 4.0) - at(-h / 4.0)) / (h / 2.0)
    size = np.abs(narrow).max(axis=0) + small
    smooth = (np.abs(above - 2.0 * here + below) / h < 1e-2 * size) & (np.abs(wide - narrow) < 1e-3 * size)
    return wide, smooth, size


def two_lags(t, tau_1: float, tau_2: float) -> np.ndarray:
    """Unit step response of two different lags in a row, 0 for t <= 0 (textbook form of eqs. 13 to 15)."""
    t = np.maximum(t, 0.0)
    return 1.0 - (tau_1 * np.exp(-t / tau_1) - tau_2 * np.exp(-t / tau_2)) / (tau_1 - tau_2)


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


class Slave:
    """A bare fmpy slave that keeps what the FMU logs. Value references go by name."""

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

    def initialise(self, **values: float) -> "Slave":
        """Through the initialisation with these variables set in it."""
        self.time = 0.0
        self.fmi.setupExperiment(startTime=0.0)
        self.fmi.enterInitializationMode()
        self.set(**values)
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
        """Hold inputs for a step from where the last one ended; values of variables at its end."""
        self.set(**inputs)
        self.fmi.doStep(self.time, dt)
        self.time += dt
        return self.get(*names)

    def kept(self):
        """The instance's state, and the time that goes with it."""
        return self.fmi.getFMUstate(), self.time

    def restore(self, kept) -> None:
        """Back to what was kept."""
        state, self.time = kept
        self.fmi.setFMUstate(state)

    def free(self) -> None:
        """Let the instance go."""
        self.freed = True
        self.fmi.freeInstance()

    def _at_end(self) -> None:
        if not self.freed:
            self.fmi.fmi2FreeInstance(self.fmi.component)
