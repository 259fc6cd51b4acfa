import json
import os
import shutil
from dataclasses import replace

import numpy as np
import pytest
from builders import declared
from rigs import LIMITS

from hil.campaign import PARTS, CampaignSize, measure, plan_for, recorded, same_commands, seconds, steep, step_responses
from hil.commands import StepCommand, grid, open_loop, steps, validation
from hil.loop.cycle import PERIOD
from hil.loop.log import MemoryLog
from hil.loop.rig import RigPlant
from hil.physics.rig_model import FULL_RIG
from hil.results.campaign_folder import piece, record_of
from hil.safety.faults import Fault, FaultKind
from vpp_fmu.app.cli import main
from vpp_fmu.campaign import read_campaign
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.record import Record, write_record

pytestmark = pytest.mark.usefixtures("short_waits")


@pytest.fixture
def rig_and_log(new_rig):
    return new_rig(limits=steep(LIMITS))


def spans(log) -> list[Record]:
    """The records whose rows the log's events mark."""
    columns = {name: log[name] for name in ("time", "omega_wanted", "omega_ref", "beta_ref", "omega", "thrust")}
    return [piece(Record(columns, ""), **event["record"]) for event in log.events if "record" in event]


def test_the_grid_and_the_steps_are_the_papers():
    points = grid(10)
    assert len(points) == 100
    assert points[0] == (2000.0, -10.0)
    assert points[-1] == (6000.0, 10.0)
    assert [w for w, _ in points[::10]] == pytest.approx(np.linspace(2000.0, 6000.0, 10), abs=0.05)
    found = steps(5)
    speed = [s for s in found if s.before[1] == s.after[1]]
    pitch = [s for s in found if s.before[0] == s.after[0]]
    assert len(speed) == len(pitch) == 50
    assert {(s.before[0], np.sign(s.after[0] - s.before[0])) for s in speed} == {(2000.0, 1.0), (6000.0, -1.0)}
    assert {s.after[0] for s in speed if s.before[0] == 2000.0} == set(np.linspace(2500.0, 6000.0, 5))
    assert {s.after[1] for s in pitch if s.before[1] == -10.0} == set(np.linspace(-6.0, 10.0, 5))
    assert {s.after[1] for s in pitch if s.before[1] == 10.0} == set(np.linspace(6.0, -10.0, 5))
    assert seconds(CampaignSize(), ["static"]) == 100 * 23.0  # 3 s and 5000 samples at 250 Hz


def test_the_open_loop_moves_speed_then_pitch_then_both():
    given = open_loop(1, 30.0, PERIOD)
    speed, pitch = given["omega_ref"].reshape(3, -1), given["beta_ref"].reshape(3, -1)
    assert [np.ptp(s) > 0 for s in speed] == [True, False, True]
    assert [np.ptp(b) > 0 for b in pitch] == [False, True, True]
    other = validation(1, 90.0, PERIOD)
    assert not np.array_equal(other["omega_ref"], given["omega_ref"])
    assert same_commands(given, open_loop(1, 30.0, PERIOD))
    assert not same_commands(given, open_loop(2, 30.0, PERIOD))


def test_a_static_point_is_the_mean_of_the_physical_model(rig_and_log):
    rig, log = rig_and_log
    measure(rig, "static", CampaignSize(points=2, settle=2.0, samples=500))
    found = record_of("static", [event["point"] for event in log.events if "point" in event])
    physics = Simulation(FULL_RIG)
    for k, point in enumerate(zip(found["omega_ref"], found["beta_ref"], strict=True)):
        settled = physics.start(dict(zip(("omega_ref", "beta_ref"), point, strict=True)))
        assert found["thrust"][k] == pytest.approx(settled["thrust"], abs=0.1)
        assert found["omega"][k] == pytest.approx(settled["omega"], rel=5e-3)
    assert found["thrust_std"] == pytest.approx(np.full(4, np.hypot(0.12, 0.047)), rel=0.25)
    assert (found["samples"] == 500).all()


def test_a_step_starts_settled_and_responds_only_after_its_command(rig_and_log):
    plan, (rig, log) = CampaignSize(settle=2.0, before=1.0, after=2.0), rig_and_log
    step_responses(rig, [StepCommand((3000.0, 5.0), (5000.0, 5.0))], plan)
    (found,) = spans(log)
    time, thrust = found["time"], found["thrust"]
    assert (time[0], len(time)) == (0.0, 750)
    moved = int(np.argmax(found["omega_ref"] > 3000.0))
    assert time[moved] == pytest.approx(1.0)
    before = thrust[:moved]
    assert abs(before[:100].mean() - before[-100:].mean()) < 0.3
    assert abs(thrust[moved] - before.mean()) < 5.0 * before.std()  # that row was sampled before its command acted
    assert thrust[-100:].mean() > before.mean() + 3.0
    assert found["omega_ref"][moved + 10] == 5000.0  # a step, in 10 ticks at most


