"""FMI 2.0 co-simulation FMUs in this process: loaded by fmpy, stepped through calls that are bound once.

fmpy's own wrapper converts every argument of every call. Here the buffers are made once, and a step is three foreign calls.
"""

import contextlib
import ctypes
import itertools
import json
import os
import platform
import signal
import subprocess
import sys
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NoReturn

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, fmi2CallbackAllocateMemoryTYPE, fmi2CallbackFreeMemoryTYPE, fmi2CallbackFunctions
from fmpy.fmi2 import fmi2CallbackLoggerTYPE as Logger
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from vpp_fmu.archive import DESCRIPTION, unpacked
from vpp_fmu.errors import BadInput, SimulationFailed, VppError
from vpp_fmu.first_step import ALIVE
from vpp_fmu.native.master import Entry
from vpp_fmu.record import Record
from vpp_fmu.scratch import Scratch
from vpp_fmu.stopping import act, foreign

WARNING = 1
TYPES = {"Real": (ctypes.c_double, float), "Integer": (ctypes.c_int, round), "Boolean": (ctypes.c_int, bool)}
TYPES["Enumeration"] = TYPES["Integer"]
NAMES_MODULE = "slavemodule.txt"
"""The file by which pythonfmu's library finds the module to import."""

PATIENCE = 60.0
"""s that another process may take to load an FMU and make one step."""

STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")


class Fmu:
    """An unpacked FMU file. `slave` may be called many times. The unpacked files are removed by `close`, or with the object
    or the process. BadInput: no FMI 2.0 co-simulation FMU for this machine."""

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self._scratch = unpacked(self.path)
        try:
            self.folder = self._scratch.path
            with _fmpys(lambda said: BadInput(path, DESCRIPTION, said, "as FMI 2.0's schema has it")):
                self.description = fmpy.read_model_description(str(self.folder))
            self.variables = {v.name: v for v in self.description.modelVariables}
            if not self.library.is_file():
                others = sorted(folder.name for folder in (self.folder / "binaries").glob("*/"))
                found = f"binaries for {', '.join(others)} only" if others else "no binaries"
                raise BadInput(path, "FMU", found, f"{self.library.relative_to(self.folder)} for this machine")
            self._check_module()
        except BaseException:
            self.close()
            raise

    @property
    def library(self) -> Path:
        """The shared library. FMI 2.0.4 calls 64-bit ARM `aarch64-linux`, fmpy `linux64`."""
        name = self.description.coSimulation.modelIdentifier
        own = self.folder / "binaries" / "aarch64-linux" / f"{name}.so"
        if platform.machine() == "aarch64" and own.exists():
            return own
        return self.folder / "binaries" / fmpy.platform / f"{name}{fmpy.sharedLibraryExtension}"

    @property
    def is_native(self) -> bool:
        """Whether it needs no other program to run, such as Python."""
        return not self.description.coSimulation.needsExecutionTool

    def slave(self) -> FMU2Slave:
        """fmpy's handle of a new instance, its library loaded. BadInput if loading fails."""
        allowed = f"{self.library.name} of this machine ({fmpy.platform})"
        with _fmpys(lambda said: BadInput(self.path, "FMU", f"a library that can't be loaded ({said})", allowed)):
            return FMU2Slave(
                guid=self.description.guid,
                unzipDirectory=str(self.folder),
                modelIdentifier=self.description.coSimulation.modelIdentifier,
                instanceName=self.description.modelName,
                libraryPath=str(self.library),
            )

    def _check_module(self) -> None:
        """BadInput if the FMU is pythonfmu's and its module is missing: pythonfmu's library would end the process."""
        if NAMES_MODULE.encode() not in self.library.read_bytes():
            return
        resources = self.folder / "resources"
        named = resources / NAMES_MODULE
        name = named.read_text(encoding="utf-8", errors="replace").strip() if named.is_file() else ""
        if not name or not name.isprintable():
            found = f"no {NAMES_MODULE} that names a module"
            raise BadInput(self.path, "FMU", found, f"resources/{NAMES_MODULE}, as pythonfmu writes it")
        if not (resources / f"{name}.py").is_file():
            raise BadInput(self.path, "FMU", f"no module {name[:80]}", f"resources/{name[:80]}.py, which {NAMES_MODULE} names")

    def check_first_step(self, dt: float) -> None:
        """Load, start and step (`dt` s) the FMU in another process, so that a crash does not end this one. BadInput if that
        process dies or hangs."""
        given = {"library": str(self.library), "guid": self.description.guid, "dt": dt}
        given |= {"name": self.description.modelName, "resources": (self.folder / "resources").as_uri()}
        command = [sys.executable, "-m", "vpp_fmu.first_step", json.dumps(given)]
        pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
        same_modules = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        allowed = "an FMU that can be loaded, started and stepped"
        try:
            done = subprocess.run(command, check=False, timeout=PATIENCE, encoding="ascii", env=same_modules, **pipes)
        except subprocess.TimeoutExpired as error:
            raise BadInput(self.path, "FMU", f"no end of its first step within {PATIENCE:g} s", allowed) from error
        *_, stage = done.stdout.splitlines() or ["it was tried"]
        if stage != ALIVE:
            ended = signal.Signals(-done.returncode).name if done.returncode < 0 else f"exit code {done.returncode}"
            raise BadInput(self.path, "FMU", f"the end of the process ({ended}) as {stage}", allowed)

    def close(self) -> None:
        """Remove the unpacked files."""
        self._scratch.close()

    def references(self, names: Iterable[str], causality: str) -> list[int]:
        """Value references of variables. BadInput names the first missing one."""
        for name in names:
            if name not in self.variables or self.variables[name].causality != causality:
                there = ", ".join(v.name for v in self.variables.values() if v.causality == causality)
                raise BadInput(self.path, name, f"no such {causality}", f"one of {there}")
        return [self.variables[name].valueReference for name in names]


