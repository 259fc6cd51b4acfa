import gzip
from pathlib import Path

import numpy as np
import pytest
from builders import refusal

from vpp_fmu.campaign import read_campaign, read_static, read_steps

STATIC = "omega_ref,beta_ref,omega,thrust,thrust_std,samples\n2000,-5,2001,0.5,0.1,375\n6000,10,5999,14,0.2,370\n"
RECORD = "time,omega_ref,beta_ref,omega,thrust\n0,4000,5,4001,7\n0.004,4000,6,4000,7.1\n0.008,4000,6,3999,7.2\n"
REPEAT = "time,omega_ref,beta_ref,omega,thrust\n0.000,4e3,5,4002,6.9\n0.004,4e3,6,,7.2\n0.008,4e3,6,,7.1\n"
STEPS = "run,time,omega_ref,beta_ref,thrust\n3,0,4000,5,7\n3,0.5,4500,5,8\n3,1,4500,5,8.5\n7,0,4000,5,7\n7,0.25,4000,6,7.5\n"
ALL = {"static": STATIC, "steps": STEPS, "open_loop": RECORD, "repeat": REPEAT, "validation": RECORD}


def filled(folder, **texts):
    for name, text in texts.items():
        (folder / f"{name}.csv").write_text(text)
    return folder


def failure(read, path):
    message = refusal(read, path)
    assert ": found " in message
    assert ", expected " in message
    return message


@pytest.mark.parametrize("zipped", [(), ("steps", "repeat"), tuple(ALL)])
def test_a_whole_campaign(tmp_path, zipped):
    filled(tmp_path, **{name: text for name, text in ALL.items() if name not in zipped})
    for name in zipped:
        (tmp_path / f"{name}.csv.gz").write_bytes(gzip.compress(ALL[name].encode()))
    campaign = read_campaign(str(tmp_path))
    assert campaign.folder == tmp_path
    assert campaign.missing == ()
    np.testing.assert_array_equal(campaign.static.omega_ref, [2000.0, 6000.0])
    np.testing.assert_array_equal(campaign.static.beta_ref, [-5.0, 10.0])
    np.testing.assert_array_equal(campaign.static.omega, [2001.0, 5999.0])
    np.testing.assert_array_equal(campaign.static.thrust, [0.5, 14.0])
    np.testing.assert_array_equal(campaign.static.thrust_std, [0.1, 0.2])
    np.testing.assert_array_equal(campaign.static.samples, [375.0, 370.0])
    np.testing.assert_array_equal(campaign.open_loop["thrust"], [7.0, 7.1, 7.2])
    np.testing.assert_array_equal(campaign.repeat["thrust"], [6.9, 7.2, 7.1])
    assert len(campaign.validation) == 3
    assert Path(campaign.repeat.source).name == ("repeat.csv.gz" if "repeat" in zipped else "repeat.csv")


