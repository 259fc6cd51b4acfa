"""The closed loop as SSP: valid, within the subset that importers support, with its values; run by those installed."""

import io
import json
import subprocess
import sys
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from fmpy.ssp.ssd import read_ssd
from fmpy.util import read_ref_opt_file

from vpp_fmu.app.api.export import exported
from vpp_fmu.app.cli import main
from vpp_fmu.export import python_fmu
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.ssp import SSC, SSD, SSV, loop_ssp

INNER = {
    ("VppPlant", "thrust", "VppController", "thrust"),
    ("VppController", "omega_ref", "VppPlant", "omega_ref"),
    ("VppController", "beta_ref", "VppPlant", "beta_ref"),
}
CHANGED = {"tau_beta_2": 0.05, "c21": 0.7}


@pytest.fixture(scope="module")
def parts():
    """Plant with changed values and controller: their parameters and FMUs."""
    sets = {"VppPlant": ParameterSet(BASE).replaced(CHANGED), "VppController": ParameterSet(CONTROLLER)}
    return {name: (part, python_fmu(part.model, part.values)) for name, part in sets.items()}


@pytest.fixture(scope="module")
def loop(parts):
    """Content of the archive by name."""
    with zipfile.ZipFile(io.BytesIO(loop_ssp(parts, {"thrust_set": 8.0}, 10.0))) as packed:
        return {name: packed.read(name) for name in packed.namelist()}


def test_it_holds_structure_fmus_and_values(loop, parts):
    resources = {f"resources/{name}.{kind}" for name in parts for kind in ("fmu", "ssv")} | {"resources/VppLoop.ssv"}
    assert set(loop) == {"SystemStructure.ssd", *resources}
    for name, (_, fmu) in parts.items():
        assert loop[f"resources/{name}.fmu"] == fmu


def test_fmpy_finds_it_valid_and_whole(parts, tmp_path):
    path = tmp_path / "loop.ssp"
    path.write_bytes(loop_ssp(parts, {}, 10.0))
    system = read_ssd(str(path)).system  # against the standard's schema
    assert [c.name for c in system.elements] == list(parts)
    outside = {("thrust_set", "input"), ("thrust", "output"), ("omega", "output"), ("beta", "output")}
    assert {(c.name, c.kind) for c in system.connectors} == outside
    assert connected(system) == INNER | {
        (None, "thrust_set", "VppController", "thrust_set"),
        *(("VppPlant", name, None, name) for name in ("thrust", "omega", "beta")),
    }


def connected(system):
    return {(c.startElement, c.startConnector, c.endElement, c.endConnector) for c in system.connections}


def test_the_flat_ssp_is_the_same_without_connectors_of_the_system(parts, tmp_path):
    path = tmp_path / "loop.flat.ssp"
    path.write_bytes(loop_ssp(parts, {}, 10.0, connectors=False))
    system = read_ssd(str(path)).system
    assert not system.connectors
    assert connected(system) == INNER


def test_connectors_have_kinds_and_units(loop):
    root = ElementTree.fromstring(loop["SystemStructure.ssd"])
    units = {u.get("name") for u in root.iter(f"{{{SSC}}}Unit")}
    for component in root.iter(f"{{{SSD}}}Component"):
        model = {"VppPlant": BASE, "VppController": CONTROLLER}[component.get("name")]
        shown = {(c.get("name"), c.get("kind"), c[0].get("unit")) for c in component.iter(f"{{{SSD}}}Connector")}
        kinds = (("input", model.inputs), ("output", model.outputs))
        assert shown == {(s.name, kind, s.unit) for kind, signals in kinds for s in signals}
        assert {unit for *_, unit in shown} <= units
    assert root.get("version") == "1.0"


def test_values_are_bound_to_their_components_in_sets_of_one_name(loop, parts):
    names = set()
    for name, (parameters, _) in parts.items():
        root = ElementTree.fromstring(loop[f"resources/{name}.ssv"])
        names.add(root.get("name"))
        shown = {p.get("name"): json.loads(p[0].get("value")) for p in root.iter(f"{{{SSV}}}Parameter")}
        assert shown == parameters.values | ({"thrust_set": 8.0} if name == "VppController" else {})
    assert names == {"VppLoop"}
    root = ElementTree.fromstring(loop["resources/VppLoop.ssv"])
    assert {p.get("name"): p[0].get("value") for p in root.iter(f"{{{SSV}}}Parameter")} == {"thrust_set": "8.0"}


def test_the_bytes_depend_on_the_arguments_alone(parts):
    first = loop_ssp(parts, {"thrust_set": 8.0}, 10.0)
    assert loop_ssp(parts, {"thrust_set": 8.0}, 10.0) == first
    assert loop_ssp(parts, {"thrust_set": 9.0}, 10.0) != first


def test_the_cross_check_has_its_folders_and_its_numbers(tmp_path):
    """With the folder names of the FMI project's rules; fmpy, run by the command on the page, reproduces the references."""
    assert main(["export", "--cross-check", "-o", str(tmp_path / "out")]) == 0
    with zipfile.ZipFile(tmp_path / "out" / "cross_check.zip") as packed:
        packed.extractall(tmp_path)
    [folder] = (tmp_path / "fmus" / "2.0" / "cs").glob("*/vpp-fmu-python/*/VppPlant")
    ends = {f"VppPlant{end}" for end in (".fmu", "_in.csv", "_ref.csv", "_ref.opt")}
    assert {path.name for path in folder.iterdir()} == ends | {"README.md"}
    for name in ends:
        assert (folder / name).read_bytes() == (tmp_path / "out" / name).read_bytes()
    page = (folder / "README.md").read_text()
    assert "fmuCheck" in page
    [command] = [line.split() for line in page.splitlines() if line.startswith("    fmpy")]
    subprocess.run([Path(sys.executable).parent / command[0], *command[1:]], cwd=folder, check=True, capture_output=True)
    shown, exact = (np.genfromtxt(folder / f"VppPlant_{which}.csv", delimiter=",", names=True) for which in ("out", "ref"))
    np.testing.assert_allclose(shown["thrust"], exact["thrust"], rtol=1e-9, atol=1e-9)
    options = read_ref_opt_file(folder / "VppPlant_ref.opt")
    assert options["StopTime"] == pytest.approx((len(exact) - 1) * options["StepSize"])


def test_export_names_both_flavours_and_makes_all_before_it_writes(monkeypatch, tmp_path):
    parts = [ParameterSet(BASE), ParameterSet(CONTROLLER)]
    monkeypatch.setattr("vpp_fmu.app.api.export.native_fmu", lambda *_, **__: b"compiled")
    files = exported(parts, ["python", "native"], flat=True)
    assert {name for name in files if name.endswith((".fmu", ".ssp"))} == {
        *("VppPlant.fmu", "VppController.fmu", "VppLoop.ssp", "VppLoop.flat.ssp"),
        *("VppPlant.native.fmu", "VppController.native.fmu", "VppLoop.native.ssp", "VppLoop.native.flat.ssp"),
    }
    assert files["VppPlant.native.fmu"] == b"compiled"
