"""The native FMU: what holds for the Python flavour holds for it, and what only compiled C can be asked for."""

import ctypes
import io
import os
import re
import shutil
import subprocess
import sys
import threading
import zipfile
from functools import partial
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import arm
import fmpy
import numpy as np
import pytest
import test_fmu
from builders import ALL_ON, PROBES, Slave, random_steps, reference, simulator
from fmpy.build import build_platform_binary
from fmpy.fmi1 import FMICallException
from fuzz import fuzz, fuzzer

from vpp_fmu.cli import main
from vpp_fmu.errors import CompilerMissing, SimulationFailed
from vpp_fmu.export import native_fmu, toolchain
from vpp_fmu.export.c_text import c_text
from vpp_fmu.export.cross_check import reference_files
from vpp_fmu.export.description import Experiment
from vpp_fmu.fmu import Fmu, FmuInstance
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.native import compiler

try:
    CC = compiler.compiler()
except CompilerMissing as missing:
    pytest.skip(f"native FMUs: {missing}", allow_module_level=True)

zig = pytest.mark.skipif(not find_spec("ziglang"), reason="ziglang is not installed (the extra 'cross')")
MODELS = {"plain": (BASE, {}), "all_on": (ALL_ON, PROBES), "controller": (CONTROLLER, {})}
each_fmu = pytest.mark.parametrize("name", MODELS)
OUTPUTS = test_fmu.OUTPUTS


@pytest.fixture(scope="module")
def fmu_files(tmp_path_factory):
    """Paths of native FMUs under the names that the Python flavour's tests use."""
    folder = tmp_path_factory.mktemp("native")
    for name, (model, values) in MODELS.items():
        (folder / f"{name}.fmu").write_bytes(native_fmu(model, values))
    return {name: folder / f"{name}.fmu" for name in MODELS}


@pytest.fixture(scope="module")
def fmus(fmu_files):
    """The same, unpacked."""
    unpacked = {name: Fmu(path) for name, path in fmu_files.items()}
    yield unpacked
    for fmu in unpacked.values():
        fmu.close()


# Collected here, they run on the fixtures above.
test_fmpy_finds_no_problem = test_fmu.test_fmpy_finds_no_problem
test_every_variable_says_what_it_is = test_fmu.test_every_variable_says_what_it_is
test_initial_unknowns = test_fmu.test_initial_unknowns_name_all_that_the_outputs_start_from
test_outputs_during_the_initialisation = test_fmu.test_outputs_can_be_read_during_the_initialisation
test_an_input_does_nothing_before_the_next_step = test_fmu.test_an_input_does_nothing_before_the_next_step
test_4000_steps = test_fmu.test_4000_steps_with_every_effect_are_the_kernels_to_the_bit
test_a_kept_state = test_fmu.test_a_kept_state_goes_on_to_the_bit
test_a_state_kept_during_the_initialisation = test_fmu.test_a_state_kept_during_the_initialisation_starts_again_from_there
test_reset_gives_a_fresh_instance = test_fmu.test_reset_gives_a_fresh_instance
test_a_state_begins_where_it_is_set = test_fmu.test_a_state_begins_where_it_is_set
test_gains_are_tuned_while_the_controller_runs = test_fmu.test_gains_are_tuned_while_the_controller_runs
test_what_is_refused_is_said = test_fmu.test_what_is_refused_is_said
test_a_parameter_out_of_range = test_fmu.test_a_parameter_out_of_range_is_refused_by_name


@each_fmu
def test_it_is_the_python_fmu_to_the_bit_on_uneven_steps(fmus, name, tmp_path):
    model, values = MODELS[name]
    path = tmp_path / "python.fmu"
    path.write_bytes(test_fmu.python_fmu(model, values))
    slaves, rng = (Slave(fmus[name]), Slave(Fmu(path))), np.random.default_rng(5)
    for dt in rng.choice([0.004, 0.004, 0.0013, 0.011, 0.05], 1500).tolist():
        held = {u.name: float(rng.uniform(0.0, u.nominal)) for u in model.inputs}
        shown = [slave.step(held, dt, *slave.references) for slave in slaves]
        assert shown[0] == shown[1]


