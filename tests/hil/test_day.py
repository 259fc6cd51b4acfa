"""A day of the rig (`vpp twin`): costs in closed form, the gain search, its referee, and rounds on the emulated rig."""

import argparse
import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hil.cycle import PERIOD
from hil.rig import RunEnded
from hil.session import read_log
from hil.twin.band import read_band
from identification.assessment.prediction import predict
from identification.tune.learn import learn
from identification.tune.profile import rig_profile
from tests.hil.quick_vpp import shorten_waits
from vpp_fmu.app.cli import hil as hil_verb
from vpp_fmu.app.cli import main
from vpp_fmu.app.day import day as days
from vpp_fmu.app.day import flight
from vpp_fmu.app.day.flight import GAINS, HOLDS, MISSION, measured_cost, mission, repeated
from vpp_fmu.app.day.policy import FARTHEST, SENSITIVITY, GainSearch, Referee, task
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import plant
from vpp_fmu.parameters import ParameterSet, read_parameters
from vpp_fmu.record import Record

IDENTIFIED = {"tau_beta_1": 0.164, "tau_beta_2": 0.024, "tau_omega_1": 0.15, "tau_omega_2": 0.046}
IDENTIFIED |= {"c20": 0.2, "c11": 0.0695, "c21": 0.769, "c12": -0.0933, "c30": 0.0071}
"""Identified from a campaign on the emulated rig: 36 points of the map, steps, 60 s."""

SETTINGS = CONTROLLER.values()
PLANT = ParameterSet(plant()).replaced({"tau_beta_2": 0.05})


def test_a_constant_error_costs_its_square_and_the_gains_theirs():
    """Eq. 21: an error of 3 N of 15 N in 500 readings of 4 ms costs 0.04 times 2 s."""
    record = Record({"time": PERIOD * np.arange(500), "thrust_set": np.full(500, 8.0), "thrust": np.full(500, 5.0)}, "")
    gains = sum(SETTINGS[name] ** 2 for name in GAINS)
    assert measured_cost(record, SETTINGS) == pytest.approx(0.04 * 2.0 + 1e-8 * gains, rel=1e-12)


def test_a_profile_again_and_again_is_one_profile_and_costs_each_time():
    """A step of 1 s up and 2 s down, three times: an error of 1.5 N in the second pass costs 0.01 times 3 s more."""
    once = Record({"time": np.array([0.0, 1.0, 3.0]), "thrust_set": np.array([9.0, 2.0, 2.0])}, "")
    thrice = repeated(once, 3)
    assert thrice.time.tolist() == [0.0, 1.0, 3.0, 4.0, 6.0, 7.0, 9.0]
    assert thrice["thrust_set"].tolist() == [9.0, 2.0, 9.0, 2.0, 9.0, 2.0, 2.0]
    assert repeated(once, 1).columns["time"].tolist() == [0.0, 1.0, 3.0]
    time = PERIOD * np.arange(round(9.0 / PERIOD) + 1)
    off = np.where((time > 3.0 - PERIOD / 2) & (time < 6.0 - PERIOD / 2), 1.5, 0.0)
    record = Record({"time": time + 70.0, "thrust_set": np.full(len(time), 5.0), "thrust": 5.0 - off}, "")
    costs = [measured_cost(record.part(rows), SETTINGS) for rows in flight.passes(record, once, 3)]
    assert np.subtract(costs, costs[0]) == pytest.approx([0.0, 0.03, 0.0], abs=1e-12)


def test_gains_are_replaced_only_by_significantly_cheaper_ones():
    """Four flights each: a cost 0.01 lower with a standard error of 0.006 (t = 1.66, 6 degrees of freedom) has p = 0.07; a cost
    0.005 lower has 0.22."""
    scatter = np.array([-0.01, -0.003, 0.003, 0.01])
    flew = tuple(0.2 + scatter)
    assert days.best_of({"what flew": flew, "model-based": tuple(0.19 + scatter)}) == "model-based"
    assert days.best_of({"what flew": flew, "model-based": tuple(0.195 + scatter)}) == "what flew"
    assert days.best_of({"what flew": flew, "model-free": tuple(0.21 + scatter)}) == "what flew"
    assert days.best_of({"what flew": flew}) == "what flew"
    assert (
        days.best_of({"what flew": flew, "model-based": tuple(0.18 + scatter), "model-free": tuple(0.15 + scatter)})
        == "model-free"
    )