class _Block:
    """Variables of one type, which one call transfers. `positions`: their indices among all named variables."""

    def __init__(self, kind: str, references: Mapping[int, int]):
        c_type, self._convert = TYPES[kind]
        self.kind, self.positions, n = "Integer" if kind == "Enumeration" else kind, tuple(references), len(references)
        self.values = (c_type * n)()
        self.arguments = (ctypes.c_uint * n)(*references.values()), ctypes.c_size_t(n), self.values

    def put(self, values: Sequence[float]) -> None:
        """Copy this block's values from all values."""
        self.values[:] = [self._convert(values[i]) for i in self.positions]


def _blocks(fmu: Fmu, names: Sequence[str], causality: str) -> list[_Block]:
    references, found = fmu.references(names, causality), []
    for kind in TYPES:
        own = {i: references[i] for i, name in enumerate(names) if fmu.variables[name].type == kind}
        if own:
            found.append(_Block(kind, own))
    return found


class FmuInstance:
    """One instance of an FMU with chosen inputs and outputs, in the order given."""

    @foreign
    def __init__(self, fmu: Fmu, inputs: Sequence[str], outputs: Sequence[str], parameters: Mapping[str, float] | None = None):
        self.fmu, self._messages = fmu, []
        parameters = dict(parameters or {})
        self._reads, self._writes = _blocks(fmu, outputs, "output"), _blocks(fmu, inputs, "input")
        tuned = _blocks(fmu, list(parameters), "parameter")
        self._slave = fmu.slave()
        self._callbacks = self._make_callbacks()
        try:
            self._slave.instantiate(callbacks=self._callbacks, loggingOn=True)
        except Exception as problem:  # fmpy raises plain Exception
            act()
            raise SimulationFailed(f"{fmu.path}: {self._said() or problem}") from problem
        # An instance that still exists when the interpreter ends crashes the process.
        self.close = weakref.finalize(self, _end, self._slave)
        """Terminate and free the instance."""
        self._component = ctypes.c_void_p(self._slave.component)
        self._call("fmi2SetupExperiment", 0, ctypes.c_double(0.0), ctypes.c_double(0.0), 0, ctypes.c_double(0.0))
        for block in tuned:
            block.put(list(parameters.values()))
            self._call(f"fmi2Set{block.kind}", *block.arguments)
        self._call("fmi2EnterInitializationMode")
        act()

    def start(self, values: Sequence[float]) -> list[float]:
        """Settle on the inputs and leave the initialisation; returns the outputs. Time is 0."""
        self._set(values)
        self._call("fmi2ExitInitializationMode")
        shown = self._get()
        self._messages.clear()  # earlier log messages explain no later failure
        return shown

    def stepper(self, dt: float) -> Callable[[Sequence[float]], list[float]]:
        """A function that holds inputs for the next `dt` seconds and returns the outputs there; time is counted from 0.

        All arguments are bound once, so a step is three foreign calls.
        """
        if [block.kind for block in (*self._writes, *self._reads)] != ["Real", "Real"]:
            return self._stepper_of_any_type(dt)
        dll, component = self._slave.dll, self._component
        set_real, do_step, get_real = dll["fmi2SetReal"], dll["fmi2DoStep"], dll["fmi2GetReal"]
        (writing,), (reading,) = self._writes, self._reads
        inputs, outputs, written, read = writing.values, reading.values, writing.arguments, reading.arguments
        at, step, go_on, count = ctypes.c_double(0.0), ctypes.c_double(dt), ctypes.c_int(1), itertools.count()

        @foreign
        def take(values):
            inputs[:] = values
            at.value = next(count) * dt
            status = set_real(component, *written) or do_step(component, at, step, go_on) or get_real(component, *read)
            if status > WARNING:
                self._check(status, f"the step at {at.value:.6g} s with inputs {list(values)}")
            act()
            return outputs[:]

        return take

    def entry(self) -> Entry | None:
        """The instance for a compiled master; None if a variable is not Real, or if the FMU itself runs Python, which must be
        called from Python."""
        if [block.kind for block in (*self._writes, *self._reads)] != ["Real", "Real"] or not self.fmu.is_native:
            return None
        functions = (self._slave.dll[f"fmi2{name}"] for name in ("SetReal", "DoStep", "GetReal"))
        (writing,), (reading,) = self._writes, self._reads
        return Entry(
            self._component.value,
            *(ctypes.cast(function, ctypes.c_void_p).value for function in functions),
            *(ctypes.addressof(block.arguments[0]) for block in (writing, reading)),
            *(len(block.positions) for block in (writing, reading)),
            *(ctypes.addressof(block.values) for block in (writing, reading)),
        )

    def failed(self, status: int, at: float) -> NoReturn:
        """SimulationFailed for a step that began at `at` s and returned this status."""
        self._check(status, f"the step at {at:.6g} s with inputs {[*self._writes[0].values]}")
        raise SimulationFailed(f"{self.fmu.path}: the step at {at:.6g} s: status {status}")

    def _stepper_of_any_type(self, dt):
        # ctypes creates a function at each look-up: four look-ups cost more than a step.
        dll, component, count = self._slave.dll, self._component, itertools.count()
        setting = [(block, dll[f"fmi2Set{block.kind}"]) for block in self._writes]
        getting = [(block, dll[f"fmi2Get{block.kind}"]) for block in self._reads]
        do_step, at, step = dll["fmi2DoStep"], ctypes.c_double(0.0), ctypes.c_double(dt)
        found = [0.0] * sum(len(block.positions) for block in self._reads)

        @foreign
        def take(values):
            for block, function in setting:
                block.put(values)
                self._check(function(component, *block.arguments), f"fmi2Set{block.kind}")
            at.value = next(count) * dt
            self._check(do_step(component, at, step, 1), "fmi2DoStep")
            for block, function in getting:
                self._check(function(component, *block.arguments), f"fmi2Get{block.kind}")
                for i, value in zip(block.positions, block.values, strict=True):
                    found[i] = float(value)
            act()
            return found[:]

        return take

    def _set(self, values):
        for block in self._writes:
            block.put(values)
            self._call(f"fmi2Set{block.kind}", *block.arguments)

    def _get(self):
        found = [0.0] * sum(len(block.positions) for block in self._reads)
        for block in self._reads:
            self._call(f"fmi2Get{block.kind}", *block.arguments)
            for i, value in zip(block.positions, block.values, strict=True):
                found[i] = float(value)
        return found

    @foreign
    def _call(self, name, *args):
        self._check(self._slave.dll[name](self._component, *args), name)
        act()

    def _check(self, status, what):
        if status > WARNING:
            raise SimulationFailed(f"{self.fmu.path}: {what}: {self._said() or f'status {STATUS[status]}'}")

    def _said(self):
        """The last line of the FMU's last log message: a Python FMU's traceback ends with the error."""
        return self._messages[-1].strip().splitlines()[-1] if self._messages else ""

    def _make_callbacks(self):
        def log(_environment, _instance, _status, _category, message):
            self._messages.append(message.decode("utf-8", "replace"))

        callbacks = fmi2CallbackFunctions()
        callbacks.logger = Logger(log)
        callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
        callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(fmpy.free)
        return callbacks


