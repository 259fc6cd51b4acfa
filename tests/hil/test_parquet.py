"""Records as Parquet: columns equal to the bit, units in the schema, and back through `vpp import csv`."""

import json

import numpy as np
import pytest

from vpp_fmu.campaign import read_campaign
from vpp_fmu.table import read_table

parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed (the extra 'import')")

pytestmark = pytest.mark.usefixtures("short_waits")


def test_a_run_has_its_columns_to_the_bit_with_units(tmp_path, profile, printed):
    printed("hil", "run", "--virtual", "--profile", profile, "--records", "parquet", "-o", tmp_path)
    (folder,) = (tmp_path / "runs").iterdir()
    table, text = parquet.read_table(folder / "run.parquet"), read_table(folder / "run.csv")
    for name in table.column_names:
        np.testing.assert_array_equal(table[name].to_numpy(), text.numbers(name), strict=True)
    units = {field.name: field.metadata[b"unit"].decode() for field in table.schema}
    assert units == {
        **{"time": "s", "thrust_set": "N", "thrust": "N", "omega": "rpm", "omega_ref": "rpm", "beta_ref": "deg"},
        **{"omega_wanted": "rpm", "beta_wanted": "deg"},
    }


def test_a_campaigns_record_comes_back_through_import(tmp_path, printed):
    out, again = tmp_path / "campaign", tmp_path / "again"
    words = ["hil", "campaign", "--virtual", "--parts", "validation", "--validation-seconds", "5", "--settle", "0.1"]
    printed(*words, "--records", "parquet", "-o", out)
    printed("import", "csv", out / "validation.parquet", "--as", "validation", "-o", again)
    first, second = (read_campaign(folder).validation for folder in (out, again))
    for name in ("time", "omega_ref", "beta_ref", "omega", "thrust"):
        np.testing.assert_allclose(second[name], first[name], rtol=1e-8)
    assert json.loads((out / "hil.json").read_text())["status"] == "ended"


def test_without_its_library_nothing_is_measured(tmp_path, profile, refused, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyarrow.parquet", None)
    out = tmp_path / "out"
    assert "vpp-fmu[import]" in refused("hil", "run", "--virtual", "--profile", profile, "--records", "parquet", "-o", out)
    assert not out.exists()
