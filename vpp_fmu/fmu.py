"""FMI 2.0 co-simulation FMUs in this process: loaded by fmpy, stepped through calls that are bound once.

fmpy's own wrapper converts every argument of every call; here the buffers are made once, and a step is three foreign calls.
"""

import ctypes
import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import fmpy
from fmpy.fmi2 import FMU2Slave, fmi2CallbackAllocateMemoryTYPE, fmi2CallbackFreeMemoryTYPE, fmi2CallbackFunctions
from fmpy.fmi2 import fmi2CallbackLoggerTYPE as Logger

from vpp_fmu.errors import BadInput, SimulationFailed

STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")


class Fmu:
    """An unpacked FMU file. `instance` may be called many times; `close` removes what was unpacked."""

    def __init__(self, path: str | Path):
        self.path = Path(path)
        try:
            self.description = fmpy.read_model_description(str(path))
            if self.description.fmiVersion != "2.0" or self.description.coSimulation is None:
                raise BadInput(path, "FMU", f"FMI {self.description.fmiVersion}", "an FMI 2.0 co-simulation FMU")
            self.folder = fmpy.extract(str(path))
        except BadInput:
            raise
        except Exception as problem:  # fmpy passes on whatever zip, XML and schema readers raise
            found = str(problem).splitlines()[0] if self.path.is_file() else "no such file"
            raise BadInput(path, "FMU", found, "an FMI 2.0 co-simulation FMU") from problem
        self.variables = {v.name: v for v in self.description.modelVariables}

    def close(self) -> None:
        """Remove the unpacked files."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def references(self, names: Iterable[str], causality: str) -> list[int]:
        """Value references of variables; BadInput names the first that the FMU lacks."""
        for name in names:
            if name not in self.variables or self.variables[name].causality != causality:
                there = ", ".join(v.name for v in self.variables.values() if v.causality == causality)
                raise BadInput(self.path, name, f"no such {causality}", f"one of {there}")
        return [self.variables[name].valueReference for name in names]


class FmuInstance:
    """One instance of an FMU with chosen inputs and outputs, in the order given."""

    def __init__(self, fmu: Fmu, inputs: Sequence[str], outputs: Sequence[str], parameters: Mapping[str, float] | None = None):
        self.fmu, self._messages = fmu, []
        parameters = dict(parameters or {})
        read, written = fmu.references(outputs, "output"), fmu.references(inputs, "input")
        tuned = fmu.references(parameters, "parameter")
        description = fmu.description
        self._slave = FMU2Slave(
            guid=description.guid,
            unzipDirectory=fmu.folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=description.modelName,
        )
        self._callbacks = self._make_callbacks()
        try:
            self._slave.instantiate(callbacks=self._callbacks, loggingOn=True)
        except Exception as problem:  # fmpy raises plain Exception
            raise SimulationFailed(f"{fmu.path}: {self._said() or problem}") from problem
        self._bind(read, written)
        self._call("fmi2SetupExperiment", 0, ctypes.c_double(0.0), ctypes.c_double(0.0), 0, ctypes.c_double(0.0))
        if parameters:
            n = len(parameters)
            self._call(
                "fmi2SetReal", (ctypes.c_uint * n)(*tuned), ctypes.c_size_t(n), (ctypes.c_double * n)(*parameters.values())
            )
        self._call("fmi2EnterInitializationMode")

    def start(self, values: Sequence[float]) -> list[float]:
        """Settle on the inputs and leave the initialisation; returns the outputs. Time is 0."""
        self.inputs[:] = values
        self._check(self._set(), "setting inputs")
        self._call("fmi2ExitInitializationMode")
        self._check(self._get(), "reading outputs")
        return self.outputs[:]

    def step(self, values: Sequence[float], n: int, dt: float) -> list[float]:
        """Hold the inputs from n dt to (n + 1) dt; returns the outputs there."""
        self.inputs[:] = values
        self._time.value, self._dt.value = n * dt, dt
        if self._set() or self._do() or self._get():
            self._check(3, f"the step at {n * dt:.6g} s with inputs {list(values)}")
        return self.outputs[:]

    def close(self) -> None:
        """Terminate and free the instance."""
        if self._slave is not None:
            self._slave.terminate()
            self._slave.freeInstance()
            self._slave = None

    def _bind(self, read, written):
        self._component = ctypes.c_void_p(self._slave.component)
        self.inputs, self.outputs = (ctypes.c_double * len(written))(), (ctypes.c_double * len(read))()
        self._time, self._dt = ctypes.c_double(0.0), ctypes.c_double(0.0)
        bound = (
            ("fmi2SetReal", (ctypes.c_uint * len(written))(*written), ctypes.c_size_t(len(written)), self.inputs),
            ("fmi2GetReal", (ctypes.c_uint * len(read))(*read), ctypes.c_size_t(len(read)), self.outputs),
            ("fmi2DoStep", self._time, self._dt, ctypes.c_int(1)),
        )
        self._set, self._get, self._do = (_bound(self._slave.dll, name, self._component, *args) for name, *args in bound)

    def _call(self, name, *args):
        self._check(self._slave.dll[name](self._component, *args), name)

    def _check(self, status, what):
        if status > 1:
            raise SimulationFailed(f"{self.fmu.path}: {what}: {self._said() or f'status {STATUS[status]}'}")

    def _said(self):
        """The last line of what the FMU logged last: a Python FMU's traceback ends with what went wrong."""
        return self._messages[-1].strip().splitlines()[-1] if self._messages else ""

    def _make_callbacks(self):
        def log(_environment, _instance, _status, _category, message):
            self._messages.append(message.decode("utf-8", "replace"))

        callbacks = fmi2CallbackFunctions()
        callbacks.logger = Logger(log)
        callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
        callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(fmpy.free)
        return callbacks


def _bound(dll, name, *args):
    function = dll[name]
    return lambda: function(*args)