@pytest.mark.parametrize("pace", [1.0, 3.0])
def test_a_mission_holds_levels_within_its_range(pace):
    found = mission(2.0, 9.0, pace, seed=3)
    assert (found.time[0], found.time[-1]) == (0.0, MISSION * pace)
    holds, levels = np.diff(found.time) / pace, found["thrust_set"]
    assert np.all(holds >= HOLDS[0] - 1e-9)
    assert np.all(holds[:-1] <= HOLDS[1] + 1e-9)
    assert np.all((levels >= 2.0) & (levels <= 9.0))
    assert not np.array_equal(found["thrust_set"], mission(2.0, 9.0, pace, seed=4)["thrust_set"])


@pytest.fixture(scope="module")
def referee():
    wanted = task(PLANT, rig_profile(PLANT, {"dual": SETTINGS}), 0.1, SETTINGS["sample_time"], 0)
    return Referee(wanted, SETTINGS)


def scaled(factor):
    return SETTINGS | {name: factor * SETTINGS[name] for name in GAINS}


def test_the_referee_accepts_the_current_gains_and_refuses_oscillation(referee):
    assert referee.predicted(SETTINGS) == (pytest.approx(1.0), True)
    assert referee.predicted(scaled(0.9))[1]
    swings = next(f for f in np.geomspace(1.0, 100.0, 60) if referee.sensitivity(scaled(f)) > SENSITIVITY)
    assert not referee.predicted(scaled(swings))[1]
    assert not referee.predicted(scaled(0.02))[1]  # so slow that it costs more than 1.5 times as much


