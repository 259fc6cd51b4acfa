"""Records that begin in motion: parts of longer ones, after a move of both commands shortly before."""

import numpy as np
import pytest
from studies.synthetic import TRUTH, commands

from identification.diagnose.diagnose import diagnose
from identification.gate.gate import passed
from identification.identify import identify
from identification.logger_fit import as_logged
from identification.run_in import run_in, without
from vpp_fmu.campaign import read_campaign
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.plant import BASE, LIBRARY
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record, write_record

NOISE, JITTER = 0.1, 3.0  # N, rpm
STEP = 0.008  # s
LAG = sum(TRUTH[f"tau_beta_{k}"] for k in (1, 2))  # s, of the slower channel
SOME = tuple(e for e in LIBRARY if e.off is None or e.name in ("sensor_lag", "pitch_command_deadband"))


def cut(seed: int, since: float = 0.0, section: float = 8.0) -> tuple[Record, np.ndarray]:
    """(a record that begins `since` s after both commands had moved, 0: settled; what the true model predicts for it)."""
    rng = np.random.default_rng(seed)
    asked, rows = commands(rng, section, STEP), round(since / STEP)
    before = {"omega_ref": 6500.0 - asked["omega_ref"][0] * 0.6, "beta_ref": asked["beta_ref"][0] - 3.0}
    longer = {n: np.r_[before[n] if rows else asked[n][0], np.full(rows, asked[n][0]), asked[n]] for n in before}
    time = np.arange(len(longer["omega_ref"])) * STEP
    shown = Simulator(BASE).simulate(TRUTH, longer, np.diff(time).round(9))[rows + 1 :]
    thrust = shown[:, 0] + NOISE * rng.standard_normal(len(asked))
    omega = shown[:, 1] + JITTER * rng.standard_normal(len(asked))
    return asked.with_columns(thrust=thrust, omega=omega), Simulator(BASE).simulate(TRUTH, *asked.run)


@pytest.mark.parametrize("seed", range(6))
def test_a_settled_record_has_no_run_in_and_one_in_motion_has_one(seed):
    assert run_in(*cut(seed), LAG) == 0.0
    assert run_in(*cut(seed, 0.1), LAG) == pytest.approx(5.0 * LAG)


ERRORS = {
    "constant": lambda t, move: 1.0 + 0.0 * t,
    "constant until the first move": lambda t, move: np.where(t < move, 1.0, 0.0),
    "grows": lambda t, move: np.where(t < move, t, 0.0),
    "dies away in minutes": lambda t, move: np.exp(-t / 60.0),
    "comes and goes": lambda t, move: np.cos(2.0 * np.pi * t / 6.0),
}


@pytest.mark.parametrize("name", ERRORS)
def test_an_error_beyond_the_start_is_not_taken_for_a_run_in(name):
    record, shown = cut(0)
    move = record.time[1 + np.argmax(np.diff(record["omega_ref"]) != 0.0)]
    assert LAG < move < 5.0 * LAG
    record = record.with_columns(thrust=record["thrust"] + ERRORS[name](record.time, move))
    assert run_in(record, shown, LAG) == 0.0


def test_only_readings_of_thrust_and_speed_are_left_out():
    record, _ = cut(0)
    kept = without(record, 1.0)
    late = record.time >= 1.0
    for name in record.columns:
        gone = ~late if name in ("thrust", "omega") else np.zeros(len(record), bool)
        np.testing.assert_array_equal(np.isnan(kept[name]), gone)
        np.testing.assert_array_equal(kept[name][late], record[name][late])


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """A campaign whose open loop and validation begin in motion."""
    folder = OutputFolder(tmp_path_factory.mktemp("moving"))
    for seed, kind in enumerate(("open_loop", "validation"), start=1):
        write_record(folder, f"{kind}.csv", cut(seed, 0.2)[0])
    return read_campaign(folder.path)


def test_an_identification_is_as_good_as_without_the_transient(campaign):
    found = identify(campaign, starts=1)
    said = [f for f in found.quality if f.code == "run_in"]
    assert [f.file for f in said] == ["open_loop.csv", "validation.csv"]
    assert all(f.told.startswith("begins in motion: its first 2.9 s are excluded") for f in said)
    std = found.uncertainty.std
    off = [(v - TRUTH[n]) / s for n, v, s in zip(found.uncertainty.names, found.uncertainty.values, std, strict=True)]
    assert np.max(np.abs(off)) < 4.0
    for one in found.predictions.values():
        assert one.rmse_thrust == pytest.approx(NOISE, rel=4.0 / np.sqrt(2.0 * len(one.record)))
        assert one.rmse_omega == pytest.approx(JITTER, rel=4.0 / np.sqrt(2.0 * len(one.record)) + 0.01)
    assert all(0.93 < share < 0.97 for share in found.coverage.values())


def test_a_diagnosis_finds_no_lack_of_fit_after_the_run_in(campaign):
    found = diagnose(campaign, library=SOME, workers=1, thorough=False)
    assert (found.verdict, found.selection.final.effects) == ("none", ())
    thrust, omega = found.errors(found.final)
    assert thrust == pytest.approx(NOISE, rel=0.05)
    assert omega == pytest.approx(JITTER, rel=0.05)
    assert found.held_out_after.rmse_thrust == pytest.approx(NOISE, rel=0.05)
    assert found.noise.floor == pytest.approx(NOISE, rel=0.05)
    worst = found.location["largest"]
    assert abs(worst["thrust"]) < 6.0 * NOISE / np.sqrt(5.0)
    assert worst["time"] > 5.0 * LAG


def test_of_step_runs_those_in_motion_lose_their_run_in(campaign):
    def run(since: float) -> Record:
        commanded = {"omega_ref": np.full(1000, 5000.0), "beta_ref": np.where(np.arange(1000) < 500, 2.0, 6.0)}
        rows = round(since / STEP)
        longer = {
            n: np.r_[c[0] - 1500.0 * (n == "omega_ref") * bool(rows), np.full(rows, c[0]), c] for n, c in commanded.items()
        }
        shown = Simulator(BASE).simulate(TRUTH, longer, np.full(1000 + rows, STEP))[rows + 1 :]
        thrust = shown[:, 0] + NOISE * np.random.default_rng(3).standard_normal(1000)
        return Record({"time": np.arange(1000) * STEP, **commanded, "thrust": thrust}, f"steps.csv, run {since:g}")

    gate = passed(campaign)
    gate = as_logged(type(gate)(type(gate.campaign)(**{**vars(gate.campaign), "steps": (run(0.0), run(0.1))}), {}, ()))
    settled, moving = (np.isnan(r["thrust"]) for r in gate.campaign.steps)
    assert not settled.any()
    assert np.flatnonzero(moving)[-1] * STEP == pytest.approx(5.0 * LAG, rel=0.05)
    assert [f.code for f in gate.findings if f.file == "steps.csv"] == ["run_in"]