def test_runs_are_records_of_their_own(tmp_path):
    first, second = read_campaign(filled(tmp_path, steps=STEPS)).steps
    np.testing.assert_array_equal(first.time, [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(first["omega_ref"], [4000.0, 4500.0, 4500.0])
    np.testing.assert_array_equal(second.time, [0.0, 0.25])
    np.testing.assert_array_equal(second["beta_ref"], [5.0, 6.0])
    assert "run" not in first
    assert second.source == f"{tmp_path / 'steps.csv'}, run 7"


@pytest.mark.parametrize("name", ALL)
def test_any_one_file_may_be_missing(tmp_path, name):
    campaign = read_campaign(filled(tmp_path, **{n: text for n, text in ALL.items() if n != name}))
    assert campaign.missing == (f"{name}.csv",)
    assert getattr(campaign, name) in (None, ())


def test_a_path_that_is_no_campaign_folder_is_refused(tmp_path):
    missing = failure(read_campaign, tmp_path / "none")
    assert missing.startswith(f"{tmp_path / 'none'}: campaign folder: found no such folder, expected a folder with any of ")
    (tmp_path / "file.csv").write_text(RECORD)
    assert "file.csv: campaign folder: found a file, expected a folder with any of static.csv, steps.csv" in failure(
        read_campaign, tmp_path / "file.csv"
    )
    (tmp_path / "logs").mkdir()
    for name, hint in (("log.csv", "vpp import csv "), ("open_loop.csv", "its folder, "), ("repeat.csv.gz", "its folder, ")):
        (tmp_path / "logs" / name).touch()
        assert f". Try: {hint}" in failure(read_campaign, tmp_path / "logs" / name)
    assert "campaign folder: found none of a campaign's files, expected any of static.csv, steps.csv" in failure(
        read_campaign, tmp_path
    )


def test_a_file_that_is_there_plain_and_gzipped_is_refused(tmp_path):
    filled(tmp_path, open_loop=RECORD)
    (tmp_path / "open_loop.csv.gz").write_bytes(gzip.compress(RECORD.encode()))
    message = failure(read_campaign, tmp_path)
    assert message == f"{tmp_path}: open_loop.csv: found open_loop.csv and open_loop.csv.gz, expected only one of them"


@pytest.mark.parametrize("name", ["open_loop", "repeat", "validation"])
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("thrust", "force", "column thrust: found only time, omega_ref, beta_ref, omega, force, expected a header with"),
        (",7.1\n", ",nan\n", "thrust, line 3: found 'nan', expected a finite number or an empty cell"),
    ],
)
def test_records_are_checked(tmp_path, name, old, new, message):
    filled(tmp_path, **{name: RECORD.replace(old, new)})
    assert failure(read_campaign, tmp_path).startswith(f"{tmp_path / name}.csv: {message}")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0.004,4e3,6", "0.004,4e3,6.001", "beta_ref, row 2 of the data: found 6.001, expected 6 as in "),
        ("0.008,4e3", "0.008,4100", "omega_ref, row 3 of the data: found 4100, expected 4000 as in "),
        ("0.008,", "0.012,", "time, row 3 of the data: found 0.012, expected 0.008 as in "),
        ("0.008,4e3,6,,7.1\n", "", "row 3 of the data: found 2 rows in all, expected 3 rows as in "),
        ("7.1\n", "7.1\n0.012,4e3,6,,7\n", "row 4 of the data: found 4 rows in all, expected 3 rows as in "),
    ],
)
def test_a_repeat_with_other_commands_is_refused(tmp_path, old, new, message):
    assert old in REPEAT
    filled(tmp_path, open_loop=RECORD, repeat=REPEAT.replace(old, new))
    assert failure(read_campaign, tmp_path) == f"{tmp_path / 'repeat.csv'}: {message}{tmp_path / 'open_loop.csv'}"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("run", "number", "column run: found only number, time, omega_ref"),
        ("thrust", "force", "column thrust: found only run, time"),
        ("7,0,", "7,1.5,", "time, line 5: found 1.5, expected 0 in the first row of a run"),
        ("3,1,", "3,0.5,", "time, line 4: found 0.5 after 0.5 (time stands still)"),
        ("7,0.25,", "3,0.25,", "run, line 6: found run 3 a second time, expected the rows of a run one after another"),
        ("3,0,", "3.5,0,", "run, line 2: found 3.5, expected a whole number"),
        ("3,0,", "three,0,", "run, line 2: found 'three', expected a finite number"),
        ("8.5", "", "thrust, line 4: found an empty cell, expected a finite number"),
        ("4500,5,8\n", "-1,5,8\n", "omega_ref, line 3: found -1, expected 0 to 200000 rpm"),
    ],
)
def test_steps_are_checked(tmp_path, old, new, message):
    assert old in STEPS
    path = filled(tmp_path, steps=STEPS.replace(old, new, 1)) / "steps.csv"
    assert failure(read_steps, path).startswith(f"{path}: {message}")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("samples", "count", "column samples: found only omega_ref"),
        ("2001", "", "omega, line 2: found an empty cell, expected a finite number"),
        ("6000", "700000", "omega_ref, line 3: found 700000, expected 0 to 200000 rpm"),
        ("0.2", "-0.2", "thrust_std, line 3: found -0.2, expected 0 N or more"),
        ("370", "0", "samples, line 3: found 0, expected a whole number from 1"),
        ("370", "3.7", "samples, line 3: found 3.7, expected a whole number from 1"),
        ("14", "nan", "thrust, line 3: found 'nan', expected a finite number"),
    ],
)
@pytest.mark.filterwarnings("ignore::vpp_fmu.record.RecordWarning")
def test_static_maps_are_checked(tmp_path, old, new, message):
    assert old in STATIC
    path = filled(tmp_path, static=STATIC.replace(old, new)) / "static.csv"
    assert failure(read_static, path).startswith(f"{path}: {message}")
