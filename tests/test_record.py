import gzip

import numpy as np
import pytest
from builders import refusal

from vpp_fmu.errors import BadInput, RecordWarning
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.signals import OMEGA
from vpp_fmu.record import Record, read_profile, read_record, write_record

NEED_THRUST = ("time", "omega_ref", "beta_ref", "thrust")

GOOD = """time,omega_ref,beta_ref,thrust
0.000,4000,5.5,7.1
0.004,4000.5,5.5,7.2
0.008,4001,-5,7.3
"""


def written(folder, text, name="record.csv"):
    path = folder / name
    path.write_bytes(gzip.compress(text.encode()) if name.endswith(".gz") else text.encode())
    return path


@pytest.mark.parametrize("name", ["record.csv", "record.csv.gz"])
@pytest.mark.parametrize("text", [GOOD, "\ufeff" + GOOD.replace("\n", "\r\n"), GOOD.replace("\n", "\n\n")])
def test_read_record(tmp_path, name, text):
    record = read_record(written(tmp_path, text, name), NEED_THRUST)
    assert list(record.columns) == ["time", "omega_ref", "beta_ref", "thrust"]
    np.testing.assert_array_equal(record.time, [0.0, 0.004, 0.008])
    np.testing.assert_array_equal(record["omega_ref"], [4000.0, 4000.5, 4001.0])
    np.testing.assert_array_equal(record["beta_ref"], [5.5, 5.5, -5.0])
    np.testing.assert_array_equal(record["thrust"], [7.1, 7.2, 7.3])
    assert record.source == str(tmp_path / name)
    assert len(record) == 3
    assert "thrust" in record
    assert "omega" not in record


def test_steps_are_exact_on_a_written_grid(tmp_path):
    rows = "".join(f"{k * 0.004:.3f},4000,5\n" for k in range(25_000))
    record = read_record(written(tmp_path, "time,omega_ref,beta_ref\n" + rows))
    assert np.unique(np.diff(record.time)).size > 1
    assert set(record.steps.tolist()) == {0.004}


def test_gaps_in_measured_columns_become_nan(tmp_path):
    text = "time,omega_ref,beta_ref,omega,thrust,voltage,current,beta\n0,1,2,,3,,,\n1,1,2,5,,24.5,-3,nan\n"
    record = read_record(written(tmp_path, text))
    for name, expected in {
        "omega": [np.nan, 5.0],
        "thrust": [3.0, np.nan],
        "voltage": [np.nan, 24.5],
        "current": [np.nan, -3.0],
        "beta": [np.nan, np.nan],
    }.items():
        assert record[name].dtype == float
        np.testing.assert_array_equal(record[name], expected)
    with pytest.raises(BadInput, match=r"thrust, line 3: found an empty cell, expected a finite number$"):
        read_record(tmp_path / "record.csv", NEED_THRUST)


def test_a_simulation_interpolates_the_voltage_between_its_readings():
    columns = {"time": [0.0, 1.0, 3.0, 4.0], "voltage": [10.0, np.nan, 40.0, np.nan], "omega": [1.0, np.nan, 2.0, 3.0]}
    record = Record(columns, "made up")
    inputs, *_ = record.run
    np.testing.assert_allclose(inputs["voltage"], [10.0, 20.0, 40.0, 40.0], rtol=1e-15)
    assert np.isnan(inputs["omega"][1])
    assert np.isnan(record["voltage"][1])


def test_unknown_columns_are_kept_and_named_in_one_warning(tmp_path):
    text = "time,omega_ref,beta_ref,strain,note,gap\n0,1,2,0.5,start,\n1,1,2,0.6,,3\n"
    with pytest.warns(RecordWarning) as caught:
        record = read_record(written(tmp_path, text))
    assert len(caught) == 1
    assert "record.csv" in str(caught[0].message)
    assert str(caught[0].message).endswith("strain, note, gap")
    assert caught[0].filename == __file__
    np.testing.assert_array_equal(record["strain"], [0.5, 0.6])
    assert list(record["note"]) == ["start", ""]
    assert list(record["gap"]) == ["", "3"]


def changed(line, text):
    """GOOD with another line; lines count from 1."""
    lines = GOOD.splitlines()
    lines[line - 1] = text
    return "\n".join(lines)