def test_the_search_decreases_the_cost():
    """A paraboloid in the gains' logarithms about 1.3 times the first ones: ten generations decrease it by nine tenths."""
    best = np.log(1.3)
    search = GainSearch(SETTINGS, GAINS, seed=5)
    for _ in range(10):
        asked = search.asked()
        logs = np.log([[each[name] / SETTINGS[name] for name in GAINS] for each in asked])
        assert np.abs(logs).max() <= FARTHEST + 1e-12
        assert all(each["beta_max"] == SETTINGS["beta_max"] for each in asked)
        search.tell((1.0 + np.sum((logs - best) ** 2, axis=1)).tolist())
    assert np.sum((np.median(logs, axis=0) - best) ** 2) < 0.1 * len(GAINS) * best**2
    there = np.log([search.favourite[name] / SETTINGS[name] for name in GAINS])
    assert np.sum((there - best) ** 2) < 0.1 * len(GAINS) * best**2


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A folder with the results of `vpp identify` for a campaign on the emulated rig."""
    folder = tmp_path_factory.mktemp("identified")
    ParameterSet(plant()).replaced(IDENTIFIED).save(folder)
    content = {"noise_floor_thrust": 0.128, "model_error": {"steady": 0.142, "moving": 0.066, "freedom": 34}, "effects": []}
    content["parameters"] = {name: {"value": value} for name, value in IDENTIFIED.items()}
    (folder / "identification.json").write_text(json.dumps(content))
    return folder


def test_a_day_writes_its_rounds_and_continues_with_its_gains(results, tmp_path, capsys, refused, monkeypatch):
    shorten_waits(monkeypatch.setattr)
    monkeypatch.setattr(flight, "MISSION", 15.0)
    monkeypatch.setattr(days, "rig_profile", lambda *_: SHORT)
    monkeypatch.setattr(days, "TIMES", 2)
    folder = tmp_path / "day"
    options = ["--virtual", "--rounds", "1", "--policy", "fixed", "--parameters", str(results / "parameters.json")]
    assert main(["twin", str(folder), *options]) == 0
    said = capsys.readouterr()
    assert "what flew flies next" in said.out
    assert re.match(r"vpp twin: round 1: .* \(\d+ s\)\n", said.err)
    (only,) = json.loads((folder / "day.json").read_text())["rounds"]
    assert (only["flies_next"], list(only["costs"])) == ("what flew", ["what flew"])
    flights = sorted(path.parent.name for path in (folder / "round_1").glob("*/run.csv"))
    assert len(flights) >= 2  # the mission, and its gains on the profile
    assert len(only["costs"]["what flew"]) == days.TIMES
    again = read_parameters(folder / "parameters.json", plant)
    assert again.values == read_parameters(results / "parameters.json", plant).values or only["model"] != "as it was"
    assert "<title>A day of the rig" in (folder / "report.html").read_text()
    assert "DAY" in refused("twin", folder, *options)


def test_after_a_loss_of_thrust_the_adapted_model_explains_the_alarm(results, tmp_path, monkeypatch):
    """The load cell reads 0.85 of the thrust: the adapted model explains it, so no diagnosis is made."""
    quick(monkeypatch)
    done = a_round(results, tmp_path, "load_cell_gain=0.85")
    assert done.alarm
    assert done.verdict == ""
    was, adapted = (next(m for m in done.models if m.name == name) for name in ("as it was", "adapted"))
    assert done.chosen is adapted
    assert adapted.unseen < 0.5 * was.unseen
    gain = adapted.parameters.values["sensor_gain.gain"]
    assert 0.8 < gain < 0.97
    assert np.sqrt(np.mean(done.usual)) == pytest.approx(adapted.unseen, rel=0.2)  # levels are of unequal length


def test_an_effect_within_the_model_error_is_detected_between_missions(results, tmp_path, monkeypatch):
    """An actuator with a dead band of 3 deg, which no parameter of a twin explains."""
    quick(monkeypatch)
    before = a_round(results, tmp_path / "before", "")
    assert not before.alarm
    with pytest.raises(AssertionError, match="diagnose"):
        a_round(results, tmp_path / "after", "lac_command_deadband=3", before)


SHORT = Record({"time": np.array([0.0, 1.0, 2.0]), "thrust_set": np.array([4.0, 8.0, 8.0])}, "step")


def quick(monkeypatch):
    """A mission of 30 s, and one short flight to compare gains."""
    shorten_waits(monkeypatch.setattr)
    monkeypatch.setattr(flight, "MISSION", 30.0)
    monkeypatch.setattr(days, "rig_profile", lambda *_: SHORT)
    monkeypatch.setattr(days, "TIMES", 1)
    monkeypatch.setattr(days, "diagnose", no_diagnosis)


def no_diagnosis(*_, **__):
    raise AssertionError("nothing is left to diagnose")


def a_round(results, folder, hidden, before=None):
    """The next round of a day with fixed gains on the emulated rig."""
    day = days.new_day(read_parameters(results / "parameters.json", plant), SETTINGS)
    day.rounds += [before] if before else []
    setup = days_setup(results, hidden)
    rig = days.RigAccess(
        lambda number, flight: replace(setup, emulated=replace(setup.emulated, seed=number)),
        lambda what: None,
        lambda number: (),
    )
    folder.mkdir(exist_ok=True)
    return days.next_round(day, rig, read_band(results / "identification.json"), "fixed", folder, 0, 1, lambda text: None)


def test_the_error_of_a_mission_by_level():
    """Two levels at which the reading is 2 N and 3 N above the model's thrust: 4 and 9 N^2."""
    shown = Record({"time": PERIOD * np.arange(1000), "omega_ref": np.full(1000, 4000.0), "beta_ref": np.full(1000, 4.0)}, "")
    thrust = predict(PLANT.model, PLANT.values, shown).thrust
    wanted = np.where(np.arange(1000) < 400, 5.0, 6.0)
    read = thrust + np.where(wanted == 5.0, 2.0, 3.0)
    record = Record(shown.columns | {"thrust_set": wanted, "thrust": read, "omega": thrust}, "")
    profile = Record({"time": np.array([0.0, 400 * PERIOD, 1000 * PERIOD]), "thrust_set": np.array([5.0, 6.0, 6.0])}, "")
    assert days.by_level(PLANT, record, profile) == pytest.approx([4.0, 9.0])


def test_a_repeated_mission_is_judged_level_by_level():
    """Signed-rank test by definition: ten levels that are all worse have p = 2^-10."""
    usual = np.linspace(1.0, 5.0, 10)
    assert days.worse(usual * np.linspace(1.01, 1.1, 10), usual) == pytest.approx(2.0**-10)
    assert days.worse(usual / 1.1, usual) == pytest.approx(1.0)
    mixed = usual * np.where(np.arange(10) < 2, 100.0, np.linspace(0.8, 0.99, 10))
    assert days.worse(mixed, usual) > 0.5
    unread = np.r_[usual * np.linspace(1.01, 1.1, 10), np.nan]
    assert days.worse(unread, np.r_[usual, 1.0]) == pytest.approx(2.0**-10)


