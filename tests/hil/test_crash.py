"""A loop that ends unexpectedly: the rotor idles, the command returns, and its files are complete."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from rigs import begun

from hil.loop.session import found_log, read_log
from tests.hil.stubborn import stubborn
from vpp_fmu.app.cli import main
from vpp_fmu.plants import KernelController
from vpp_fmu.table import read_table

ROOT = Path(__file__).parents[2]


def wait_for(done, seconds=60.0):
    end = time.monotonic() + seconds
    while not done() and time.monotonic() < end:
        time.sleep(0.05)
    assert done()


def ended(out):
    """hil.json, once the run has ended and all files exist."""
    summary = {}

    def over():
        summary.update(json.loads((out / "hil.json").read_text()))
        return summary["status"] != "running" and (out / "report.html").exists()

    wait_for(over)
    assert read_log(out / "log.csv")["state"][0] == "safe"
    assert len(read_table(out / "run.csv").columns["time"]) > 100
    assert summary["operator"]
    return summary


@pytest.mark.parametrize(
    ("how", "code", "cause", "words"),
    [
        ("hangs", -signal.SIGKILL, "is killed", ()),
        ("crashes", -signal.SIGSEGV, "the loop is ", ()),
        ("errs", 2, "controller: failed", ("--virtual",)),
    ],
)
def test_an_fmu_that_fails_during_a_run_leaves_a_rig_at_idle_and_all_files(tmp_path, how, code, cause, words):
    process = begun(tmp_path, 4.0, "--controller", str(stubborn(tmp_path, how, 200)), *words)
    _, said = process.communicate(timeout=90)
    assert process.returncode == code, said
    summary = ended(tmp_path / "out")
    assert summary["status"] == "ended early"
    assert cause in summary["ended"]
    assert [t["state"] for t in summary["transitions"]].count("run") == 1
    assert summary["tares"]


def test_a_log_whose_writer_died_too_is_cut_behind_its_last_whole_row(tmp_path, profile, printed, refused):
    out = tmp_path / "out"
    printed("hil", "run", "--virtual", "--profile", profile, "-o", out)
    folder = (out / "log.csv").resolve().parent
    summary = json.loads((folder / "hil.json").read_text())
    whole = (folder / "run.csv").read_bytes()
    (folder / "hil.json").write_text(json.dumps(summary | {"status": "running"}))
    text = (folder / "log.csv").read_bytes()
    (folder / ".log.csv.part").write_bytes(text[: len(text) * 9 // 10])
    for name in ("log.csv", "run.csv", "report.html"):
        (folder / name).unlink()
    printed("hil", "report", folder)
    assert whole.startswith((folder / "run.csv").read_bytes()[:-1])  # the same bytes, up to the cut
    assert json.loads((folder / "hil.json").read_text())["status"] == "ended early"
    wrong = {
        "transitions": ([{"time": 0.0, "state": "safe"}], "transitions, 1, why: found nothing, expected a text"),
        "counters": ({"arduino": {"pulses": "many"}}, 'counters, arduino, pulses: found "many", expected a whole number'),
        "tares": ({}, "tares: found {}, expected a list"),
        "log": (None, "log: found null, expected an object in braces { }"),
        "twin": ({"units": {}}, "twin, false_alarms_per_hour: found nothing, expected a number"),
    }
    for name, (found, says) in wrong.items():
        (folder / "hil.json").write_text(json.dumps(summary | {name: found}))
        assert f"{folder / 'hil.json'}: {says}\n" in refused("hil", "report", folder)
    (folder / "hil.json").unlink()
    printed("hil", "report", folder)  # its log and its events are there


@pytest.mark.parametrize(("size", "rows"), [(0, 0), (300_000, 1000)], ids=["from the start", "at the end"])
def test_a_full_disk_loses_no_row_that_was_written(tmp_path, profile, size, rows):
    words = ["hil", "run", "--virtual", "--profile", str(profile), "-o", str(tmp_path / "out")]
    text = "import resource, sys\nfrom hil.loop.room import Reserve\nfrom vpp_fmu.app.cli import main\n"
    text += "size = int(sys.argv[1])\ndef fill(*_): resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))\n"
    text += "if size: Reserve.free = fill\n"  # others were quicker to take what it gave back
    text += "else: fill()\nsys.exit(main(sys.argv[2:]))"
    command = [sys.executable, "-c", text, str(size), *words]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 2
    (said,) = done.stderr.splitlines()
    assert "file too large" in said
    (folder,) = (tmp_path / "out" / "runs").iterdir()
    if rows:
        log = read_log(found_log(folder))
        assert rows < len(log) < 3500  # of about 4000
        assert main(["hil", "report", str(folder)]) == 0  # once there is room again
        assert json.loads((folder / "hil.json").read_text())["status"] != "running"
    else:
        assert not list(folder.iterdir())


def test_an_error_that_nobody_foresaw_keeps_what_was_measured(tmp_path, profile, monkeypatch):
    counted = iter(range(10**6))

    def step(self, thrust_set, thrust):
        if next(counted) == 300:
            raise ZeroDivisionError("by chance")
        return 3000.0, 2.0

    monkeypatch.setattr(KernelController, "step", step)
    with pytest.raises(ZeroDivisionError):
        main(["hil", "run", "--virtual", "--profile", str(profile), "-o", str(tmp_path / "out")])
    summary = json.loads((tmp_path / "out" / "hil.json").read_text())
    assert (summary["status"], summary["ended"]) == ("ended early", "by chance")
    assert len(read_table(tmp_path / "out" / "run.csv").columns["time"]) == 300