@each_fmu
def test_both_flavours_describe_the_same_variables(fmu_files, name):
    def described(data):
        with zipfile.ZipFile(data) as packed:
            root = ElementTree.fromstring(packed.read("modelDescription.xml"))
            return (
                root.attrib,
                root.find("CoSimulation").attrib,
                [ElementTree.tostring(e) for e in root if e.tag != "CoSimulation"],
            )

    native, python = (described(f) for f in (fmu_files[name], io.BytesIO(test_fmu.python_fmu(*MODELS[name]))))
    assert native[2] == python[2]
    assert native[0]["guid"] != python[0]["guid"]
    assert native[1]["needsExecutionTool"] == "false"
    assert native[1]["providesDirectionalDerivative"] == "true"


def test_the_archive_holds_all_that_an_fmu_should(fmu_files):
    for data in (fmu_files["all_on"], io.BytesIO(test_fmu.python_fmu(ALL_ON, PROBES, origins={"c20": "measured twice"}))):
        with zipfile.ZipFile(data) as packed:
            page = packed.read("documentation/index.html").decode()
            assert packed.read("model.png").startswith(b"\x89PNG\r\n\x1a\n")
            assert b"MIT License" in packed.read("documentation/licenses/license.txt")
        for wanted in ("c20 w^2 + c11 w b", "half_width", "tau_2 dx/dt = u_ref - x", "0.001 to 3", "state.omega_inner"):
            assert wanted in page
    assert "measured twice" in page


@each_fmu
def test_two_builds_in_different_folders_have_the_same_bytes(fmu_files, name, tmp_path):
    first = fmu_files[name].read_bytes()
    code = f"from test_native_fmu import *; print(sha256(native_fmu(*MODELS[{name!r}])).hexdigest())"
    places = {"TMPDIR": str(tmp_path), "PYTHONHASHSEED": "3", "TZ": "Asia/Tokyo"}
    assert test_fmu.in_a_new_process(code, tmp_path, **places) == sha256(first).hexdigest()
    with zipfile.ZipFile(io.BytesIO(first)) as packed:
        for place in (str(Path.cwd()), str(Path.home()), "/tmp", sys.prefix):
            assert all(place.encode() not in packed.read(entry) for entry in packed.namelist())


def test_other_values_give_another_fmu(fmu_files):
    assert native_fmu(CONTROLLER, {"kp_omega": 0.5}) != fmu_files["controller"].read_bytes()


