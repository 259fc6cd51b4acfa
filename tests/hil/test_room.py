import json
import os

import pytest
from rigs import setup, step_profile

from hil.loop import room
from hil.loop.room import Reserve
from hil.run import run_on_rig
from vpp_fmu.app.cli import main
from vpp_fmu.errors import BadInput
from vpp_fmu.plants import KernelController


def test_a_disk_too_small_for_the_run_is_refused_before_the_rig_is_opened(tmp_path, monkeypatch):
    """The log: 45 000 rows, 24 cells of up to ten characters, 11 MB. The record behind it: 30 000 rows, 8 of 20, 5 MB."""
    monkeypatch.setattr(room, "free_bytes", lambda folder: 12_000_000)
    monkeypatch.setattr("hil.loop.session.Setup.bench", lambda self: pytest.fail("opened"))
    with pytest.raises(BadInput, match=r"free space: found 12\.0 MB, expected .* 120 s of log"):
        run_on_rig(setup(), KernelController(), step_profile(hold=40.0), tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_campaign_too_long_for_its_disk_is_refused_before_its_first_part(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(room, "free_bytes", lambda folder: 20_000_000)  # enough for each part, not for five
    small = ["--points", "2", "--samples", "250", "--settle", "0.5", "--validation-seconds", "120"]
    assert main(["hil", "campaign", "--virtual", *small, "-o", str(tmp_path)]) == 2
    assert "free space" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.csv*"))


def test_the_reserve_takes_real_blocks_and_has_no_name(tmp_path):
    reserve = Reserve(tmp_path, 60.0)
    size = os.fstat(reserve._file.fileno())
    assert 512 * size.st_blocks >= size.st_size > 60.0 * 250 * 8 * 20
    assert not list(tmp_path.iterdir())
    reserve.free()


@pytest.mark.usefixtures("short_waits")
def test_the_reason_of_an_end_is_told_even_if_the_files_after_it_are_refused(tmp_path, monkeypatch, capsys):
    """The run's own error and the disk's, in one line; hil.json comes first."""

    def refused(path, record):
        raise BadInput(path, "output file", "not writable (no space left on device)", "a file that can be written")

    monkeypatch.setattr("hil.results.outcome.write_run", refused)
    steps = iter([(3000.0, 2.0)] * 100)
    monkeypatch.setattr(KernelController, "step", lambda *_: next(steps, (float("nan"), 0.0)))
    (tmp_path / "step.csv").write_text("time,thrust_set\n0,4\n2,4\n")
    assert main(["hil", "run", "--virtual", "--profile", str(tmp_path / "step.csv"), "-o", str(tmp_path / "out")]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("vpp")]
    assert "not a number" in line
    assert "no space left" in line
    assert "not a number" in json.loads((tmp_path / "out" / "hil.json").read_text())["ended"]