def test_a_row_of_a_record_holds_the_sample_before_its_command(rig_and_log):
    given, (rig, log) = np.array([[3000.0, 5.0]] * 3 + [[3010.0, 5.5]] * 3), rig_and_log
    rig.start(3000.0, 5.0)
    shown = []
    step = rig.step

    def spy(*commands):
        shown.append((rig.last.omega, rig.last.thrust, *commands))
        return step(*commands)

    rig.step = spy
    recorded(rig, given)
    (found,) = spans(log)
    assert [tuple(row) for row in zip(found["omega"], found["thrust"], *given.T, strict=True)] == shown
    np.testing.assert_array_equal(np.column_stack([found["omega_ref"], found["beta_ref"]]), given)


def test_a_missed_slot_leaves_its_row_empty(rig_and_log):
    rig, log = rig_and_log
    rig.start(3000.0, 5.0)
    step = rig.step

    def late(*commands):
        if rig.ticks.slot == first + 4:
            rig.bench.clock.wait_until(rig.bench.clock.now() + 0.013)
        return step(*commands)

    first = rig.ticks.slot
    rig.step = late
    recorded(rig, np.full((20, 2), [3000.0, 5.0]))
    (found,) = spans(log)
    np.testing.assert_allclose(found.time, 0.004 * np.arange(20), atol=1e-12)
    assert np.flatnonzero(np.isnan(found["thrust"])).tolist() == [5, 6]
    assert (found["omega_ref"] == 3000.0).all()


@pytest.fixture(autouse=True, scope="module")
def small_plan():
    """One level of steps, half a second about each, and sections of 1.5 s, which no option sets."""
    small = {"levels": 1, "before": 0.5, "after": 0.5, "section": 1.5}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("vpp_fmu.app.cli.hil.plan_for", lambda rig: replace(plan_for(rig), **small))
        yield


SMALL = ["--points", "2", "--samples", "50", "--settle", "1", "--validation-seconds", "5"]
MEASURED = ["hil", "campaign", "--virtual", *SMALL, "--parts", "static", "steps", "validation"]


@pytest.fixture(scope="module")
def whole(small_plan, short_waits, tmp_path_factory):
    """The folder of a small campaign, measured once."""
    folder = tmp_path_factory.mktemp("whole")
    assert main([*MEASURED, "-o", str(folder)]) == 0
    return folder


NARROW = {"speed": {"min": 2513.37, "max": 4000.0}, "pitch": {"min": 4.0, "max": 4.0}, "slew": {"speed": 3000.0}}


def test_a_campaign_is_complete_and_stays_within_what_the_rig_json_declares(tmp_path, printed):
    file, out = declared(tmp_path / "rig.json", **NARROW), tmp_path / "campaign"
    short = ["--points", "3", "--samples", "10", "--settle", "0.2", "--validation-seconds", "5"]
    said = printed("hil", "campaign", "--virtual", "--rig", file, *short, "-o", out)
    assert "speed 2513.37 to 4000 rpm (rig.json), pitch 4 deg, fixed (rig.json)" in said
    found = read_campaign(out)
    assert found.static.omega_ref.tolist() == [2513.4, 3256.7, 4000.0]
    assert len(found.steps) == 10
    for record in (found.open_loop, found.repeat, found.validation, *found.steps):
        assert record["omega_ref"].min() >= 2513.37
        assert record["omega_ref"].max() <= 4000.0
        assert set(record["beta_ref"]) == {4.0}
        assert np.abs(np.diff(record["omega_ref"])).max() <= 3000.0 * PERIOD * (1.0 + 1e-9)
    assert max(np.ptp(r["omega_ref"]) for r in found.steps) == 4000.0 - 2513.4
    assert found.rig.origin["speed"] == "rig.json"  # rig.json is now beside the records
    assert same_commands(found.open_loop, found.repeat)
    noise = (found.open_loop["thrust"] - found.repeat["thrust"]).std() / np.sqrt(2.0)  # the same commands, other noise
    assert noise == pytest.approx(np.hypot(0.12, 0.047), rel=0.15)
    parts = json.loads((out / "hil.json").read_text())["parts"]
    assert tuple(parts) == PARTS
    assert parts["steps"]["allowed"]["speed"]["max"] == 4000.0
    assert all(part["log"]["rows"] == part["log"]["ticks"] and part["log"]["lost"] == 0 for part in parts.values())


def test_commands_beyond_the_limits_are_not_begun(tmp_path, refused):
    given = {"time": np.array([0.0, 1.0]), "omega_ref": np.array([3e3, 6500.0]), "beta_ref": np.zeros(2)}
    write_record(OutputFolder(tmp_path), "orders.csv", Record(given, ""))
    words = ["hil", "campaign", "--virtual", "-o", tmp_path]
    said = refused(*words, "--commands", tmp_path / "orders.csv")
    assert "omega_ref, row 2 of the data: found 6500, expected 2000 to 6000 rpm" in said
    far = declared(tmp_path / "far.json", pitch={"min": 12.0, "max": 25.0})
    assert "for a rig of 2000 to 6000 rpm, 12 to 25 deg" in refused(*words, "--rig", far)  # beyond the rod's range


