"""Plants and controllers: the same loop runs the kernel's functions, FMUs, an emulated rig or the real one."""

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from vpp_fmu.errors import BadInput
from vpp_fmu.fmu import Fmu, FmuInstance
from vpp_fmu.kernel.controller import CONTROLLER, speed_alone
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.kernel.types import Model
from vpp_fmu.record import Record

COMMANDS = ("omega_ref", "beta_ref")
MEASURED = ("thrust", "omega", "beta")
WANTED = ("thrust_set", "thrust")

USUAL_STEP = 0.004
"""Default communication step, s."""


class Sample(NamedTuple):
    """Outputs of a plant at one instant: thrust [N], rotor speed [rpm], blade pitch [deg]."""

    thrust: float
    omega: float
    beta: float


class Plant(Protocol):
    """Takes commands [rpm, deg] and returns its outputs, one communication step `dt` [s] at a time."""

    dt: float

    def start(self, omega_ref: float, beta_ref: float) -> Sample:
        """Start at rest on the commands, at time 0."""

    def step(self, omega_ref: float, beta_ref: float) -> Sample:
        """Hold the commands for one step; returns the outputs at its end."""

    def close(self) -> None:
        """Release all resources."""


class Controller(Protocol):
    """Takes wanted and measured thrust [N], returns commands [rpm, deg] for the next step. `limits`: of each command, as from
    `limits_of`."""

    limits: dict[str, tuple[float, float]]

    def start(self, thrust_set: float, thrust: float) -> None:
        """Reset the states."""

    def step(self, thrust_set: float, thrust: float) -> tuple[float, float]:
        """The commands from now on."""

    def close(self) -> None:
        """Release all resources."""


class KernelPlant:
    """The plant's functions in Python. `parameters`: changes to the defaults, by name."""

    def __init__(self, model: Model = BASE, parameters: Mapping[str, float] | None = None, dt: float = 0.004):
        self.dt, self._simulation = dt, Simulation(model, parameters)

    def start(self, omega_ref, beta_ref):
        return self._sample(self._simulation.start({"omega_ref": omega_ref, "beta_ref": beta_ref}))

    def step(self, omega_ref, beta_ref):
        return self._sample(self._simulation.advance({"omega_ref": omega_ref, "beta_ref": beta_ref}, self.dt))

    @staticmethod
    def _sample(outputs: Mapping[str, float]) -> Sample:
        return Sample(*(outputs[name] for name in Sample._fields))

    def close(self):
        pass


