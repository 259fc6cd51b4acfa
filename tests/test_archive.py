"""Archives that are no FMI 2.0 co-simulation FMU, or too large, are refused in one line, and no FMU leaves files behind."""

import contextlib
import os
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from bad_fmus import CHANGED, FORGED, bad_fmus

from vpp_fmu.errors import BadInput, VppError
from vpp_fmu.fmu import Fmu, simulate_in_fmpy
from vpp_fmu.plants import FmuController, FmuPlant
from vpp_fmu.record import Record

MORE = ("packed by bzip2", "cut off", "text", "empty", "a folder", "nowhere", "below a file")


@pytest.fixture(scope="module")
def bad(fmu_files, tmp_path_factory):
    return bad_fmus(fmu_files["plain"], tmp_path_factory.mktemp("bad"))


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """A folder for temporary files of the test's own."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


@pytest.mark.parametrize("what", [*CHANGED, *FORGED, *MORE])
def test_a_bad_archive_is_refused_in_one_line_and_leaves_no_files(bad, temporary, what):
    path, words = bad[what]
    before = Path.cwd()
    with pytest.raises(BadInput) as refused, contextlib.closing(FmuPlant(path)) as plant:
        plant.start(4000.0, 5.0)
    said = str(refused.value)
    assert str(path) in said
    assert "\n" not in said
    assert [word for word in words if word not in said] == []
    assert os.listdir(temporary) == []
    assert Path.cwd() == before


def test_closing_an_fmu_removes_its_folder(fmu_files, temporary):
    with contextlib.closing(Fmu(fmu_files["plain"])) as fmu:
        assert [temporary / name for name in os.listdir(temporary)] == [fmu.folder]
        with zipfile.ZipFile(fmu_files["plain"]) as archive:
            held = {name: archive.read(name) for name in archive.namelist() if not name.endswith("/")}
        found = {str(p.relative_to(fmu.folder)): p.read_bytes() for p in fmu.folder.rglob("*") if p.is_file()}
        assert found == held
    assert os.listdir(temporary) == []


def test_an_fmu_without_the_required_variables_leaves_no_files(fmu_files, temporary):
    with pytest.raises(BadInput, match="role: found a plant FMU"):
        FmuController(fmu_files["plain"])
    with pytest.raises(BadInput, match="no such parameter"):
        FmuPlant(fmu_files["plain"], {"tau_gamma": 1.0})
    assert os.listdir(temporary) == []


def test_a_simulation_in_fmpy_leaves_no_files(fmu_files, temporary, bad):
    columns = {"time": [0.0, 0.004, 0.008], "omega_ref": [4000.0] * 3, "beta_ref": [5.0] * 3}
    record = Record({name: np.array(values) for name, values in columns.items()}, "test")
    assert len(simulate_in_fmpy(fmu_files["plain"], record)) == 3
    for what in ("library no library", "FMI 3.0"):
        with pytest.raises(VppError, match=bad[what][0].name):
            simulate_in_fmpy(bad[what][0], record)
    assert os.listdir(temporary) == []
