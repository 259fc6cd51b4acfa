import io
import json
import os
import re
from dataclasses import replace

import numpy as np
import pytest
from rigs import CALIBRATION, LIMITS, setup, step_profile, transitions

from hil.commands import PAPERS
from hil.devices.calibration import to_json
from hil.emulator.rig import EmulatedRig as Emulated
from hil.loop.columns import COLUMNS
from hil.loop.session import read_log
from hil.results.outcome import judged_steps
from hil.results.runs import sha256_of
from hil.run import ON_ALARM, LimitedPlant, run_on_rig
from hil.twin.band import Band
from hil.twin.twin import Twin, twin_of
from vpp_fmu.app.cli import main
from vpp_fmu.commands import idle
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.plant import plant
from vpp_fmu.loop import run as run_loop
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.plants import KernelController, KernelPlant
from vpp_fmu.record import Record, write_record

pytestmark = pytest.mark.usefixtures("short_waits")


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    return run_on_rig(setup(), KernelController(), step_profile(), tmp_path_factory.mktemp("run"))


def on_the_model(**profile):
    return run_loop(LimitedPlant(KernelPlant(), LIMITS), KernelController(), step_profile(**profile), idle(PAPERS))


def test_the_papers_controller_settles_the_papers_step_on_the_rig(done):
    up, down = judged_steps(done.record, {})
    assert (up.before, up.after) == (1.5, 12.0)
    assert up.settling < 1.0  # the paper: set-point reached in about 0.5 s
    assert down.settling < 1.0
    assert max(up.overshoot, down.overshoot) < 5.0  # the paper: without any overshoots
    last = done.record["thrust"][int(3.0 / 0.004) : int(4.0 / 0.004)]
    assert last.mean() == pytest.approx(12.0, abs=0.1)


def test_a_set_point_beyond_the_limits_is_said_to_be_out_of_reach(tmp_path, printed):
    """By the run and the report of its log; at its controller's limits the paper's rig has less thrust than the set-point."""
    (tmp_path / "far.csv").write_text("time,thrust_set\n0,2\n2,22\n5,22\n")
    said = printed("hil", "run", "--virtual", "--profile", tmp_path / "far.csv", "-o", tmp_path)
    (folder,) = (tmp_path / "runs").iterdir()
    said += printed("hil", "report", folder)
    run, report = re.findall(r"^The step .*: the set-point of 22 N is (.*)\.$", said, re.MULTILINE)
    assert run == report
    assert re.fullmatch(r"out of reach: [.\d]+ N at 6000 rpm, 10 deg", run)
    assert "out of reach" in (folder / "report.html").read_text()


def test_nothing_is_lost_from_the_log(done):
    assert done.session.logged.lost == 0
    assert len(done.log) == done.session.logged.rows == done.session.rig.ticks.ticks
    np.testing.assert_allclose(np.diff(done.log.time), 0.004, atol=1e-9)
    assert not done.log["missed"].any()
    assert tuple(done.log.columns) == ("time", *(c.name for c in COLUMNS if c.name not in ("time", "state")), "state")


def columns_of(path):
    return np.genfromtxt(path, delimiter=",", names=True)


def test_a_run_that_a_fault_ends_keeps_what_was_measured(tmp_path):
    class Broken(KernelController):
        def step(self, thrust_set, thrust):
            self.steps = getattr(self, "steps", 0) + 1
            return (np.nan, 0.0) if self.steps == 700 else super().step(thrust_set, thrust)

    found = run_on_rig(setup(), Broken(), step_profile(), tmp_path)
    assert "not a number" in found.ended
    assert len(found.record) == 699
    assert found.log["state"][-1] in ("ramp down", "fault")
    assert found.log["throttle"][-1] < 0.01
    facts = found.session.summary()
    assert [t["state"] for t in facts["transitions"]][-2:] == ["ramp down", "fault"]


def twinned(emulated, steady, folder, on_alarm=None):
    """A run of 9 s beside the paper's model, whose band has the `steady` error [N]."""
    twin = Twin(twin_of(ParameterSet(plant()), Band(0.12, 0.047, 0.13, steady)), on_alarm=on_alarm)
    return run_on_rig(setup(emulated), KernelController(), step_profile(4.0, 8.0, hold=3.0), folder, twin=twin)


def test_a_twin_has_no_alarm_on_its_own_rig(tmp_path):
    run = twinned(Emulated(seed=1), 0.12, tmp_path)
    assert not run.log["alarm"].any()
    residual = run.log["residual"][np.isfinite(run.log["residual"])]
    assert len(residual) == len(run.record) == round(9.0 / 0.004)


@pytest.mark.parametrize(("what", "state"), [("note", "safe"), ("ramp", "fault"), ("idle", "fault")])
def test_the_twins_alarm_is_reported_and_may_end_the_run(tmp_path, what, state):
    gain = Emulated({"load_cell_gain.gain": 1.4}, ("load_cell_gain",), seed=1)
    run = twinned(gain, 0.08, tmp_path, on_alarm=ON_ALARM[what])
    rig = run.session.rig
    ((when, _, words),) = rig.twin.alarms
    assert "the rig is not its model" in words
    assert rig.states.state.value == state
    assert bool(run.ended) == (what != "note")
    assert run.log["alarm"].any() or run.ended
    assert any("alarm" in why and abs(t - when) < 0.01 for t, _, why in transitions(rig))
    if what != "note":
        assert run.ended.startswith("twin: twin's alarm")


