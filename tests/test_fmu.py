"""Both flavours of FMU in fmpy: valid, reproducible, equal to the kernel to the bit; kept states; clear refusals."""

import ast
import os
import subprocess
import sys
import sysconfig
import zipfile
from hashlib import sha256
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from builders import ALL_ON, MODELS, PROBES, Slave, native, needs_compiler, random_steps, reference, stepped
from fmpy.fmi1 import FMICallException
from fmpy.util import read_csv
from fmpy.validation import validate_fmu

import vpp_fmu
from vpp_fmu.export import native_fmu, python_fmu
from vpp_fmu.files import OutputFolder
from vpp_fmu.fmu import Fmu
from vpp_fmu.kernel.controller import CONTROLLER, SPEED_ONLY
from vpp_fmu.kernel.plant import BASE, plant
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.record import Record, read_record, write_record

OUTPUTS = ["thrust", "omega", "beta"]
MAKERS = {"python": python_fmu, "native": native_fmu}
each_fmu = pytest.mark.parametrize("name", MODELS)


@pytest.fixture(scope="module", params=["python", pytest.param("native", marks=needs_compiler)])
def make(request):
    """The function that makes an FMU of a flavour."""
    return MAKERS[request.param]


@pytest.fixture(scope="module")
def fmu_files(make, tmp_path_factory):
    """Paths of a flavour's FMUs."""
    folder = tmp_path_factory.mktemp("fmus")
    for name, (model, values) in MODELS.items():
        (folder / f"{name}.fmu").write_bytes(native(name) if make is native_fmu else make(model, values))
    return {name: folder / f"{name}.fmu" for name in MODELS}


@pytest.fixture(scope="module")
def fmus(fmu_files):
    """The FMUs, unpacked."""
    unpacked = {name: Fmu(path) for name, path in fmu_files.items()}
    yield unpacked
    for fmu in unpacked.values():
        fmu.close()


@each_fmu
def test_fmpy_finds_no_problem(fmu_files, name):
    assert validate_fmu(str(fmu_files[name])) == []


def described(path):
    with zipfile.ZipFile(path) as packed:
        return ElementTree.fromstring(packed.read("modelDescription.xml"))


@each_fmu
@pytest.mark.parametrize("causality", ["input", "output", "parameter", "local"])
def test_every_variable_says_what_it_is(fmu_files, name, causality):
    root = described(fmu_files[name])
    units = {unit.get("name") for unit in root.iter("Unit")}
    variables = [v for v in root.iter("ScalarVariable") if v.get("causality") == causality]
    assert variables
    switches = {("speed_only", "Boolean", "false"), ("mode", "Integer", "0")}
    for v in variables:
        assert v.get("description"), v.get("name")
        real = v.find("Real")
        if real is None:
            assert (v.get("name"), v[0].tag, v[0].get("start")) in switches
            continue
        assert real.get("unit") in units, v.get("name")
        if causality == "local":  # a state has no range: that of a signal in its unit is the signal's
            assert not {"min", "max"} & set(real.attrib)
            assert float(real.get("nominal")) > 0.0
            continue
        missing = {"min", "max", "nominal"} - set(real.attrib)
        assert not missing, f"{v.get('name')} has no {missing}"
        assert float(real.get("min")) < float(real.get("max"))
        assert float(real.get("min")) <= float(real.get("start", real.get("min"))) <= float(real.get("max"))


@each_fmu
def test_units_are_si_factors(fmu_files, name):
    factors = {u.get("name"): float(u[0].get("factor", 1.0)) for u in described(fmu_files[name]).iter("Unit")}
    turn = 2.0 * np.pi
    assert factors["rpm"] == pytest.approx(turn / 60.0, rel=1e-15)
    assert factors["deg"] == pytest.approx(turn / 360.0, rel=1e-15)
    assert factors.get("rpm.s/deg", 6.0) == pytest.approx(6.0, rel=1e-15)


def started(variable):
    return float(variable.start == "true") if variable.type == "Boolean" else float(variable.start)


