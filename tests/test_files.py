import gzip
import os
from pathlib import Path

import numpy as np
import pytest
from builders import refusal

from vpp_fmu.errors import BadInput
from vpp_fmu.files import InFolder, OutputFolder, read_text
from vpp_fmu.table import read_table


def names(folder):
    return sorted(path.name for path in Path(folder).iterdir())


def test_output_folder_is_created_with_its_parents(tmp_path):
    folder = OutputFolder(tmp_path / "a" / "b")
    assert folder.path.is_dir()
    assert names(folder.path) == []


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt(), RuntimeError()])
@pytest.mark.parametrize("where", ["replace", "fsync"])
def test_a_failed_write_leaves_what_was_there(tmp_path, monkeypatch, failure, where):
    (tmp_path / "run.csv").write_text("old")
    folder = OutputFolder(tmp_path)

    def fail(*_):
        raise failure

    monkeypatch.setattr(os, where, fail)
    expected = BadInput if isinstance(failure, OSError) else type(failure)
    with pytest.raises(expected) as error:
        folder.write("run.csv", "new")
    assert names(tmp_path) == ["run.csv"]
    assert (tmp_path / "run.csv").read_text() == "old"
    assert folder.replaced == ()
    if expected is BadInput:
        assert "no space left on device" in str(error.value)


@pytest.mark.parametrize(("name", "data"), [("a.csv", b"%s"), ("a.csv.gz", None)])
def test_read_text_drops_mark_and_carriage_returns(tmp_path, name, data):
    plain = b"\xef\xbb\xbfa,\xc2\xb5\r\n1,2\r3,4\n"
    (tmp_path / name).write_bytes(data % plain if data else gzip.compress(plain))
    assert read_text(tmp_path / name) == "a,µ\n1,2\n3,4\n"


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("none.csv", None, "file: found no such file, expected a file that exists"),
        ("taken/none.csv", None, "file: found no such file"),
        ("folder", None, "file: found a folder, expected a file"),
        ("a.csv.gz", b"time\n0\n", "file: found broken or cut off gzip data, expected a whole gzip file"),
        ("a.csv.gz", gzip.compress(b"time\n0\n" * 9, mtime=0)[:-9], "file: found broken or cut off gzip data"),
        ("a.csv", b"time\n0\n\xff\n", "line 3: found the byte 0xff, expected text in UTF-8"),
        ("a.csv", "time\n0\n".encode("utf-16"), "line 1: found the byte 0xff, expected text in UTF-8"),
    ],
)
def test_read_text_says_what_is_wrong(tmp_path, name, data, message):
    (tmp_path / "folder").mkdir()
    (tmp_path / "taken").write_text("")
    path = tmp_path / name
    if data is not None:
        path.write_bytes(data)
    assert refusal(read_text, path).startswith(f"{path}: {message}")


def test_table_of_numbers(tmp_path):
    (tmp_path / "a.csv").write_text(" x , y\n\n1, 2.5\n-3,4e2\n   \n0,0\n\n")
    table = read_table(tmp_path / "a.csv")
    assert list(table.columns) == ["x", "y"]
    assert table.columns["x"].dtype == float
    np.testing.assert_array_equal(table.columns["x"], [1.0, -3.0, 0.0])
    np.testing.assert_array_equal(table.columns["y"], [2.5, 400.0, 0.0])
    np.testing.assert_array_equal(table.lines, [3, 4, 6])
    assert table.source == str(tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "file: found an empty file, expected a header and at least one row"),
        ("\n \n", "file: found an empty file"),
        ("a,b\n\n", "file: found a header without rows, expected a header and at least one row"),
        ('a\n" "\n', "file: found a header without rows"),
        ("a,,c\n1,2,3\n", "header, column 2: found no name, expected a name for each column"),
        ("a,b\u2028c\n1,2\n", r"header, column 2: found 'b\u2028c', expected a name of printable characters"),
        ("a,b, a\n1,2,3\n", "column a: found more than one of that name, expected each column once"),
        ("a,b\n1,2\n\n3\n", "line 4: found 1 cell, expected 2 cells, as in the header"),
        ("a,b\n1,2\n3,4,5\n", "line 3: found 3 cells, expected 2 cells, as in the header"),
        ("a,b\n1,2,3\n4,5,6\n", "line 2: found 3 cells, expected 2 cells, as in the header"),
        ('a,b\n1,"' + "2" * 200_000 + '"\n', "line 2: found field larger than field limit"),
        ("a," + "b" * 200_000 + "\n1,2\n", "header: found field larger than field limit"),
    ],
)
def test_read_table_says_what_is_wrong(tmp_path, text, message):
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8")
    assert refusal(read_table, path).startswith(f"{path}: {message}")


def test_a_folder_stands_for_the_first_of_its_files_that_exists(tmp_path):
    file = InFolder(("a.csv", "b.csv"))
    assert file(tmp_path) == str(tmp_path / "a.csv"), "a message names the file that is missing"
    (tmp_path / "b.csv").touch()
    assert file(tmp_path) == str(tmp_path / "b.csv")
    (tmp_path / "a.csv").touch()
    assert file(tmp_path) == str(tmp_path / "a.csv")
    assert file(tmp_path / "c.csv") == str(tmp_path / "c.csv")
