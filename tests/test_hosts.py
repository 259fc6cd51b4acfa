"""Hosts that are not Python, and FMU checkers: their requirements, and the message if these are missing."""

import sys

import pytest
from builders import MODELS, native

from tests.interop import hosts
from vpp_fmu.app.cli import main
from vpp_fmu.errors import CompilerMissing
from vpp_fmu.export import python_fmu
from vpp_fmu.fmu import Fmu


@pytest.fixture(scope="module")
def host(tmp_path_factory):
    if sys.platform != "linux":
        pytest.skip("the host is Linux's")
    try:
        return hosts.built(tmp_path_factory.mktemp("host"))
    except CompilerMissing as missing:
        pytest.skip(f"no host: {missing}")


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
    try:
        assert main(["export", "--flavour", flavour, "-o", str(tmp_path)]) == 0
    except CompilerMissing as missing:
        pytest.skip(f"native FMUs: {missing}")
    said = capsys.readouterr().out
    assert ("--flavour native" in said) == points


def test_a_checker_is_found_by_its_environment_variable_or_reported_as_not_run(tmp_path, monkeypatch):
    """The row shows its exit code and its last line or verdict, for the versions of FMI that it supports."""
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    monkeypatch.setattr("sys.executable", "/usr/bin/python3")
    for checker in hosts.CHECKERS:
        monkeypatch.delenv(checker.variable, raising=False)
    fmus = {("plant", "native", version): tmp_path / f"plant{version}.fmu" for version in ("2.0", "3.0")}
    rows = hosts.checked(fmus)
    assert [row.split("|")[1].strip() for row in rows] == ["VDMCheck2", "VDMCheck3", "fmusim", "fmutool", "fmuCheck"]
    assert all("not run here" in row for row in rows)
    checker = tmp_path / "checker"
    checker.write_text('#!/bin/sh\necho reading\necho "$# words, of $(basename $1)"\nexit 3\n')
    checker.chmod(0o755)
    monkeypatch.setenv("VDMCHECK2", str(checker))
    assert hosts.checked(fmus)[0] == "| VDMCheck2 | plant, native, FMI 2.0 | 3: 1 words, of plant2.0.fmu |"
    assert len(hosts.checked(fmus)) == len(rows)
    checker.write_text('#!/bin/sh\necho "INFO | it is compliant"\necho reading\necho "No semantic error"\necho not saved\n')
    monkeypatch.setenv("FMUTOOL", str(checker))
    assert hosts.checked(fmus)[3:5] == [
        f"| fmutool | plant, native, FMI {version} | 0: INFO it is compliant No semantic error |" for version in ("2.0", "3.0")
    ]
