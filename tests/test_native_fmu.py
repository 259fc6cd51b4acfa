"""The native FMU: the tests of the Python flavour, the archive, reproducible builds, compilers and platforms."""

import io
import os
import platform
import re
import shutil
import subprocess
import sys
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
from builders import ALL_ON, MODELS, PROBES, Slave, native, random_steps, reference, stepped
from fmpy.build import build_platform_binary
from fmpy.model_description import read_build_description

from fmu_src.two_masses import MODEL as TWO_MASSES
from vpp_fmu.errors import CompilerMissing
from vpp_fmu.export import native_fmu, toolchain
from vpp_fmu.export.c_text import c_text
from vpp_fmu.fmu import Fmu
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.native import compiler

try:
    CC = compiler.compiler()
except CompilerMissing as missing:
    pytest.skip(f"native FMUs: {missing}", allow_module_level=True)

zig = pytest.mark.skipif(not find_spec("ziglang"), reason="ziglang is not installed (the extra 'cross')")
each_fmu = pytest.mark.parametrize("name", MODELS)
OUTPUTS = test_fmu.OUTPUTS


@pytest.fixture(scope="module")
def fmu_files(tmp_path_factory):
    """Paths of native FMUs under the names that the Python flavour's tests use."""
    folder = tmp_path_factory.mktemp("native")
    for name in MODELS:
        (folder / f"{name}.fmu").write_bytes(native(name))
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
test_2000_steps = test_fmu.test_2000_steps_with_every_effect_are_the_kernels_to_the_bit
test_a_kept_state = test_fmu.test_a_kept_state_goes_on_to_the_bit
test_reset_gives_a_fresh_instance = test_fmu.test_reset_gives_a_fresh_instance
test_a_state_begins_where_it_is_set = test_fmu.test_a_state_begins_where_it_is_set
test_gains_are_tuned_while_the_controller_runs = test_fmu.test_gains_are_tuned_while_the_controller_runs


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


@pytest.mark.parametrize("name", ["controller"])
def test_two_builds_in_different_folders_have_the_same_bytes(fmu_files, name, tmp_path):
    first = fmu_files[name].read_bytes()
    code = f"from test_native_fmu import *; print(sha256(native_fmu(*MODELS[{name!r}])).hexdigest())"
    places = {"TMPDIR": str(tmp_path), "PYTHONHASHSEED": "3", "TZ": "Asia/Tokyo"}
    assert test_fmu.in_a_new_process(code, tmp_path, **places) == sha256(first).hexdigest()
    with zipfile.ZipFile(io.BytesIO(first)) as packed:
        for place in (str(Path.cwd()), str(Path.home()), "/tmp", sys.prefix):
            assert all(place.encode() not in packed.read(entry) for entry in packed.namelist())


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
    np.testing.assert_array_equal(stepped(fmu, commands), exact)
    fmu.close()


@pytest.mark.parametrize(("name", "version"), [("plain", "2.0"), ("all_on", "2.0"), ("controller", "3.0")])
def test_its_build_description_is_valid(name, version):
    """By FMI 3.0's schema and its table of SourceFileSet: options require the name of a compiler."""
    fmu = io.BytesIO(native(name, version))
    (build,) = read_build_description(fmu)
    assert build.modelIdentifier == MODELS[name][0].name
    with zipfile.ZipFile(fmu) as packed:
        assert [f"sources/{file}" in packed.namelist() for file in build.sourceFileSets[0].sourceFiles] == [True]
        root = ElementTree.fromstring(packed.read("sources/buildDescription.xml"))
    sets = [set(sources.attrib) for sources in root.iter("SourceFileSet")]
    assert all("compiler" in given or "compilerOptions" not in given for given in sets)


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the flag is x86-64's")
def test_its_source_allows_no_fused_multiply_add(tmp_path):
    """Whatever the compiler's options: the build description names none."""
    (tmp_path / "plant.c").write_text(c_text(BASE, BASE.values(), "{}"))
    command = [CC, "-std=gnu99", "-O3", "-w", "-mfma", "-S", "-o", "plant.s", "plant.c"]
    subprocess.run(command, cwd=tmp_path, check=True)
    assert not re.search(r"\tvfn?m(add|sub)", (tmp_path / "plant.s").read_text())


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_its_source_draws_no_warning(version, tmp_path):
    for model, values in (*MODELS.values(), (TWO_MASSES, {})):
        (tmp_path / "model.c").write_text(c_text(model, values | model.values(values), "{}", version))
        strict = [CC, "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only", "model.c"]
        for more in ([], ["-DFMI2_FUNCTION_PREFIX=Vpp_"]):
            subprocess.run([*strict, *more], cwd=tmp_path, check=True)


@test_fmu.each_way
def test_after_a_step_without_numbers_the_last_ones_can_be_read(way, tmp_path):
    test_fmu.keeps_the_last_numbers(native_fmu, test_fmu.WAYS[way], tmp_path)


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
        assert test_fmu.in_a_new_process(code, tmp_path, TMPDIR=str(tmp_path)) == sha256(built).hexdigest()


@pytest.mark.skipif(bool(arm.missing()), reason=arm.missing() or "all there")
def test_64_bit_arm_gives_the_same_bits():
    inputs, steps = random_steps(300, 20, model=ALL_ON), np.full(299, 0.004)
    shown = arm.outputs_on_arm(ALL_ON, PROBES, np.column_stack(list(inputs.values())), 0.004)
    np.testing.assert_array_equal(shown, reference(ALL_ON, PROBES, inputs, steps)[1:])


def test_without_a_compiler_the_export_is_refused_in_one_line(no_compiler, monkeypatch, refused, tmp_path):
    monkeypatch.setattr(toolchain, "find_spec", lambda name: None)
    for platforms, words in (("host", "no C compiler found"), ("all", "pip install 'vpp-fmu[cross]'")):
        assert words in refused("export", "--flavour", "native", "--platforms", platforms, "-o", tmp_path)
    assert not list(tmp_path.iterdir())