def test_the_command_writes_run_facts_and_report(tmp_path, profile, printed, fmu_files):
    out = tmp_path / "out"
    words = ["hil", "run", "--virtual", "--profile", profile, "--hide", "linkage_play=0.4", "-o", out]
    assert "the step from 1.5 to 12 N" in printed(*words, "--beside", fmu_files["plain"])
    assert sorted(os.listdir(out)) == ["hil.json", "log.csv", "report.html", "run.csv", "runs"]
    (own,) = (out / "runs").iterdir()
    assert (out / "run.csv").resolve() == (own / "run.csv").resolve()  # a link to the newest run
    facts = json.loads((out / "hil.json").read_text())
    assert facts["rig"] == "emulated"
    assert facts["status"] == "ended"
    assert facts["profile"] == {"file": "step.csv", "file_sha256": sha256_of(profile)}
    assert facts["controller"]["kind"] == "kernel"
    assert {"begun", "completed", "host", "operator", "command", "versions"} <= set(facts)
    assert facts["hidden"] == ["linkage_play"]
    assert facts["physics"]["linkage_play.half_gap"] == 0.4
    assert facts["calibration"]["sha256"] == CALIBRATION.sha256
    assert facts["log"]["rows"] == facts["log"]["ticks"] == len(read_log(out / "log.csv"))
    assert [t["state"] for t in facts["transitions"]] == ["safe", "safe", "armed", "run", "ramp down", "safe"]
    assert 0.0 < facts["beside"]["rms_thrust"] < 2.0
    page = (out / "report.html").read_text()
    assert "Hardware in the loop" in page
    assert "linkage_play" in page


def test_the_plant_fmu_takes_the_rigs_place_by_one_option(tmp_path, profile, fmu_files):
    out = tmp_path / "out"
    assert main(["hil", "run", "--rig", "fmu", str(fmu_files["plain"]), "--profile", str(profile), "-o", str(out)]) == 0
    np.testing.assert_array_equal(columns_of(out / "run.csv")["thrust"], on_the_model(hold=1.0)["thrust"])
    assert json.loads((out / "hil.json").read_text())["rig"] == "fmu"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--hide", "nonsense"], "--hide: found nonsense"),
        (["--hide", "linkage_play=99"], "found 99, expected a number from 0"),
        (["--hide", "linkage_play.size=1"], "linkage_play.half_gap"),
        (["--rig", "kettle"], "expected emulated or real"),
        (["--rig", "real"], "expected the real rig's calibration file"),
        (["--rig", "fmu"], "or fmu PLANT.fmu"),
        (["--start", "9000", "0"], "--start: found 9000 rpm, expected 2000 to 6000 rpm"),
        (["--start", "-5", "0"], "--start"),
        (["--twin"], "no model of the rig"),
        (["--controller", "c.fmu", "--gains", "g.json"], "only one of them"),
    ],
)
def test_wrong_options_are_reported_in_one_line(profile, refused, words, said, tmp_path):
    assert said in refused("hil", "run", "--profile", profile, "-o", tmp_path / "out", *words)


@pytest.mark.parametrize(
    ("time", "thrust", "said"),
    [
        ([0.0, 2.0], [1.5, 400.0], "thrust_set: found 400 N, expected less than 25 N"),
        ([0.0, 9000.0], [1.5, 12.0], "time: found 9000 s, expected at most the run time, 3600 s"),
    ],
)
def test_a_profile_that_the_limits_would_end_is_not_begun(time, thrust, said, tmp_path, refused):
    write_record(OutputFolder(tmp_path), "far.csv", Record({"time": np.array(time), "thrust_set": np.array(thrust)}, ""))
    assert said in refused("hil", "run", "--virtual", "--profile", tmp_path / "far.csv", "-o", tmp_path / "out")


def test_the_real_rig_requires_a_typed_word(profile, capsys, refused, monkeypatch, tmp_path):
    calibration = tmp_path / "calibration.json"
    calibration.write_text(to_json(CALIBRATION))
    words = ["hil", "run", "--calibration", calibration, "--profile", profile, "-o", tmp_path / "out", "--rig", "real"]
    assert "source: found no operator and date for load_cell, esc, pitch" in refused(*words)
    calibration.write_text(to_json(replace(CALIBRATION, source={"who": "Ada", "when": "2026-03-07"})))
    assert "a real rig of unknown range" in refused(*words)  # its highest speed is not declared
    rig = {"format": "vpp-rig/1", "speed": {"min": 2000, "max": 5000}, "pitch": {"min": -5, "max": 8}}
    (tmp_path / "rig.json").write_text(json.dumps({**rig, "thrust": {"min": 0, "max": 12}}))
    words.append(tmp_path / "rig.json")
    monkeypatch.setattr("sys.stdin", io.StringIO("yes\n"))
    assert main([*map(str, words)]) == 2
    printed = capsys.readouterr()
    assert "typed word" in printed.err
    assert "speed 2000 to 5000 rpm (rig.json), pitch -5 to 8 deg (rig.json)" in printed.out
    monkeypatch.setattr("sys.stdin", io.StringIO("spin\n"))
    assert "pwm: not ready" in refused(*words)  # this machine has no rig