def limits_of(values: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """(least, greatest) of each command [rpm], [deg] from a controller's parameter values; empty if these have no limits. In
    speed-only mode the pitch has one value."""
    if not all(f"{u}_{end}" in values for u in ("omega", "beta") for end in ("min", "max")):
        return {}
    fixed = speed_alone(values)
    pitch = 2 * (values["beta_fixed"],) if fixed else (values["beta_min"], values["beta_max"])
    return dict(zip(COMMANDS, ((values["omega_min"], values["omega_max"]), pitch), strict=True))


class KernelController:
    """The controller's functions in Python, or those of another `model` with its inputs and outputs, such as a policy's.
    `limits`: of each command, as from `limits_of`; `sample_time` s."""

    def __init__(self, parameters: Mapping[str, float] | None = None, dt: float = 0.004, model: Model = CONTROLLER):
        self._dt, self._simulation = dt, Simulation(model, parameters)
        self.limits, self.sample_time = limits_of(self._simulation.parameters), self._simulation.parameters["sample_time"]

    def start(self, thrust_set, thrust):
        self._simulation.start({"thrust_set": thrust_set, "thrust": thrust})

    def step(self, thrust_set, thrust):
        commands = self._simulation.advance({"thrust_set": thrust_set, "thrust": thrust}, self._dt)
        return commands["omega_ref"], commands["beta_ref"]

    def close(self):
        pass


class _FmuRole:
    """An FMU file with one `instance` at a time. `start` makes a new one, since FMI 2.0 cannot restart an instance."""

    word: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def __init__(self, path: str | Path, parameters: Mapping[str, float] | None = None, dt: float = 0.004):
        self.dt, self._parameters = dt, dict(parameters or {})
        self._fmu, self.instance, self._step = Fmu(path), None, None
        self.path = self._fmu.path
        self._ready: FmuInstance | None = None
        try:
            self._check_role(path)
            for names, causality in ((self.inputs, "input"), (self.outputs, "output"), (self._parameters, "parameter")):
                self._fmu.references(names, causality)
            self._fmu.check_first_step(dt)
        except BadInput:
            self._fmu.close()
            raise

    def _check_role(self, path: str | Path) -> None:
        """BadInput if the FMU takes and gives the signals of the other role."""
        causalities = {name: variable.causality for name, variable in self._fmu.variables.items()}
        for other in (FmuPlant, FmuController):
            swapped = dict.fromkeys(other.inputs, "input") | dict.fromkeys(other.outputs[:1], "output")
            if other is not type(self) and all(causalities.get(name) == c for name, c in swapped.items()):
                takes = f"a {other.word} FMU, which takes {', '.join(other.inputs)}"
                allowed = f"a {self.word} FMU, which takes {', '.join(self.inputs)}"
                raise BadInput(path, "role", takes, allowed, "the two FMUs in the other order")

    def _restart(self, values):
        ready = self._ready or self._made()
        if self.instance:
            self.instance.close()
        self.instance, self._ready = ready, None
        shown = self.instance.start(values)
        self._step = self.instance.stepper(self.dt)
        return shown

    def _made(self):
        return FmuInstance(self._fmu, self.inputs, self.outputs, self._parameters)

    def prepare(self) -> None:
        """Make the instance for the next `start` in advance, which is then fast."""
        self._ready = self._ready or self._made()

    def starts(self) -> dict[str, float]:
        """Start values of its numeric parameters, by name."""
        found = {}
        for variable in self._fmu.variables.values():
            if variable.causality == "parameter":
                with contextlib.suppress(TypeError, ValueError):
                    text = str(variable.start)
                    found[variable.name] = float(text == "true") if text in ("true", "false") else float(text)
        return found

    def close(self):
        for instance in (self.instance, self._ready):
            if instance:
                instance.close()
        self._fmu.close()


class FmuPlant(_FmuRole):
    """A plant FMU of either flavour, or any other with the same variables."""

    word, inputs, outputs = "plant", COMMANDS, MEASURED

    def start(self, omega_ref, beta_ref):
        return Sample._make(self._restart((omega_ref, beta_ref)))

    def step(self, omega_ref, beta_ref):
        return Sample._make(self._step((omega_ref, beta_ref)))


class FmuController(_FmuRole):
    """A controller FMU. `limits`: of each command, as from `limits_of`; none if its parameters have none. `sample_time` s: its
    own, None if it has none; `dt` None: the same."""

    word, inputs, outputs = "controller", WANTED, COMMANDS

    def __init__(self, path: str | Path, parameters: Mapping[str, float] | None = None, dt: float | None = USUAL_STEP):
        super().__init__(path, parameters, 0.0 if dt is None else dt)
        speed = self._fmu.variables.get("omega")
        if speed is not None and speed.causality == "input":
            self.close()
            raise BadInput(path, "inputs", "omega", "thrust_set, thrust: this loop hands over no speed")
        values = {**self.starts(), **self._parameters}
        self.limits, self.sample_time = limits_of(values), values.get("sample_time")
        if dt is None:
            self.dt = self.sample_time or USUAL_STEP

    def start(self, thrust_set, thrust):
        self._restart((thrust_set, thrust))

    def step(self, thrust_set, thrust):
        return self._step((thrust_set, thrust))


class FmuTwin:
    """An adaptive twin FMU. It does not act on the loop, so its outputs are computed from the loop's record."""

    inputs = (*COMMANDS, "thrust", "omega")
    needed = ("predicted_thrust", "predicted_speed", "residual", "band", "alarm", "direction", "changes")

    def __init__(self, path: str | Path, dt: float = 0.004):
        self._fmu = Fmu(path)
        try:
            self._fmu.references(self.inputs, "input")
            self._fmu.references(self.needed, "output")
            self._fmu.check_first_step(dt)
        except BadInput:
            self._fmu.close()
            raise
        self.outputs = tuple(v.name for v in self._fmu.variables.values() if v.causality == "output")
        self.units = {v.name: v.unit or "1" for v in self._fmu.variables.values()}

    def beside(self, record: Record, rest: tuple[float, float]) -> dict[str, np.ndarray]:
        """Its outputs (rows,) for a loop's record, whose commands act from each row on. Before, the plant is at rest on the
        commands `rest` [rpm, deg]. SimulationFailed."""
        instance = FmuInstance(self._fmu, self.inputs, self.outputs)
        try:
            given = np.column_stack([record[name] for name in self.inputs]).tolist()
            instance.start([*rest, *given[0][2:]])
            stepped = instance.stepper(record.period)
            rows = np.array([stepped(row) for row in given])
        finally:
            instance.close()
        return dict(zip(self.outputs, rows.T, strict=True))

    def close(self) -> None:
        """Release all resources."""
        self._fmu.close()