@contextlib.contextmanager
def _fmpys(refusal: Callable[[str], VppError]) -> Iterator[None]:
    """Within this context fmpy's exceptions become errors of this project, with its message on one line."""
    before = Path.cwd()
    try:
        yield
        act()
    except Exception as problem:  # it raises Exception itself; the XML readers may raise any other
        act()
        os.chdir(before)  # fmpy changes to the library's folder, and stays there if loading fails
        said = " ".join(str(problem).split()) or type(problem).__name__
        raise refusal(said if len(said) <= 200 else f"{said[:197]}...") from problem


@foreign
def _end(slave: FMU2Slave) -> None:
    """Free the instance, but leave its library loaded: unloading a library that holds the interpreter sometimes aborts.

    A library of pythonfmu's releases the interpreter twice when it is unloaded, also at the end of the process. The second
    release writes to freed memory. The interpreter cannot be released earlier, because live
    instances hold it.
    """
    with contextlib.suppress(FMICallException):  # an instance that failed, or never started, can only be freed
        slave.terminate()
    slave.fmi2FreeInstance(slave.component)
    if let_go := getattr(slave.dll, "finalizePythonInterpreter", None):
        let_go()


def problems(path: str | Path) -> list[str]:
    """The messages of `fmpy validate` on an FMU."""
    return validate_fmu(str(path))


