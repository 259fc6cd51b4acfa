"""The native FMU in FMI 3.0: valid, with the bits and the refusals of FMI 2.0."""

import ctypes
import shutil
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import builders
import fmpy
import numpy as np
import pytest
from builders import native, needs_compiler, random_steps
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from fmu_src.two_masses import MODEL
from vpp_fmu.app.cli import main
from vpp_fmu.export import native_fmu

pytestmark = needs_compiler
MODELS = {name: builders.MODELS[name] for name in ("plain", "controller")} | {"two masses": (MODEL, {})}
each_model = pytest.mark.parametrize("name", MODELS)
HIGH = {"thrust_set": 12.0, "thrust": 10.0, "force": 30.0, "brake": 1.0}


@pytest.fixture(scope="module")
def paths(tmp_path_factory):
    """Paths of each model's FMUs by version."""
    folder = tmp_path_factory.mktemp("fmi3")
    found = {}
    for name, (model, values) in MODELS.items():
        for version in ("2.0", "3.0"):
            found[name, version] = folder / f"{name}.{version}.fmu"
            built = native(name, version) if name in builders.MODELS else native_fmu(model, values, version=version)
            found[name, version].write_bytes(built)
    return found


@each_model
def test_fmpy_finds_no_problem(paths, name):
    assert validate_fmu(str(paths[name, "3.0"])) == []


def held(model, rows=500):
    """Inputs that change from time to time, as a table for fmpy."""
    if model.name == "VppPlant":
        inputs = random_steps(rows, 50, seed=3, model=model)
    else:
        rng = np.random.default_rng(3)
        inputs = {u.name: np.repeat(rng.uniform(0.0, HIGH[u.name], rows // 50), 50) for u in model.inputs}
        inputs = {n: np.round(column) if n == "brake" else column for n, column in inputs.items()}
    return np.rec.fromarrays([np.arange(rows) * 0.004, *inputs.values()], names=["time", *inputs])


@each_model
def test_its_outputs_are_those_of_fmi_2_to_the_bit(paths, name):
    table = held(MODELS[name][0])
    shown = [
        fmpy.simulate_fmu(str(paths[name, version]), input=table, stop_time=1.996, output_interval=0.004)
        for version in ("2.0", "3.0")
    ]
    for column in shown[0].dtype.names:
        np.testing.assert_array_equal(shown[0][column], shown[1][column], err_msg=column)
        assert column in ("time", "passes", "beyond") or np.ptp(shown[0][column]) > 0.0


@each_model
def test_it_has_the_same_variables_as_fmi_2(paths, name):
    def described(version):
        with zipfile.ZipFile(paths[name, version]) as packed:
            return ElementTree.fromstring(packed.read("modelDescription.xml"))

    old, new = described("2.0"), described("3.0")
    kinds = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean"}
    expected = [(kinds[v[0].tag], v.attrib | v[0].attrib) for v in old.iter("ScalarVariable")]
    *variables, time = new.find("ModelVariables")
    assert [(v.tag, v.attrib) for v in variables] == expected
    assert (time.get("name"), time.get("causality")) == ("time", "independent")
    assert old.find("CoSimulation").get("modelIdentifier") == new.find("CoSimulation").get("modelIdentifier")


@pytest.fixture
def slave(paths):
    """A fresh instance of the controller, and its messages."""
    path = str(paths["controller", "3.0"])
    description, folder = fmpy.read_model_description(path), fmpy.extract(path)
    instance = FMU3Slave(
        guid=description.guid, unzipDirectory=folder, modelIdentifier=description.coSimulation.modelIdentifier, instanceName="a"
    )
    said = []
    instance.instantiate(
        loggingOn=True,
        logMessage=fmpy.fmi3.fmi3LogMessageCallback(lambda _e, status, kind, text: said.append((status, text.decode()))),
    )
    yield instance, said, {v.name: v.valueReference for v in description.modelVariables}
    instance.freeInstance()
    shutil.rmtree(folder)


def status(instance, name, *arguments):
    return getattr(instance.dll, name)(ctypes.c_void_p(instance.component), *arguments)


def test_calls_out_of_order_and_bad_values_are_refused(slave):
    instance, said, references = slave
    one, value = (ctypes.c_uint32 * 1)(references["thrust_set"]), (ctypes.c_double * 1)(float("nan"))
    size = ctypes.c_size_t(1)
    for name, arguments, words in (
        ("fmi3ExitInitializationMode", (), "found a call before the initialization mode"),
        ("fmi3GetFloat64", (one, size, value, size), "found a call before the initialization mode"),
        ("fmi3SetFloat64", (one, size, value, size), "thrust_set: found nan"),
        ("fmi3SetFloat64", (one, size, value, ctypes.c_size_t(2)), "1 references of 1 values and room for 2"),
        ("fmi3SetInt32", (one, size, (ctypes.c_int32 * 1)(), size), "found thrust_set of type Real"),
        ("fmi3GetInt8", (one, size, (ctypes.c_int8 * 1)(), size), "found a call before"),
        ("fmi3EnterEventMode", (), "fmi3EnterEventMode is not provided"),
        ("fmi3EnterConfigurationMode", (), "fmi3EnterConfigurationMode is not provided"),
    ):
        assert status(instance, name, *arguments) == 3, name
        assert said[-1][0] == 3
        assert words in said[-1][1]
        assert status(instance, "fmi3Reset") == 0


def test_time_is_a_variable_and_states_are_kept(slave):
    instance, _, references = slave
    instance.enterInitializationMode(startTime=5.0)
    instance.exitInitializationMode()
    instance.setFloat64([references["thrust_set"], references["thrust"]], [8.0, 7.0])
    assert instance.doStep(5.0, 0.004)[3] == 5.004
    kept = instance.getFMUState()
    data = instance.serializeFMUState(kept)
    shown = []
    for state in (None, kept, instance.deserializeFMUState(data)):
        if state is not None:
            instance.setFMUState(state)
        assert instance.getFloat64([references["time"]]) == [5.004]
        instance.doStep(5.004, 0.01)
        shown.append(instance.getFloat64([references["omega_ref"], references["beta_ref"]]))
    assert shown[0] == shown[1] == shown[2]
    instance.setBoolean([references["speed_only"]], [True])
    assert instance.getBoolean([references["speed_only"]]) == [True]


def test_the_command_exports_fmi_3_in_the_native_flavour_alone(tmp_path, refused):
    assert main(["export", "--flavour", "native", "--fmi", "3.0", "-o", str(tmp_path / "out")]) == 0
    written = {path.name for path in (tmp_path / "out").iterdir() if path.suffix in (".fmu", ".ssp")}
    assert written == {"VppPlant.fmi3.fmu", "VppController.fmi3.fmu"}
    for options, words in (
        (["--fmi", "3.0"], "--fmi: found 3.0 with --flavour python, expected --flavour native"),
        (["--fmi", "3.0", "--flavour", "both"], "--fmi: found 3.0 with --flavour both"),
        (["--fmi", "3.0", "--flavour", "native", "--flat"], "--flat: found --flat and --fmi 3.0"),
        (["--platforms", "all"], "--platforms: found all with --flavour python, expected --flavour native or both"),
    ):
        assert words in refused("export", *options, "-o", tmp_path / "none")
        assert not Path(tmp_path / "none").exists()
