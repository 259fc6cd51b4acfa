"""Every form of the zoo: the imported record equals the log, or one line gives the reason of its refusal and the remedy."""

import numpy as np
import pytest
from import_zoo import T, forms, text
from scipy.io import savemat

from vpp_fmu.record import read_record

FIRST_WORDS = ("import", "csv")
FORMS = forms()
NEEDS = {"Parquet": "pyarrow", "HDF5": "h5py"}
"""Libraries that read containers, by a word of the form's name."""


@pytest.mark.sampled("name")
@pytest.mark.parametrize("name", FORMS)
def test_a_form_is_imported_or_refused_in_one_line(name, tmp_path, printed, refused):
    for kind, library in NEEDS.items():
        if kind in name:
            pytest.importorskip(library, reason=f"{library} is not installed (extra import)")
    form = FORMS[name]
    path = form.written(tmp_path)
    if form.refused:
        told = refused(path, *form.words, "-o", tmp_path / "out")
        assert [part for part in form.refused if part not in told] == [], told
        assert not (tmp_path / "out").exists()
    for k, (words, expected) in enumerate(form.imports.items()):
        told = printed(path, *words, "-o", tmp_path / str(k))
        assert [part for part in form.said if part not in told] == [], told
        form.check(read_record(tmp_path / str(k) / "open_loop.csv", holes=("thrust",)).columns, expected)


def test_the_comparison_detects_a_changed_value(tmp_path, printed):
    text(thrust=T["thrust"] + 1e-4)(tmp_path / "log.csv")
    printed(tmp_path / "log.csv", "-o", tmp_path / "out")
    with pytest.raises(AssertionError, match="thrust"):
        FORMS["units in the names"].check(read_record(tmp_path / "out" / "open_loop.csv").columns, T)


def test_a_container_without_its_library_is_refused_with_the_extra_to_install(tmp_path, refused, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    (tmp_path / "log.parquet").write_bytes(b"PAR1" + bytes(20))
    error = refused(tmp_path / "log.parquet", "-o", tmp_path / "out")
    assert "only pyarrow reads, which is not installed" in error
    assert "vpp-fmu[import]" in error


def test_a_damaged_compressed_mat_file_is_refused(tmp_path, refused):
    path = tmp_path / "log.mat"
    savemat(path, {"time": np.arange(500.0)}, do_compression=True)
    content = bytearray(path.read_bytes())
    content[200] ^= 0xFF
    path.write_bytes(content)
    assert "MAT that its library does not read" in refused(path, "-o", tmp_path / "out")