@each_fmu
def test_the_contracts_variables_are_there(fmu_files, fmus, name):
    plant = ["tau_omega_1", "tau_omega_2", "tau_beta_1", "tau_beta_2", "c20", "c11", "c21", "c12", "c30"]
    pid = ["kp_omega", "ki_omega", "kd_omega", "kp_beta", "ki_beta", "kd_beta", "t_filter", "sample_time"]
    by = {"input": ["omega_ref", "beta_ref"], "output": OUTPUTS, "parameter": plant}
    if name == "controller":
        by = {"input": ["thrust_set", "thrust"], "output": ["omega_ref", "beta_ref"], "parameter": pid}
    if name == "all_on":
        by["parameter"] += list(PROBES)
    for causality, names in by.items():
        assert len(fmus[name].references(names, causality)) == len(names)
    shown = {v.name: started(v) for v in fmus[name].variables.values() if v.causality == "parameter"}
    model, values = MODELS[name]
    assert shown == model.values(values)


@each_fmu
def test_initial_unknowns_name_all_that_the_outputs_start_from(fmus, name):
    description = fmus[name].description
    listed = {u.variable.name: {d.name for d in u.dependencies} for u in description.initialUnknowns}
    outputs = [v.name for v in description.modelVariables if v.causality == "output"]
    assert set(listed) == set(outputs)
    inputs = {v.name: 0.97 * float(v.nominal) for v in description.modelVariables if v.causality == "input"}
    values = {v.name: started(v) for v in description.modelVariables if v.causality == "parameter"}
    ranges = {v.name: (float(v.min or 0), float(v.max or 1)) for v in description.modelVariables}
    rest = Slave(fmus[name], initialised=False).initialise(**inputs).get(*outputs)
    for changed, value in {**inputs, **values}.items():
        moved = 1.0 if changed == "speed_only" else np.clip(value * 0.999 + 1e-6, *ranges[changed])
        there = Slave(fmus[name], initialised=False).initialise(**{**inputs, changed: moved}).get(*outputs)
        for output, before, after in zip(outputs, rest, there, strict=True):
            assert before == after or changed in listed[output]
    if name == "controller":  # it has not sampled yet
        assert listed == {"omega_ref": set(), "beta_ref": set()}
        assert rest == [0.0, 0.0]


def in_a_new_process(code, folder, **variables):
    """Run Python code in another process, with the tests and this project on the path; its output."""
    path = os.pathsep.join(map(str, (Path(__file__).parent, Path(vpp_fmu.__file__).parents[1])))
    return subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | variables | {"PYTHONPATH": path},
        cwd=folder,
        check=True,
        capture_output=True,
        text=True,
    ).stdout.strip()


def test_two_builds_in_different_folders_have_the_same_bytes(make, tmp_path):
    name = "all_on" if make is python_fmu else "controller"
    model, values = MODELS[name]
    first = make(model, values) if make is python_fmu else native(name)
    code = f"from test_fmu import *; print(sha256({make.__name__}(*MODELS[{name!r}])).hexdigest())"
    elsewhere = in_a_new_process(code, tmp_path, PYTHONHASHSEED="7", TZ="Asia/Tokyo", TMPDIR=str(tmp_path))
    assert elsewhere == sha256(first).hexdigest()
    assert make is native_fmu or make(model, values | {model.parameters[0].name: 0.5}) != first


@each_fmu
def test_it_carries_no_path_of_this_machine_and_needs_nothing_of_this_project(make, fmu_files, name):
    places = [Path.cwd(), Path.home(), Path(__file__).parents[1], Path(sys.prefix), Path(os.path.realpath(sys.prefix))]
    sources = 0
    with zipfile.ZipFile(fmu_files[name]) as packed:
        for entry in packed.namelist():
            content = packed.read(entry)
            if "pythonfmu" not in entry and not entry.endswith(".png"):
                for place in (*map(str, places), "/tmp", sysconfig.get_paths()["purelib"]):
                    assert place.encode() not in content, f"{entry}: {place}"
            if entry.endswith(".py") and "pythonfmu/" not in entry:
                sources += 1
                for node in ast.walk(ast.parse(content)):
                    imported = [a.name for a in node.names] if isinstance(node, ast.Import) else []
                    imported += [node.module or "."] if isinstance(node, ast.ImportFrom) else []
                    for module in imported:
                        inside = f"resources/{module}.py" in packed.namelist()
                        assert inside or module.split(".")[0] in {*sys.stdlib_module_names, "pythonfmu"}, f"{entry}: {module}"
    assert sources == (2 if make is python_fmu else 0)  # the code, and the file that imports it for each instance


def test_steps_with_every_effect_are_the_kernels_to_the_bit(fmus, long_run):
    commands, _, exact = long_run
    np.testing.assert_array_equal(stepped(fmus["all_on"], commands), exact)