BAD = {
    "missing column": (
        "time,omega_ref,thrust\n0,1,2\n",
        "column beta_ref: found only time, omega_ref, thrust, expected a header with time, omega_ref, beta_ref, thrust",
    ),
    "semicolons": ("time;omega_ref;beta_ref;thrust\n0;1;2;3\n", "header: found cells separated by semicolons, "),
    "empty cell": (changed(3, "0.004,,5,7"), "omega_ref, line 3: found an empty cell, expected a finite number"),
    "NaN": (changed(3, "0.004,4000,nan,7"), "beta_ref, line 3: found 'nan', expected a finite number"),
    "no number": (changed(2, "0,4000,5,7 N"), "thrust, line 2: found '7 N', expected a finite number"),
    "long cell": (changed(2, f"0,4000,5,{'x' * 99}"), f"thrust, line 2: found '{'x' * 37}...', expected a finite number"),
    "broken cell": (changed(2, '0,4000,5,"7\n8"'), r"thrust, line 3: found '7\n8', expected a finite number"),
    "no time": (changed(3, ",4000,5,7"), "time, line 3: found an empty cell, expected a finite number"),
    "late start": (changed(2, "0.002,4000,5,7"), "time, line 2: found 0.002, expected 0 in the first row of a record"),
    "time goes back": (
        changed(4, "0.003,4000,5,7"),
        "time, line 4: found 0.003 after 0.004 (time goes back), expected a time after that of the row before",
    ),
    "time stands still": (changed(3, "0,4000,5,7"), "time, line 3: found 0 after 0 (time stands still), expected "),
    "less than a step": (changed(3, "1e-10,4000,5,7"), "time, line 3: found 1e-10 after 0 (time stands still), expected "),
    "speed too high": (changed(3, "0.004,200001,5,7"), "omega_ref, line 3: found 200001, expected 0 to 200000 rpm"),
    "speed negative": (changed(3, "0.004,-0.5,5,7"), "omega_ref, line 3: found -0.5, expected 0 to 200000 rpm"),
    "pitch": (changed(4, "0.008,4000,-90.1,7"), "beta_ref, line 4: found -90.1, expected -90 to 90 deg"),
    "thrust of a ship": (changed(4, "0.008,4000,5,2e5"), "thrust, line 4: found 200000, expected -100000 to 100000 N"),
}


@pytest.mark.parametrize(("text", "message"), BAD.values(), ids=BAD)
def test_bad_records(tmp_path, text, message):
    path = written(tmp_path, text)
    said = refusal(read_record, path, NEED_THRUST)
    assert said.startswith(f"{path}: {message}")
    assert ", expected " in said


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("omega", "-1", f"{OMEGA.minimum:g} to {OMEGA.maximum:g} rpm"),
        ("beta", "91", "-90 to 90 deg"),
        ("voltage", "-0.1", "0 to 100 V"),
        ("voltage", "100.5", "0 to 100 V"),
        ("current", "501", "-500 to 500 A"),
        ("thrust_set", "-100001", "-100000 to 100000 N"),
        ("voltage", "high", "a finite number or an empty cell"),
        ("current", "inf", "a finite number or an empty cell"),
        ("thrust_set", "", "a finite number"),
    ],
)
def test_bad_columns_beyond_the_needed_ones(tmp_path, name, value, allowed):
    path = written(tmp_path, f"time,omega_ref,beta_ref,{name}\n0,1,2,0\n1,1,2,{value}\n")
    said = refusal(read_record, path)
    assert said.startswith(f"{path}: {name}, line 3: found ")
    assert value in said
    assert said.endswith(f", expected {allowed}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,thrust\n0,5\n", "column thrust_set: found only time, thrust, expected a header with time, thrust_set"),
        ("time,thrust_set\n0,5\n1,100001\n", "thrust_set, line 3: found 100001, expected -100000 to 100000 N"),
        ("time,thrust_set\n0,5\n1,\n", "thrust_set, line 3: found an empty cell, expected a finite number"),
        ("time,thrust_set\n1,5\n", "time, line 2: found 1, expected 0 in the first row"),
    ],
)
def test_bad_profiles(tmp_path, text, message):
    path = written(tmp_path, text)
    assert refusal(read_profile, path).startswith(f"{path}: {message}")


@pytest.mark.parametrize("name", ["out.csv", "out.csv.gz"])
def test_what_is_written_reads_back(tmp_path, name):
    rng = np.random.default_rng(0)
    n = 2000
    # over an hour long, so that nine digits would not reach the nanosecond
    instants = np.concatenate([[0.0], 5000.0 + np.cumsum(rng.uniform(1e-8, 1e-2, n - 1))])
    columns = {
        "time": instants,
        "omega_ref": rng.uniform(0.0, 6000.0, n),
        "beta_ref": rng.uniform(-5.0, 10.0, n),
        "thrust": np.where(rng.random(n) < 0.3, np.nan, rng.normal(5.0, 3.0, n)),
    }
    path = write_record(OutputFolder(tmp_path), name, Record(columns, "here"))
    back = read_record(path)
    np.testing.assert_array_equal(back.time, np.round(instants, 9))
    for column in ("omega_ref", "beta_ref", "thrust"):
        np.testing.assert_allclose(back[column], columns[column], rtol=6e-9, atol=0.0)
    again = write_record(OutputFolder(tmp_path / "again"), name, back)
    assert again.read_bytes() == path.read_bytes()