@pytest.mark.skipif(not shutil.which("cmake", path=f"{Path(sys.executable).parent}:{os.environ['PATH']}"), reason="no cmake")
def test_fmpy_compiles_it_from_its_sources(fmu_files, long_run, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    monkeypatch.setattr(subprocess, "check_call", partial(subprocess.run, check=True, capture_output=True))
    fmpy.extract(str(fmu_files["all_on"]), unzipdir=str(tmp_path))
    shutil.rmtree(tmp_path / "binaries")
    (tmp_path / "build").mkdir()
    build_platform_binary(tmp_path, tmp_path / "build")
    fmu = Fmu(fmu_files["all_on"])
    shutil.copytree(tmp_path / "binaries", Path(fmu.folder, "binaries"), dirs_exist_ok=True)
    commands, _, exact = long_run
    instance = FmuInstance(fmu, list(commands), OUTPUTS)
    rows = np.column_stack(list(commands.values()))[:2000].tolist()
    shown = [instance.start(rows[0])]
    step = instance.stepper(0.004)
    np.testing.assert_array_equal(shown + [step(row) for row in rows[:-1]], exact[:2000])
    fmu.close()


def test_its_source_draws_no_warning(tmp_path):
    for name, (model, values) in MODELS.items():
        (tmp_path / f"{name}.c").write_text(c_text(model, values | model.values(values), "{}"))
        strict = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only"]
        subprocess.run([CC, *strict, f"{name}.c"], cwd=tmp_path, check=True)
        subprocess.run([CC, *strict, "-DFMI2_FUNCTION_PREFIX=Vpp_", f"{name}.c"], cwd=tmp_path, check=True)


class Raw:
    """The library's functions as they are, and what it logs."""

    LOGGER = ctypes.CFUNCTYPE(None, ctypes.c_void_p, *[ctypes.c_char_p] * 1, ctypes.c_int, *[ctypes.c_char_p] * 2)

    def __init__(self, fmu, logger=True):
        name = fmu.description.coSimulation.modelIdentifier
        self.library = ctypes.CDLL(str(next(Path(fmu.folder, "binaries").glob(f"*/{name}.*"))))
        self.said: list[tuple[int, str, str]] = []
        self._log = self.LOGGER(
            lambda _env, _name, status, kind, text: self.said.append((status, kind.decode(), text.decode()))
        )
        self.callbacks = (ctypes.c_void_p * 5)(ctypes.cast(self._log, ctypes.c_void_p).value if logger else None)
        self.guid = fmu.description.guid.encode()
        self.instance = self.instantiate()

    def instantiate(self, name=b"a", kind=1, guid=None, callbacks=True):
        function = self.library.fmi2Instantiate
        function.restype = ctypes.c_void_p
        return function(name, kind, guid or self.guid, None, self.callbacks if callbacks else None, 0, 0)

    def __call__(self, name, *arguments):
        return getattr(self.library, name)(ctypes.c_void_p(self.instance), *arguments)

    def reals(self, name, references, values):
        n = len(references)
        return self(name, (ctypes.c_uint * n)(*references), ctypes.c_size_t(n), (ctypes.c_double * n)(*values))

    def step(self, size=0.004):
        return self("fmi2DoStep", ctypes.c_double(0.0), ctypes.c_double(size), 1)

    def setup(self):
        return self("fmi2SetupExperiment", 0, ctypes.c_double(0.0), ctypes.c_double(0.0), 0, ctypes.c_double(0.0))

    def derivative(self):
        one, n = (ctypes.c_uint * 1)(0), ctypes.c_size_t(0)
        return self("fmi2GetDirectionalDerivative", one, n, one, n, None, None)

    def state(self):
        kept = ctypes.c_void_p()
        status = self("fmi2GetFMUstate", ctypes.byref(kept))
        return max(status, self("fmi2FreeFMUstate", ctypes.byref(kept)))


CALLS = {
    "fmi2SetupExperiment": Raw.setup,
    "fmi2EnterInitializationMode": lambda r: r("fmi2EnterInitializationMode"),
    "fmi2ExitInitializationMode": lambda r: r("fmi2ExitInitializationMode"),
    "fmi2Terminate": lambda r: r("fmi2Terminate"),
    "fmi2Reset": lambda r: r("fmi2Reset"),
    "fmi2DoStep": Raw.step,
    "fmi2GetReal": lambda r: r.reals("fmi2GetReal", [0], [0.0]),
    "fmi2SetReal": lambda r: r.reals("fmi2SetReal", [0], [1.0]),
    "fmi2GetInteger": lambda r: r("fmi2GetInteger", None, ctypes.c_size_t(0), None),
    "fmi2SetString": lambda r: r("fmi2SetString", None, ctypes.c_size_t(0), None),
    "fmi2GetFMUstate": Raw.state,
    "fmi2GetDirectionalDerivative": Raw.derivative,
    "fmi2SetDebugLogging": lambda r: r("fmi2SetDebugLogging", 1, ctypes.c_size_t(0), None),
    "fmi2CancelStep": lambda r: r("fmi2CancelStep"),
}
STATES = {
    "instantiated": [],
    "initialising": ["fmi2SetupExperiment", "fmi2EnterInitializationMode"],
    "stepping": ["fmi2EnterInitializationMode", "fmi2ExitInitializationMode"],
    "terminated": ["fmi2EnterInitializationMode", "fmi2ExitInitializationMode", "fmi2Terminate"],
    "failed": ["fmi2EnterInitializationMode", "fmi2DoStep"],
}
ALLOWED = {
    "instantiated": {"fmi2SetupExperiment", "fmi2EnterInitializationMode", "fmi2SetReal", "fmi2SetString"},
    "initialising": {"fmi2ExitInitializationMode", "fmi2GetReal", "fmi2SetReal", "fmi2GetInteger", "fmi2SetString"},
    "stepping": {"fmi2Terminate", "fmi2DoStep", "fmi2GetReal", "fmi2SetReal", "fmi2GetInteger", "fmi2SetString"},
    "terminated": {"fmi2GetReal", "fmi2GetInteger"},
    "failed": {"fmi2GetReal", "fmi2GetInteger"},
}
ALWAYS = {"fmi2Reset", "fmi2GetFMUstate", "fmi2SetDebugLogging"}


@pytest.mark.parametrize("state", STATES)
def test_calls_are_taken_in_the_order_of_the_standard(fmus, state):
    for name, call in CALLS.items():
        raw = Raw(fmus["plain"])
        for way in STATES[state]:
            CALLS[way](raw)
        raw.said.clear()
        allowed = ALLOWED[state] | ALWAYS | ({"fmi2GetDirectionalDerivative"} if state != "instantiated" else set())
        assert call(raw) == (0 if name in allowed else 3), name
        if name not in allowed:
            [(status, category, text)] = raw.said
            assert (status, category) == (3, "logStatusError")
            assert text.startswith(f"VppPlant: {name} is not allowed ")
            assert CALLS["fmi2SetReal"](raw) == 3  # an error stays until a reset
            assert CALLS["fmi2Reset"](raw) == CALLS["fmi2SetupExperiment"](raw) == 0
        raw("fmi2FreeInstance")


def test_no_instance_without_what_the_standard_asks_for(fmus):
    raw = Raw(fmus["plain"])
    for bad, word in (({"guid": b"{0}"}, "guid is {0}, allowed is {"), ({"kind": 0}, "co-simulation"), ({"name": b""}, "name")):
        assert raw.instantiate(**bad) is None
        assert word in raw.said[-1][2]
    assert raw.instantiate(guid=b"{0}", callbacks=False) is None


def test_no_callbacks_no_instance_and_null_pointers_are_survived(fmus):
    raw = Raw(fmus["plain"])
    for callbacks in (True, False):
        quiet = Raw(fmus["plain"], logger=False)
        quiet.instance = quiet.instantiate(callbacks=callbacks)
        assert quiet.step() == 3
        assert quiet("fmi2Reset") == 0
        quiet("fmi2FreeInstance")
    many = ctypes.c_size_t(3)
    for name in ("fmi2GetReal", "fmi2SetReal", "fmi2GetInteger", "fmi2SetBoolean"):
        CALLS["fmi2Reset"](raw)
        raw("fmi2EnterInitializationMode")
        assert raw(name, None, many, None) == 3
        assert "null pointer" in raw.said[-1][2]
    for name in ("fmi2GetFMUstate", "fmi2SetFMUstate", "fmi2FreeFMUstate"):
        assert raw(name, None) == 3
    raw("fmi2FreeInstance")
    raw.instance = None
    for call in CALLS.values():
        assert call(raw) == 3
    raw("fmi2FreeInstance")


def test_other_types_than_real_and_derivatives_in_time_are_refused(fmus):
    for name in ("GetInteger", "GetBoolean", "GetString", "SetInteger", "SetBoolean", "SetString"):
        raw = Raw(fmus["plain"])
        raw("fmi2EnterInitializationMode")
        assert raw(f"fmi2{name}", (ctypes.c_uint * 1)(2), ctypes.c_size_t(1), (ctypes.c_double * 1)()) == 3
        assert raw.said[-1][2] == f"VppPlant: fmi2{name}: thrust is of type Real"
    raw = Raw(fmus["plain"])
    assert raw("fmi2SetRealInputDerivatives", None, ctypes.c_size_t(1), None, None) == 3
    raw = Raw(fmus["plain"])
    for way in STATES["stepping"]:
        CALLS[way](raw)
    assert raw("fmi2GetRealStatus", 0, (ctypes.c_double * 1)()) == 2
    assert raw.said[-1][:2] == (2, "logStatusDiscard")
    assert raw.step() == 0
    assert raw("fmi2GetRealStatus", 2, reached := (ctypes.c_double * 1)()) == 0
    assert reached[0] == 0.004


def test_logging_is_switched_by_category(fmus):
    raw = Raw(fmus["plain"])
    error = (ctypes.c_char_p * 1)(b"logStatusError")
    for on in (0, 1):
        raw.said.clear()
        assert raw("fmi2SetDebugLogging", on, ctypes.c_size_t(1), error) == 0
        raw.step()
        assert len(raw.said) == on
        raw("fmi2Reset")
    assert raw("fmi2SetDebugLogging", 1, ctypes.c_size_t(1), (ctypes.c_char_p * 1)(b"logAll")) == 0
    for way in (*STATES["stepping"], "fmi2DoStep", "fmi2Terminate"):
        assert CALLS[way](raw) == 0
    events = [(0, "logEvents", f"VppPlant: {what} s") for what in ("initialised at 0.0", "terminated at 0.004")]
    assert raw.said[-2:] == events
    assert raw("fmi2SetDebugLogging", 1, ctypes.c_size_t(1), (ctypes.c_char_p * 1)(b"logNothing")) == 0
    assert raw.said[-1] == (1, "logStatusWarning", "VppPlant: log category logNothing is unknown")
    assert CALLS["fmi2GetReal"](raw) == 0


def test_messages_write_numbers_as_python_does(fmus):
    slave = Slave(fmus["plain"])
    for value in (-0.1, -1e-5, -123456.789, -1e16, -1e22, -1.0, -(2.0**53), -1 / 3, -5e-324, -1.7976931348623157e308, -0.0):
        with pytest.raises(FMICallException):
            slave.fmi.doStep(0.0, value)
        assert slave.messages[-1] == f"VppPlant: communication step is {value} s, a positive number is needed"
        slave.fmi.reset()
        slave.initialise()


def test_a_delay_takes_no_more_changes_than_it_can_hold(fmus):
    slave = Slave(fmus["all_on"], initialised=False).initialise(**{"pitch_delay.delay": 0.3})
    for k in range(4096):
        slave.step({"beta_ref": float(1 + k % 2)}, 1e-6)
    with pytest.raises(FMICallException):
        slave.step({"beta_ref": 5.0}, 1e-6)
    assert "more than 4096 command changes wait in one delay" in slave.messages[-1]


def test_a_state_of_another_fmu_or_broken_bytes_are_refused(fmus):
    plant, controller = Slave(fmus["plain"]), Slave(fmus["controller"])
    data = bytearray(plant.fmi.serializeFMUstate(plant.fmi.getFMUstate()))
    broken = bytes(data[:100]) + bytes([data[100] ^ 1]) + bytes(data[101:])
    for slave, content in ((controller, bytes(data)), (plant, broken), (plant, bytes(data[:-1])), (plant, b"")):
        with pytest.raises(FMICallException):
            slave.fmi.deSerializeFMUstate(content)
        slave.fmi.reset()
    with pytest.raises(FMICallException):
        controller.fmi.setFMUstate(plant.fmi.getFMUstate())


def derivative(slave, unknowns, knowns, moves):
    return slave.fmi.getDirectionalDerivative(
        [slave.references[n] for n in unknowns], [slave.references[n] for n in knowns], list(moves)
    )


@each_fmu
def test_derivatives_at_the_start_are_differences(fmus, name):
    """Of outputs and states in inputs and parameters, one by one and along a mixed direction."""
    model = MODELS[name][0]
    inputs = {u.name: (0.42 - 0.05 * k) * u.nominal for k, u in enumerate(model.inputs)}  # at no limit of the controller
    values = model.values(MODELS[name][1]) | inputs
    unknowns = [*(s.name for s in model.outputs), *(f"state.{x.name}" for x in model.states)]
    sizes = {q.name: 1e-5 * max(abs(values[q.name]), 1e-3 * q.nominal) for q in (*model.inputs, *model.parameters)}

    def settled(**changes):
        slave = Slave(fmus[name], initialised=False)
        slave.fmi.setupExperiment(startTime=0.0)
        slave.fmi.enterInitializationMode()
        slave.set(**{**values, **changes})
        found = np.array(slave.get(*unknowns))
        slave.free()
        return found

    slave = Slave(fmus[name], initialised=False)
    slave.fmi.setupExperiment(startTime=0.0)
    slave.fmi.enterInitializationMode()
    slave.set(**values)
    total, size = 0.0, np.maximum(np.abs(settled()), 1.0)
    for known, h in sizes.items():
        found = np.array(derivative(slave, unknowns, [known], [1.0]))
        difference = (settled(**{known: values[known] + h}) - settled(**{known: values[known] - h})) / (2.0 * h)
        np.testing.assert_allclose(found, difference, rtol=1e-4, atol=1e-9 * size.max() / h, err_msg=known)
        total = total + found * h
    np.testing.assert_allclose(derivative(slave, unknowns, list(sizes), sizes.values()), total, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", ["plain", "all_on"])
def test_derivatives_at_communication_points_are_the_simulators(fmus, name):
    model, values = MODELS[name]
    wrt = tuple(p.name for p in model.parameters)
    inputs, steps = random_steps(400, 40, model=model), np.full(399, 0.0037)
    exact = simulator(model, wrt).sensitivities(values, inputs, steps)[1]
    slave = Slave(fmus[name], initialised=False)
    slave.fmi.setupExperiment(startTime=0.0)
    slave.fmi.enterInitializationMode()
    slave.set(**{n: float(column[0]) for n, column in inputs.items()})
    derivative(slave, OUTPUTS, wrt[:1], [1.0])
    slave.fmi.exitInitializationMode()
    size = np.abs(exact).max(axis=0) + 1e-12
    for row in range(400):
        found = np.array([derivative(slave, OUTPUTS, [p], [1.0]) for p in wrt]).T
        assert (np.abs(found - exact[row]) <= 1e-9 * size).all()
        assert derivative(slave, OUTPUTS, list(inputs), [1.0] * len(inputs)) == [0.0] * 3
        if row % 50 == 20:  # sensitivities are part of the state
            slave.fmi.setFMUstate(slave.fmi.deSerializeFMUstate(slave.fmi.serializeFMUstate(slave.fmi.getFMUstate())))
        if row < 399:
            slave.step({n: float(column[row]) for n, column in inputs.items()}, 0.0037)


def test_the_controllers_derivatives_are_differences(fmus):
    """Also in its sample time: 37 samples of each length, under thrust that stands still."""
    held, unknowns = {"thrust_set": 7.0, "thrust": 6.99}, ["omega_ref", "beta_ref"]

    def run(samples, **values):
        slave = Slave(fmus["controller"], initialised=False)
        slave.fmi.setupExperiment(startTime=0.0)
        slave.fmi.enterInitializationMode()
        slave.set(**values)
        derivative(slave, unknowns, ["kp_omega"], [1.0])
        slave.fmi.exitInitializationMode()
        slave.step(held, samples * values.get("sample_time", 0.004))
        return slave

    slave, model = run(37), CONTROLLER.values()
    for known in ("sample_time", "kp_omega", "ki_beta", "kd_omega", "t_filter", "thrust_scale"):
        h = 1e-6 * model[known]
        above, below = (np.array(run(37, **{known: model[known] + d}).get(*unknowns)) for d in (h, -h))
        found = derivative(slave, unknowns, [known], [1.0])
        np.testing.assert_allclose(found, (above - below) / (2.0 * h), rtol=1e-5, atol=1e-6)


def test_derivatives_that_are_not_there_are_refused_in_words(fmus):
    cases = {
        ("thrust", "tau_omega_1"): "ask for tau_omega_1 in initialization mode first",
        ("thrust", "omega"): "omega is no known",
        ("omega_ref", "omega_ref"): "omega_ref is no unknown",
        ("c20", "omega_ref"): "c20 is no unknown",
    }
    for (unknown, known), words in cases.items():
        slave = Slave(fmus["plain"])
        with pytest.raises(FMICallException):
            derivative(slave, [unknown], [known], [1.0])
        assert words in slave.messages[-1]


def one(reference):
    return (ctypes.c_uint * 1)(reference), ctypes.c_size_t(1)


def resident():
    return int(Path("/proc/self/statm").read_text().split()[1])


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="no /proc")
def test_a_thousand_lives_leave_no_memory_behind(fmus):
    raw, references = Raw(fmus["all_on"]), {n: v.valueReference for n, v in fmus["all_on"].variables.items()}
    asked = *one(references["thrust"]), *one(references["tau_omega_1"]), (ctypes.c_double * 1)(1.0), (ctypes.c_double * 1)()

    def live(times):
        for _ in range(times):
            raw.instance = raw.instantiate()
            raw("fmi2EnterInitializationMode")
            raw("fmi2GetDirectionalDerivative", *asked)
            raw("fmi2ExitInitializationMode")
            raw.step()
            raw.state()
            raw("fmi2FreeInstance")

    live(200)
    before = resident()
    live(1000)
    assert not raw.said
    assert resident() - before < 64  # pages of 4 kB; an instance with its delays is 30 of them


def test_threads_with_instances_of_their_own_do_not_mix(fmus):
    """8 threads step 8 instances each, all with other parameters; the foreign calls run at the same time."""
    fmu, steps = fmus["all_on"], 300
    taus = np.linspace(0.05, 0.6, 64)
    inputs = random_steps(steps + 1, 20, model=ALL_ON)
    rows = np.column_stack(list(inputs.values())).tolist()
    instances = [FmuInstance(fmu, list(inputs), OUTPUTS, {"tau_omega_1": float(tau)}) for tau in taus]
    shown: dict[int, list] = {}

    def work(thread):
        mine = range(8 * thread, 8 * thread + 8)
        for i in mine:
            instances[i].start(rows[0])
        steppers = [(i, instances[i].stepper(0.004)) for i in mine]
        for row in rows[:-1]:
            for i, step in steppers:
                shown[i] = step(row)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for i in range(0, 64, 9):
        exact = simulator(ALL_ON).simulate({**PROBES, "tau_omega_1": float(taus[i])}, inputs, np.full(steps, 0.004))
        assert shown[i] == exact[-1].tolist()


@pytest.mark.parametrize("name", MODELS)
def test_no_sequence_of_calls_crashes_it(name, tmp_path):
    program, _ = fuzzer(tmp_path, *MODELS[name], "2.0")  # where there are no sanitizers, a crash still shows
    for seed in (1, 2, 3):
        done = fuzz(program, seed, 3000)
        assert done.returncode == 0, done.stderr[-2000:]


def test_the_reference_files_are_what_fmpy_gets(fmu_files, tmp_path):
    experiment = Experiment(stop=4.0)
    for name, (model, values) in MODELS.items():
        for file, text in reference_files(model, values, experiment).items():
            (tmp_path / file).write_text(text)
        options = fmpy.util.read_ref_opt_file(tmp_path / f"{model.name}_ref.opt")
        result = fmpy.simulate_fmu(
            str(fmu_files[name]),
            input=fmpy.util.read_csv(tmp_path / f"{model.name}_in.csv"),
            stop_time=options["StopTime"],
            output_interval=options["StepSize"],
        )
        exact = fmpy.util.read_csv(tmp_path / f"{model.name}_ref.csv")
        assert len(result) == len(exact) == 1001
        for output in model.outputs:
            scale = np.abs(exact[output.name]).max()
            assert np.ptp(exact[output.name]) > 0.01 * scale
            np.testing.assert_allclose(result[output.name], exact[output.name], rtol=1e-9, atol=1e-9 * scale)


@zig
def test_all_platforms_fit_into_150_kb_and_are_reproducible(tmp_path):
    for model in (BASE, CONTROLLER):
        built = native_fmu(model, platforms="all")
        with zipfile.ZipFile(io.BytesIO(built)) as packed:
            there = {Path(n).parts[1] for n in packed.namelist() if n.startswith("binaries/")}
            assert packed.read(f"binaries/darwin64/{model.name}.dylib")[:4] == bytes.fromhex("cafebabe")
        assert there == set(toolchain.TARGETS)
        assert len(built) <= 150_000
        code = (
            f"from test_native_fmu import *; print(sha256(native_fmu({model.name[3:].upper()}, platforms='all')).hexdigest())"
        )
        code = code.replace("PLANT", "BASE")
        places = {"TMPDIR": str(tmp_path)} | {name: str(tmp_path / "zig") for name in ()}
        assert test_fmu.in_a_new_process(code, tmp_path, **places) == sha256(built).hexdigest()


@pytest.mark.skipif(bool(arm.missing()), reason=arm.missing() or "all there")
def test_64_bit_arm_gives_the_same_bits():
    inputs, steps = random_steps(300, 20, model=ALL_ON), np.full(299, 0.004)
    shown = arm.outputs_on_arm(ALL_ON, PROBES, np.column_stack(list(inputs.values())), 0.004)
    np.testing.assert_array_equal(shown, reference(ALL_ON, PROBES, inputs, steps)[1:])


@pytest.mark.skipif(sys.platform != "linux", reason="the GNU C library is Linux's")
def test_the_command_says_what_the_fmus_were_linked_to(tmp_path, capsys):
    """What `objdump` finds is the yardstick, where it is installed."""
    assert main(["export", "--flavour", "native", "-o", str(tmp_path)]) == 0
    said = next(line for line in capsys.readouterr().out.splitlines() if "GNU C library" in line)
    with zipfile.ZipFile(tmp_path / "VppPlant.native.fmu") as packed:
        library = next(name for name in packed.namelist() if name.endswith(".so"))
        packed.extract(library, tmp_path)
    if tool := shutil.which("objdump"):
        shown = subprocess.run([tool, "-T", tmp_path / library], check=True, capture_output=True, text=True).stdout
        newest = max(re.findall(r"GLIBC_(\d+)\.(\d+)", shown), key=lambda v: (int(v[0]), int(v[1])))
        assert f"GNU C library {'.'.join(newest)} and newer" in said
    if find_spec("ziglang"):
        assert "GNU C library 2.14 and newer" in said or "GNU C library 2.2.5 and newer" in said


def test_an_fmu_made_on_64_bit_arm_is_found_under_both_names(monkeypatch):
    monkeypatch.setattr(toolchain.platform, "machine", lambda: "aarch64")
    monkeypatch.setattr(toolchain, "_for_this_machine", lambda name, text: b"library")
    assert set(toolchain.binaries("M", "", "host")) == {"binaries/aarch64-linux/M.so", "binaries/linux64/M.so"}


def test_the_loader_finds_it_there_under_fmis_name(fmus, monkeypatch):
    fmu, own = fmus["plain"], Path(fmus["plain"].folder, "binaries", "aarch64-linux", "VppPlant.so")
    fmpys = fmu.library
    assert fmpys.is_file()
    monkeypatch.setattr("vpp_fmu.fmu.platform.machine", lambda: "aarch64")
    assert fmu.library == fmpys
    own.parent.mkdir()
    own.write_bytes(b"")
    assert fmu.library == own
    shutil.rmtree(own.parent)


def test_without_a_compiler_it_is_said_in_one_line(no_compiler, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(toolchain, "find_spec", lambda name: None)
    for platforms, words in (("host", "no C compiler found"), ("all", "pip install 'vpp-fmu[cross]'")):
        assert main(["export", "--flavour", "native", "--platforms", platforms, "-o", str(tmp_path)]) == 2
        said = capsys.readouterr().err
        assert words in said
        assert len(said.splitlines()) == 1
    assert not list(tmp_path.iterdir())


OWN_MODEL = '''
"""A low-pass filter: tau dv/dt = input - v, exact for a held input."""

from vpp_fmu.kernel.types import Effect, Model, Parameter, Signal, State


def step(ops, s, x, p, dt):
    v = ops.lag(x.v, s.input, p.tau, dt)
    return {"output": v}, {"v": v}


TAU = Parameter("tau", "s", 0.1, 0.001, 10.0, "time constant", 0.1)
V = State("v", "V", "voltage of the capacitor", lambda ops, s, p: s.input)
LOW_PASS = Effect("low_pass", "one resistor, one capacitor", step, (TAU,), (V,))
INPUT, OUTPUT = (Signal(n, "V", f"voltage at the {n}", -100.0, 100.0) for n in ("input", "output"))
MODEL = Model("RcFilter", "Low-pass filter", (INPUT,), (OUTPUT,), (LOW_PASS,))
'''


def test_a_model_of_ones_own_becomes_an_fmu(tmp_path, monkeypatch, capsys):
    (tmp_path / "rc_filter.py").write_text(OWN_MODEL)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    assert main(["export", "--model", "rc_filter:MODEL", "--flavour", "both", "-o", "out"]) == 0
    time = np.arange(251) * 0.004
    for suffix in ("", ".native"):
        slave = Slave(Fmu(f"out/RcFilter{suffix}.fmu"))
        shown = [slave.step({"input": 5.0}, 0.004, "output")[0] for _ in time[1:]]
        np.testing.assert_allclose(shown, 5.0 * (1.0 - np.exp(-time[1:] / 0.1)), rtol=1e-12)
    capsys.readouterr()
    (tmp_path / "odd_unit.py").write_text(OWN_MODEL.replace('"V"', '"bit"'))
    for wrong in ("odd_unit:MODEL", "rc_filter:TAU", "rc_filter:NONE", "no_such_module:MODEL", "rc_filter", ":"):
        assert main(["export", "--model", wrong, "-o", "out"]) == 2
        said = capsys.readouterr().err
        assert wrong in said
        assert len(said.splitlines()) == 1


def test_simulation_failures_name_the_fmu(fmus):
    instance = FmuInstance(fmus["plain"], ["omega_ref"], ["thrust"])
    instance.start([0.0])
    with pytest.raises(SimulationFailed, match="omega_ref can't be set to nan"):
        instance.stepper(0.004)([float("nan")])
    assert Simulation(BASE).outputs["thrust"] == 0.0
