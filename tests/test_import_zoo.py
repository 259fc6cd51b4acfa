"""Every format of the zoo: the imported record equals the log, or one line gives the reason of its refusal."""

import numpy as np
import pytest
from import_zoo import Format, came_out, containers, formats, text
from scipy.io import savemat

from vpp_fmu.app.cli import main

NEEDS = {"Parquet": "pyarrow", "HDF5": "h5py", "MAT v7.3": "h5py"}
"""Libraries that read containers, by the beginning of a format's name."""


@pytest.fixture
def run(capsys):
    """The command line: its exit code, output and errors."""
    return lambda words: (main(words), *capsys.readouterr())


@pytest.mark.sampled("format")
@pytest.mark.parametrize("format", formats(), ids=lambda format: format.name)
def test_the_imported_record_equals_the_log(format, tmp_path, run):
    if format in containers() or "half a" in format.name:
        for kind, library in NEEDS.items():
            if kind in format.name:
                pytest.importorskip(library, reason=f"{library} is not installed (extra import)")

    good, told = came_out(format, tmp_path, run)
    assert good, told


def test_the_comparison_detects_a_changed_value(tmp_path, run):
    off = Format("off", lambda path, t: text()(path, t | {"thrust": t["thrust"] + 1e-4}))
    assert not came_out(off, tmp_path, run)[0]


def test_a_container_without_its_library_is_refused_with_the_extra_to_install(tmp_path, refused, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    path = tmp_path / "log.parquet"
    path.write_bytes(b"PAR1" + bytes(20))
    error = refused("import", "csv", path, "-o", tmp_path / "out")
    assert "only pyarrow reads, which is not installed" in error
    assert "vpp-fmu[import]" in error


def test_a_damaged_compressed_mat_file_is_refused(tmp_path, refused):
    path = tmp_path / "log.mat"
    savemat(path, {"time": np.arange(500.0)}, do_compression=True)
    content = bytearray(path.read_bytes())
    content[200] ^= 0xFF
    path.write_bytes(content)
    assert "MAT that its library does not read" in refused("import", "csv", path, "-o", tmp_path / "out")
