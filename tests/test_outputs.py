"""The files of a run appear together or not at all; outdated files of an earlier run are removed, and no others."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from vpp_fmu.errors import BadInput
from vpp_fmu.outputs import MODEL_VERBS, WRITTEN, OutputSet
from vpp_fmu.scratch import Scratch
from vpp_fmu.stopping import Stopped, stoppable

ONE, OTHER = "0123456789ab", "ba9876543210"


def ran(folder, verb, identity, **files):
    """A run of `verb` that wrote these files, from parameters of that identity."""
    done = OutputSet(folder, verb)
    for name, text in files.items():
        done.write(name.replace("_json", ".json").replace("_fmu", ".fmu"), text)
    done.finish(identity)
    return done


def names(folder):
    return sorted(name for name in os.listdir(folder) if name != WRITTEN)


def test_a_run_that_fails_leaves_what_was_there(tmp_path):
    ran(tmp_path, "identify", ONE, parameters_json="old", identification_json="old")
    before = {name: (tmp_path / name).read_bytes() for name in os.listdir(tmp_path)}
    run = OutputSet(tmp_path, "diagnose")
    run.write("parameters.json", "new")
    del run
    assert {name: (tmp_path / name).read_bytes() for name in os.listdir(tmp_path)} == before


def test_a_folder_in_the_place_of_a_file_is_refused_before_anything_is_replaced(tmp_path):
    (tmp_path / "parameters.json").write_text("old")
    (tmp_path / "report.html").mkdir()
    run = OutputSet(tmp_path, "identify")
    run.write("parameters.json", "new")
    run.write("report.html", "new")
    with pytest.raises(BadInput, match=r"report\.html: output file: found not writable \(is a directory\)"):
        run.finish(ONE)
    assert (tmp_path / "parameters.json").read_text() == "old"


def test_a_signal_waits_until_all_files_are_in_place(tmp_path, monkeypatch):
    run = OutputSet(tmp_path, "identify")
    for name in "abc":
        run.write(name, name)
    replace = os.replace

    def interrupted(*paths):
        signal.raise_signal(signal.SIGTERM)
        replace(*paths)

    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(Stopped), stoppable("vpp test"):
        run.finish()
    assert names(tmp_path)[-3:] == ["a", "b", "c"]


@pytest.mark.parametrize("first", MODEL_VERBS)
@pytest.mark.parametrize("second", MODEL_VERBS)
def test_one_folder_holds_one_model(tmp_path, first, second):
    ran(tmp_path, first, ONE, parameters_json="1", diagnosis_json="1", gains_json="1")
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "empirical.json").write_text("mine, whatever the name")
    run = ran(tmp_path, second, OTHER, parameters_json="2", identification_json="2")
    assert sorted(run.removed) == ["diagnosis.json", "gains.json"]
    assert names(tmp_path) == ["empirical.json", "identification.json", "notes.txt", "parameters.json"]


@pytest.mark.parametrize(
    "noted",
    ["", "[]", "{}", '{"format": "vpp-written/2", "files": {}}', '{"format": "vpp-written/1", "files": {"a": 1}}', "outside"],
)
def test_an_invalid_list_of_files_removes_nothing(tmp_path, noted):
    folder, outside = tmp_path / "out", tmp_path / "a.json"
    folder.mkdir()
    for path in (outside, folder / "a.json"):
        path.write_text("mine")
    if noted == "outside":
        ran(folder, "identify", ONE, b_json="mine")
        (folder / "b.json").unlink()
        content = json.loads((folder / WRITTEN).read_text())
        content["files"]["../a.json"] = content["files"].pop("b.json")
        noted = json.dumps(content)
    (folder / WRITTEN).write_text(noted)
    assert ran(folder, "identify", OTHER, c_json="1").removed == ()
    assert outside.exists()
    assert names(folder) == ["a.json", "c.json"]


DIES = """
import os, signal, sys
from pathlib import Path
from vpp_fmu.scratch import Scratch
scratch = Scratch(Path(sys.argv[1]))
(scratch.path / "large").write_text("x")
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_the_next_process_removes_the_scratch_folder_of_a_killed_one(tmp_path):
    assert subprocess.run([sys.executable, "-c", DIES, str(tmp_path)], check=False).returncode == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    assert (left / "large").exists()
    (tmp_path / left.name.replace("scratch", "other")).mkdir()
    Scratch(tmp_path).close()
    assert [Path(name) for name in os.listdir(tmp_path)] == [Path(left.name.replace("scratch", "other"))]


def test_a_file_that_the_user_has_changed_is_kept(tmp_path):
    ran(tmp_path, "diagnose", ONE, parameters_json="1", diagnosis_json="1")
    (tmp_path / "diagnosis.json").write_text("1, and a remark")
    run = ran(tmp_path, "diagnose", OTHER, parameters_json="2")
    assert (run.kept, run.removed) == (("diagnosis.json",), ())
    assert (tmp_path / "diagnosis.json").exists()
    again = ran(tmp_path, "diagnose", ONE, parameters_json="3")
    assert (again.kept, again.removed) == ((), ())