def test_a_part_ended_by_a_fault_is_reported_and_its_log_kept(tmp_path, refused):
    limits = {"format": "vpp-limits/1", "limits": {"run_time": {"value": 5.0, "unit": "s"}}}
    (tmp_path / "limits.json").write_text(json.dumps(limits))
    out, own = tmp_path / "out", ["--limits", str(tmp_path / "limits.json"), "--parts", "validation"]
    assert "run time" in refused("hil", "campaign", "--virtual", *SMALL, *own, "-o", out)
    part = json.loads((out / "hil.json").read_text())["parts"]["validation"]
    assert "run time" in part["ended"]
    assert part["log"]["rows"] == part["log"]["ticks"] > 1250
    names = ["hil.json", "log_validation.csv.gz", "log_validation.events.jsonl", "rig.json"]
    assert sorted(set(os.listdir(out)) - {"validation.partial.csv"}) == names


def test_a_part_whose_log_lost_rows_is_not_complete(tmp_path, refused, monkeypatch):
    close = MemoryLog.close
    monkeypatch.setattr(MemoryLog, "close", lambda self: replace(close(self), lost=7, failure="no space left"))
    own = ["--parts", "validation", "-o", tmp_path]
    assert "log: 7 rows lost: no space left" in refused("hil", "campaign", "--virtual", *SMALL, *own)
    assert not json.loads((tmp_path / "hil.json").read_text())["parts"]["validation"]["whole"]
    assert [path.name for path in tmp_path.glob("validation*")] == ["validation.partial.csv"]


def test_a_campaign_that_is_ended_twice_and_resumed_equals_one_that_was_not(whole, tmp_path, refused, monkeypatch):
    out, left, step = tmp_path / "out", [0], RigPlant.step

    def cut(self, *commands):
        left[0] -= 1
        if left[0] == 0:
            self._cycle.fault(Fault("operator", FaultKind.INTERRUPTED, "Ctrl-C"))
        return step(self, *commands)

    monkeypatch.setattr(RigPlant, "step", cut)
    resume = []
    for ticks, kept in ((700, "static.partial.csv"), (4000, "steps.partial.csv")):
        left[0] = ticks
        assert "operator: interrupted" in refused(*MEASURED, *resume, "-o", out)
        assert json.loads((out / "hil.json").read_text())["status"] == "ended early"
        assert (out / kept).exists()
        if not resume:
            assert "Try: --resume to go on with it, or --replace" in refused(*MEASURED, "-o", out)
        resume = ["--resume"]
    assert "plan.settle: found 1.0, expected 2.0" in refused(*MEASURED, "--resume", "--settle", "2", "-o", out)
    left[0] = 0
    assert main([*MEASURED, "--resume", "-o", str(out)]) == 0
    assert not list(out.glob("*.partial.csv"))
    first, second = read_campaign(whole), read_campaign(out)
    np.testing.assert_array_equal(first.static.omega_ref, second.static.omega_ref)
    np.testing.assert_array_equal(first.static.beta_ref, second.static.beta_ref)
    np.testing.assert_allclose(first.static.thrust, second.static.thrust, atol=0.3)  # other noise, 50 readings each
    assert len(first.steps) == len(second.steps) == 20
    for one, other in zip(first.steps, second.steps, strict=True):
        for name in ("time", "omega_ref", "beta_ref"):
            np.testing.assert_array_equal(one[name], other[name])
        assert np.abs(one["thrust"] - other["thrust"]).max() < 1.5
    np.testing.assert_array_equal(first.validation["omega_ref"], second.validation["omega_ref"])


def test_a_campaign_is_not_overwritten_unless_that_is_asked_for(whole, tmp_path, refused):
    """A finished one, and records that no campaign of this program measured; a replaced one leaves none of its records."""
    small, out = ["hil", "campaign", "--virtual", *SMALL, "-o", str(tmp_path / "out")], tmp_path / "out"
    shutil.copytree(whole, out)
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    found = refused(*small, "--parts", "static", "--seed", "5")
    assert "campaign: found static.csv, steps.csv, validation.csv, expected a folder without one" in found
    assert "--replace" in found
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    assert "not allowed with" in refused(*small, "--resume", "--replace")
    assert main([*small, "--parts", "static", "--seed", "5", "--replace"]) == 0
    assert (out / "static.csv").read_bytes() != before["static.csv"]
    assert not list(out.glob("*validation*"))
    (tmp_path / "imported").mkdir()
    (tmp_path / "imported" / "open_loop.csv").write_text("measured elsewhere")
    assert "found open_loop.csv" in refused(*small[:-1], str(tmp_path / "imported"))