@pytest.mark.parametrize("make", ["python"], indirect=True)
def test_the_fmpy_command_runs_a_written_record_as_the_kernel_to_the_bit(fmu_files, tmp_path):
    rows = 401
    columns = {"time": np.arange(rows) * 0.004, **random_steps(rows, 60, model=ALL_ON), "thrust": np.linspace(1.0, 2.0, rows)}
    path = write_record(OutputFolder(tmp_path), "record.csv", Record(columns, "test"))
    record = read_record(path, list(columns)[:-1])
    steps = np.diff(np.arange(rows) * 0.004)  # fmpy's steps: differences of n h, that scatter by a rounding
    exact = reference(ALL_ON, PROBES, {u.name: record[u.name] for u in ALL_ON.inputs}, steps)
    options = {"--input-file": path, "--output-interval": 0.004, "--stop-time": 1.6, "--output-file": tmp_path / "out.csv"}
    words = ["simulate", fmu_files["all_on"], *(x for option in options.items() for x in option)]
    command = [Path(sys.executable).parent / "fmpy", *words]
    subprocess.run([str(x) for x in command], check=True, capture_output=True, text=True, cwd=tmp_path)
    result = read_csv(tmp_path / "out.csv")
    np.testing.assert_allclose(result["time"], record.time, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(np.column_stack([result[name] for name in OUTPUTS]), exact)


@pytest.mark.parametrize("make", ["python"], indirect=True)
def test_instances_of_several_fmus_do_not_mix(make, fmus, tmp_path):
    """Two plants and two controllers of the same names, different content, interleaved, beside this project's modules."""
    slow = tmp_path / "slow.fmu"
    slow.write_bytes(make(BASE, {"tau_omega_1": 0.5, "c21": 0.7}))
    speed_only = tmp_path / "speed_only.fmu"
    speed_only.write_bytes(make(CONTROLLER, SPEED_ONLY))
    slow, speed_only = Fmu(slow), Fmu(speed_only)
    pairs = [
        (Slave(fmus["plain"]), Simulation(BASE)),
        (Slave(fmus["controller"]), Simulation(CONTROLLER)),
        (Slave(slow), Simulation(BASE, {"tau_omega_1": 0.5, "c21": 0.7})),
        (Slave(speed_only), Simulation(CONTROLLER, SPEED_ONLY)),
        (Slave(fmus["plain"], False).initialise(tau_beta_1=0.9), Simulation(BASE, {"tau_beta_1": 0.9})),
        (Slave(fmus["all_on"]), Simulation(ALL_ON, PROBES)),
    ]
    rng = np.random.default_rng(0)
    for _, kernel in pairs:
        kernel.start({u.name: u.start for u in kernel.model.inputs})
    for dt in rng.choice([0.004, 0.0013, 0.011], 300).tolist():
        for slave, kernel in pairs:
            inputs = {u.name: float(rng.uniform(0.0, u.nominal)) for u in kernel.model.inputs}
            exact = kernel.advance(inputs, dt)
            assert slave.step(inputs, dt, *exact) == list(exact.values())
    for slave, _ in pairs:
        slave.free()
    slow.close()
    speed_only.close()


def all_values(slave):
    return slave.get(*slave.references)


@each_fmu
def test_a_kept_state_goes_on_to_the_bit(fmus, name):
    """At random times, with pending delays and between two samples of the controller: in place, and in a fresh instance."""
    rng, fmu = np.random.default_rng(1), fmus[name]
    slave, inputs = Slave(fmu), [u for u in fmu.variables.values() if u.causality == "input"]
    tuned = {"controller": "kp_omega"}.get(name, "tau_omega_1")

    def go_on(slave, script):
        return [slave.step(values, dt) or all_values(slave) for values, dt in script]

    def script(steps):
        held = [{u.name: float(rng.uniform(0.0, float(u.nominal))) for u in inputs} for _ in range(steps)]
        return list(zip(held, rng.choice([0.0011, 0.004, 0.0137], steps).tolist(), strict=True))

    go_on(slave, script(20))
    for _ in range(8):
        kept = slave.kept()
        before, ahead = all_values(slave), script(40)
        exact = go_on(slave, ahead)
        slave.restore(kept)
        assert all_values(slave) == before
        assert go_on(slave, ahead) == exact
        data = slave.fmi.serializeFMUstate(kept[0])
        fresh = Slave(fmu, initialised=False).initialise(**{tuned: 1.0})
        go_on(fresh, ahead[:1])  # it has been somewhere else, with another parameter and the same step
        fresh.restore((fresh.fmi.deSerializeFMUstate(data), kept[1]))
        assert go_on(fresh, ahead) == exact
        slave.fmi.freeFMUstate(kept[0])
        fresh.free()


@each_fmu
def test_reset_gives_a_fresh_instance(fmus, name):
    inputs = {v.name: 0.4 * float(v.nominal) for v in fmus[name].variables.values() if v.causality == "input"}
    slave, fresh = Slave(fmus[name], initialised=False), Slave(fmus[name])
    tuned = {"controller": "kp_omega"}.get(name, "tau_omega_1")
    slave.initialise(**{tuned: 0.9})
    slave.step(inputs, 0.05)
    slave.fmi.reset()
    slave.initialise()
    for _ in range(5):
        slave.step(inputs, 0.013)
        fresh.step(inputs, 0.013)
        assert all_values(slave) == all_values(fresh)


CHOSEN = {"plain": "state.omega_inner", "all_on": "state.omega_inner", "controller": "state.beta_integral"}


@each_fmu
def test_a_state_begins_where_it_is_set(fmus, name):
    """As in the kernel; states that are not set settle on the inputs."""
    (model, values), state = MODELS[name], CHOSEN[name].removeprefix("state.")
    simulation = Simulation(model, values)
    inputs = {u.name: 0.4 * u.nominal for u in model.inputs if not u.clock}
    inputs |= {u.name: u.start for u in model.inputs if u.clock}  # the age of a log's row, which an FMU does not have
    outputs = [s.name for s in model.outputs]
    slave = Slave(fmus[name], initialised=False)
    slave.set(**{CHOSEN[name]: 0.123})  # before the initialization mode, as in the standard
    slave.enter(**inputs)
    exact = simulation.start(inputs, {state: 0.123})
    assert slave.get(*outputs, CHOSEN[name]) == [*exact.values(), 0.123]
    assert exact != simulation.start(inputs) or name == "controller"
    simulation.start(inputs, {state: 0.123})
    slave.fmi.exitInitializationMode()
    for _ in range(20):
        assert slave.step(inputs, 0.004, *outputs) == list(simulation.advance(inputs, 0.004).values())
    slave.fmi.reset()
    slave.initialise(**inputs)
    assert slave.get(*outputs) == list(simulation.start(inputs).values())


def test_gains_are_tuned_while_the_controller_runs(fmus):
    """From the next sample on, as in the kernel with the new gains."""
    slave, kernel = Slave(fmus["controller"]), Simulation(CONTROLLER)
    inputs, names = {"thrust_set": 8.0, "thrust": 7.9}, ["omega_ref", "beta_ref"]
    kernel.start(inputs)
    for changes in ({}, {"kp_omega": 2.0, "ki_beta": 10.0}, {"speed_only": 1.0, "beta_fixed": 3.0}, {"omega_max": 2500.0}):
        slave.set(**changes)
        kernel.parameters.update(changes)
        for _ in range(7):
            assert slave.step(inputs, 0.004, *names) == list(kernel.advance(inputs, 0.004).values())
    assert slave.get("speed_only", "kp_omega") == [1.0, 2.0]


WAYS = {"Exact": BASE, "Sampled": CONTROLLER, "Scheduled": plant(["pitch_delay"])}


@pytest.mark.parametrize("way", WAYS)
def test_after_a_step_without_numbers_the_last_ones_can_be_read(make, way, tmp_path):
    """Outputs and states are those before a step without finite numbers, for each way of stepping."""
    model = WAYS[way]
    (tmp_path / "model.fmu").write_bytes(make(model))
    fmu, given = Fmu(tmp_path / "model.fmu"), model.inputs[0]
    kept = [n for n, v in fmu.variables.items() if v.causality in ("output", "local")]
    slave = Slave(fmu)
    for _ in range(5):
        last = slave.step({given.name: 0.5 * given.nominal}, 0.004, *kept)
    with pytest.raises(FMICallException):  # the first steps may still give numbers
        last = [slave.step({given.name: 1.7e308}, 0.004, *kept) for _ in range(5)][-1]
    assert "found no finite numbers from" in slave.messages[-1]
    assert slave.get(*kept) == last
    assert any(last)
    assert np.isfinite(last).all()
