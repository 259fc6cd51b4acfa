"""The native FMU alone: its description, compilers and platforms. What it shares with the Python flavour: test_fmu.py."""

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
from builders import ALL_ON, MODELS, PROBES, native, needs_compiler, random_steps, reference, stepped
from fmpy.build import build_platform_binary
from fmpy.model_description import read_build_description
from test_fmu import in_a_new_process

from fmu_src.two_masses import MODEL as TWO_MASSES
from vpp_fmu.export import native_fmu, python_fmu, toolchain
from vpp_fmu.export.c_text import c_text
from vpp_fmu.fmu import Fmu
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.native.compiler import compiler

pytestmark = needs_compiler
zig = pytest.mark.skipif(not find_spec("ziglang"), reason="ziglang is not installed (the extra 'cross')")
each_fmu = pytest.mark.parametrize("name", MODELS)


@each_fmu
def test_both_flavours_describe_the_same_variables(name):
    def described(data):
        with zipfile.ZipFile(data) as packed:
            root = ElementTree.fromstring(packed.read("modelDescription.xml"))
            return (
                root.attrib,
                root.find("CoSimulation").attrib,
                [ElementTree.tostring(e) for e in root if e.tag != "CoSimulation"],
            )

    own, python = (described(io.BytesIO(data)) for data in (native(name), python_fmu(*MODELS[name])))
    assert own[2] == python[2]
    assert own[0]["guid"] != python[0]["guid"]
    assert own[1]["needsExecutionTool"] == "false"
    assert own[1]["providesDirectionalDerivative"] == "true"


@pytest.mark.skipif(not shutil.which("cmake", path=f"{Path(sys.executable).parent}:{os.environ['PATH']}"), reason="no cmake")
def test_fmpy_compiles_it_from_its_sources(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    monkeypatch.setattr(subprocess, "check_call", partial(subprocess.run, check=True, capture_output=True))
    (tmp_path / "plain.fmu").write_bytes(native("plain"))
    fmpy.extract(str(tmp_path / "plain.fmu"), unzipdir=str(tmp_path))
    shutil.rmtree(tmp_path / "binaries")
    (tmp_path / "build").mkdir()
    build_platform_binary(tmp_path, tmp_path / "build")
    fmu = Fmu(tmp_path / "plain.fmu")
    shutil.copytree(tmp_path / "binaries", Path(fmu.folder, "binaries"), dirs_exist_ok=True)
    commands = random_steps(501, 40)
    np.testing.assert_array_equal(stepped(fmu, commands), reference(BASE, {}, commands, np.full(500, 0.004)))
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
    command = [compiler(), "-std=gnu99", "-O3", "-w", "-mfma", "-S", "-o", "plant.s", "plant.c"]
    subprocess.run(command, cwd=tmp_path, check=True)
    assert not re.search(r"\tvfn?m(add|sub)", (tmp_path / "plant.s").read_text())


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_its_source_draws_no_warning(version, tmp_path):
    for model, values in (*MODELS.values(), (TWO_MASSES, {})):
        (tmp_path / "model.c").write_text(c_text(model, values | model.values(values), "{}", version))
        strict = [compiler(), "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only", "model.c"]
        for more in ([], ["-DFMI2_FUNCTION_PREFIX=Vpp_"]) if model is BASE else ([],):
            subprocess.run([*strict, *more], cwd=tmp_path, check=True)


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
        assert in_a_new_process(code, tmp_path, TMPDIR=str(tmp_path)) == sha256(built).hexdigest()


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
