"""Hosts that are not Python, and FMU checkers: their requirements, and the message if these are missing."""

import sys

import pytest
from builders import MODELS, native, needs_compiler

from tests.interop import hosts
from vpp_fmu.app.cli import main
from vpp_fmu.export import python_fmu
from vpp_fmu.fmu import Fmu

pytestmark = needs_compiler


@pytest.fixture(scope="module")
def host(tmp_path_factory):
    if sys.platform != "linux":
        pytest.skip("the host is Linux's")
    return hosts.built(tmp_path_factory.mktemp("host"))


@pytest.mark.parametrize("name", ["plain", "controller"])
def test_the_readmes_three_lines_bring_python_into_a_host_in_c(host, name, tmp_path):
    """Without these lines the Python FMU can't be loaded; with them it gives the native FMU's numbers to the last bit."""
    shown = {}
    for flavour, content in (("python", python_fmu(*MODELS[name])), ("native", native(name))):
        (tmp_path / f"{flavour}.fmu").write_bytes(content)
        shown[flavour] = Fmu(tmp_path / f"{flavour}.fmu")
    refused = hosts.in_c(host, shown["python"])
    assert refused.returncode == 2
    assert "undefined symbol: _Py_" in refused.stderr
    compiled = hosts.in_c(host, shown["native"])
    assert (compiled.returncode, compiled.stderr) == (0, "")
    assert any(float(x) for x in compiled.stdout.split())
    lines = hosts.three_lines()
    assert len(lines.splitlines()) == 3
    if lacks := hosts.no_libpython():
        pytest.skip(lacks)
    python = hosts.in_c(host, shown["python"], lines)
    assert (python.returncode, python.stderr) == (0, "")
    assert python.stdout == compiled.stdout


@pytest.mark.parametrize(("flavour", "points"), [("python", True), ("native", False), ("both", False)])
def test_the_export_points_hosts_without_python_to_the_native_flavour(flavour, points, tmp_path, capsys):
    assert main(["export", "--flavour", flavour, "-o", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert ("--flavour native" in said) == points