CALLS_3 = {"Float64": "Float64", "Int32": "Int32", "Boolean": "Boolean", "Enumeration": "Int64"}
"""The calls of FMI 3.0 for a type."""


@foreign
def steps_in_fmi_3(path: str | Path, held: Sequence[Mapping[str, float]], step: float, outputs: Sequence[str]) -> np.ndarray:
    """Outputs (points, elements) of an FMI 3.0 FMU. `held`: inputs by name, each for one communication step of `step` seconds;
    the last one only for the last point. A vector is one input or output, with all its elements. SimulationFailed.

    fmpy's own simulation can't change a discrete input that is a vector.
    """
    with contextlib.closing(Scratch()) as scratch, _fmpys(lambda said: SimulationFailed(f"{path}: {said}")):
        fmpy.extract(str(path), str(scratch.path))
        description = fmpy.read_model_description(str(scratch.path))
        by_name = {v.name: v for v in description.modelVariables}
        identifier = description.coSimulation.modelIdentifier
        slave = FMU3Slave(
            guid=description.guid, unzipDirectory=str(scratch.path), modelIdentifier=identifier, instanceName=identifier
        )

        def put(values: Mapping) -> None:
            for name, value in values.items():
                numbers = np.atleast_1d(value).tolist()
                whole = numbers if by_name[name].type == "Float64" else [round(x) for x in numbers]
                getattr(slave, f"set{CALLS_3[by_name[name].type]}")([by_name[name].valueReference], whole)

        def got() -> list[float]:
            row: list[float] = []
            for v in map(by_name.__getitem__, outputs):
                count = int(np.prod([int(d.start) for d in v.dimensions], dtype=int))
                row += map(float, getattr(slave, f"get{CALLS_3[v.type]}")([v.valueReference], count))
            return row

        slave.instantiate()
        slave.enterInitializationMode()
        put(held[0])
        slave.exitInitializationMode()
        rows = [got()]
        for k, inputs in enumerate(held[:-1]):
            put(inputs)
            slave.doStep(k * step, step)
            rows.append(got())
        slave.terminate()
        slave.freeInstance()
    return np.array(rows)


@foreign
def simulate_in_fmpy(path: str | Path, record: Record) -> np.ndarray:
    """Thrust (rows,) N of a plant FMU under a record's commands, by fmpy's own simulation, at the record's times."""
    names = ("time", "omega_ref", "beta_ref")
    table = np.rec.fromarrays([record[n] for n in names], names=names)
    step = float(np.median(record.steps))
    stop = float(record.time[-1])
    # If fmpy unpacked it, an error would leave the files behind.
    with contextlib.closing(Fmu(path)) as fmu, _fmpys(lambda said: SimulationFailed(f"{path}: {said}")):
        result = fmpy.simulate_fmu(str(fmu.folder), input=table, stop_time=stop, output_interval=step, output=["thrust"])
    return np.interp(record.time, result["time"], result["thrust"])