def days_setup(results, hidden):
    """The command's set-up of the emulated rig in virtual time with a hidden effect."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--parameters", default=str(results / "parameters.json"))
    hil_verb.add_rig(parser)
    return hil_verb.setup_of(parser.parse_args(["--virtual", *(["--hide", hidden] if hidden else [])]))


def test_a_flight_that_ends_early_is_the_last_one(results, tmp_path, monkeypatch):
    """An operator's stop in the middle of a search must not begin the next flight."""
    flown = []

    def stopped(setup, settings, profile, folder, twins=None, times=1):
        flown.append(folder.name)
        return SimpleNamespace(ended="operator: Ctrl-C")

    monkeypatch.setattr(days, "fly", stopped)
    day = days.new_day(read_parameters(results / "parameters.json", plant), SETTINGS)
    rig = days.RigAccess(lambda number, flight: None, lambda what: None, lambda number: ())
    with pytest.raises(RunEnded, match="Ctrl-C"):
        days.next_round(day, rig, read_band(results / "identification.json"), "both", tmp_path, 0, 1, lambda text: None)
    assert flown == ["flight_01"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--parameters", "{}/alone/parameters.json"], "identification.json"),
        (["--parameters", "{}/parameters.json", "--rig", "real"], "--calibration"),
        (["--parameters", "{}/parameters.json", "--gains", "{}/parameters.json"], "parameters.json"),
    ],
)
def test_bad_input_is_one_line_and_leaves_no_folder(results, tmp_path, refused, options, said):
    (results / "alone").mkdir(exist_ok=True)
    (results / "alone" / "parameters.json").write_text((results / "parameters.json").read_text())
    virtual = [] if "real" in options else ["--virtual"]
    assert said in refused("twin", tmp_path / "day", *virtual, *(option.format(results) for option in options))
    assert not (tmp_path / "day").exists()


def mad(policy, factor=100.0):
    """A policy whose output weights are `factor` times as large."""
    *inner, (weights, biases) = policy.law.layers
    layers = (*inner, (tuple(tuple(factor * w for w in row) for row in weights), biases))
    return replace(policy, law=replace(policy.law, layers=layers))


@pytest.mark.parametrize("guarded", [True, False])
def test_a_policy_that_goes_mad_stays_within_the_limits_of_the_rig(results, tmp_path, guarded):
    """Outside its box the PID takes over, for longer each time, and the thrust reaches the set-point; without a box the
    limits of the rig contain it."""
    setup = days_setup(results, None)
    tuning = task(PLANT, rig_profile(PLANT, {"dual": SETTINGS}), 0.1, PERIOD, 0)
    policy = mad(learn(tuning, SETTINGS, 4, 2, 2).policy)
    if not guarded:
        far = tuple(1e9 for _ in policy.law.low)
        policy = replace(policy, law=replace(policy.law, low=tuple(-x for x in far), high=far, precision=(), distance=0.0))
    profile = Record({"time": np.array([0.0, 3.0, 16.0]), "thrust_set": np.array([4.0, 8.0, 8.0])}, "step")
    done = days.fly(setup, days.Law(SETTINGS, policy), profile, tmp_path)
    log, limits = read_log(tmp_path / "log.csv"), setup.limits
    assert np.nanmax(log["omega"]) < limits.omega_trip
    assert np.nanmax(np.abs(log["thrust"])) < limits.thrust_trip
    for name in ("omega", "beta"):
        acting = log[f"{name}_ref"][np.isfinite(log["omega_wanted"])]
        assert getattr(limits, f"{name}_min") <= acting.min() <= acting.max() <= getattr(limits, f"{name}_max")
        assert np.abs(np.diff(acting)).max() <= getattr(limits, f"{name}_slew") * PERIOD * (1.0 + 1e-9)
    if guarded:
        assert np.std(done.record["thrust"][-250:] - 8.0) < 0.3
        assert np.mean(done.record["thrust"][-250:]) == pytest.approx(8.0, abs=0.1)
    assert log["throttle"][-1] < 0.01  # throttled down, however the run ended
