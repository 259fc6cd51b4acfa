"""A day of the rig (`vpp twin`): costs in closed form, and rounds on the emulated rig."""

import argparse
import json
import re
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from builders import shorten_tuning

from hil.loop.cycle import PERIOD
from hil.loop.rig import RunEnded
from hil.loop.session import read_log
from hil.run import run_on_rig
from hil.twin.band import read_band
from identification.diagnose.diagnose import diagnose
from tests.hil.quick_vpp import shorten_waits
from vpp_fmu.app import day as flight
from vpp_fmu.app.api import rounds
from vpp_fmu.app.api.control import learn
from vpp_fmu.app.cli import hil as hil_verb
from vpp_fmu.app.cli import main
from vpp_fmu.app.day import GAINS, HOLDS, measured_cost, mission, repeated
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import LIBRARY, plant
from vpp_fmu.parameters import ParameterSet, read_parameters
from vpp_fmu.plants import KernelController
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
    costs = flight.costs_of(record, once, 3, SETTINGS)
    assert np.subtract(costs, costs[0]) == pytest.approx([0.0, 0.03, 0.0], abs=1e-12)


def test_gains_are_replaced_only_by_significantly_cheaper_ones():
    """Four flights each: a cost 0.01 lower with a standard error of 0.006 (t = 1.66, 6 degrees of freedom) has p = 0.07; a cost
    0.005 lower has 0.22."""
    scatter = np.array([-0.01, -0.003, 0.003, 0.01])
    flew = tuple(0.2 + scatter)
    assert flight.best_of({"what flew": flew, "model-based": tuple(0.19 + scatter)}) == "model-based"
    assert flight.best_of({"what flew": flew, "model-based": tuple(0.195 + scatter)}) == "what flew"
    assert flight.best_of({"what flew": flew, "learned": tuple(0.21 + scatter)}) == "what flew"
    assert flight.best_of({"what flew": flew}) == "what flew"
    assert (
        flight.best_of({"what flew": flew, "model-based": tuple(0.18 + scatter), "learned": tuple(0.15 + scatter)}) == "learned"
    )


@pytest.mark.parametrize("pace", [1.0, 3.0])
def test_a_mission_holds_levels_within_its_range(pace):
    found = mission(2.0, 9.0, pace, seed=3)
    assert (found.time[0], found.time[-1]) == (0.0, flight.MISSION * pace)
    holds, levels = np.diff(found.time) / pace, found["thrust_set"]
    assert np.all(holds >= HOLDS[0] - 1e-9)
    assert np.all(holds[:-1] <= HOLDS[1] + 1e-9)
    assert np.all((levels >= 2.0) & (levels <= 9.0))
    assert not np.array_equal(found["thrust_set"], mission(2.0, 9.0, pace, seed=4)["thrust_set"])


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A folder with the results of `vpp identify` for a campaign on the emulated rig."""
    folder = tmp_path_factory.mktemp("identified")
    ParameterSet(plant()).replaced(IDENTIFIED).save(folder)
    content = {"noise_floor_thrust": 0.128, "model_error": {"steady": 0.142, "moving": 0.066, "freedom": 34}, "effects": []}
    content["parameters"] = {name: {"value": value} for name, value in IDENTIFIED.items()}
    (folder / "identification.json").write_text(json.dumps(content))
    return folder


SHORT = Record({"time": np.array([0.0, 1.0, 2.0]), "thrust_set": np.array([4.0, 8.0, 8.0])}, "step")


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Short waits, missions of 15 s, a short profile, and a diagnosis with few candidates."""
    shorten_waits(monkeypatch.setattr)
    shorten_tuning(monkeypatch.setattr)
    monkeypatch.setattr(flight, "MISSION", 15.0)
    monkeypatch.setattr(rounds, "rig_profile", lambda *_: SHORT)
    monkeypatch.setattr(rounds, "TIMES", 2)
    few = tuple(e for e in LIBRARY if e.off is None or e.name == "pitch_command_deadband")
    monkeypatch.setattr(rounds, "diagnose", partial(diagnose, library=few))


def test_a_day_writes_its_rounds_and_continues_with_its_model_and_gains(results, tmp_path, capsys, refused):
    folder = tmp_path / "day"
    options = ["--virtual", "--rounds", "2", "--parameters", str(results / "parameters.json"), "--workers", "1"]
    assert main(["twin", str(folder), *options, "--hide", "load_cell_gain=0.7"]) == 0
    said = capsys.readouterr()
    assert re.search(r"^vpp twin: round 2: diagnose \(\d+ s\)$", said.err, re.M)
    assert re.search(r"^round 2: alarm after \d+ s, the rig is not its model", said.out, re.M)
    first, second = json.loads((folder / "day.json").read_text())["rounds"]
    assert (first["hidden"], first["alarms"], second["hidden"]) == ([], [], ["load_cell_gain"])
    assert first["error"]["after"] < first["error"]["before"]  # lags in the loop differ from those of the campaign
    assert second["error"]["after"] < 0.5 * second["error"]["before"]  # the gain is a part of the model now
    assert [len(costs) for costs in second["costs"].values()] == [2, 2]  # of the present and the new law
    assert len(list((folder / "round_1").glob("*/run.csv"))) == 3
    for name in ("parameters.json", "gains.json"):
        assert (folder / name).read_text() == (folder / "round_2" / name).read_text()
    again = read_parameters(folder / "parameters.json", plant)
    assert again.values != read_parameters(folder / "round_1" / "parameters.json", plant).values
    assert "<title>A day of the rig" in (folder / "report.html").read_text()
    assert "DAY" in refused("twin", folder, *options)


def test_with_the_policy_fixed_the_present_gains_fly_on(results, tmp_path, monkeypatch):
    found = SimpleNamespace(final=SimpleNamespace(effects=()), verdict="none", parameters=lambda fit: PLANT)
    monkeypatch.setattr(rounds, "diagnose", lambda *_, **__: found)
    monkeypatch.setattr(flight, "MISSION", 4.0)
    done = a_round(results, tmp_path, "fixed")
    assert list(done.costs) == ["what flew"]
    assert done.settings == SETTINGS
    assert done.parameters.values == PLANT.values


def a_round(results, folder, policy):
    """The first round of a day on the emulated rig."""
    day = rounds.new_day(read_parameters(results / "parameters.json", plant), SETTINGS)
    band = read_band(results / "identification.json")
    rig = days_setup(results, "")
    return rounds.next_round(day, lambda *_: rig, band, policy, folder, 0, 1, lambda text: None)


def days_setup(results, hidden):
    """The command's set-up of the emulated rig in virtual time with a hidden effect."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--parameters", default=str(results / "parameters.json"))
    hil_verb.add_rig(parser)
    return hil_verb.setup_of(parser.parse_args(["--virtual", *(["--hide", hidden] if hidden else [])]))


def test_a_flight_that_ends_early_is_the_last_one(results, tmp_path, monkeypatch):
    """An operator's stop must not begin the next flight."""
    flown = []

    def stopped(setup, settings, profile, folder, twin=None):
        flown.append(folder.name)
        raise RunEnded("operator: Ctrl-C")

    monkeypatch.setattr(rounds, "fly", stopped)
    with pytest.raises(RunEnded, match="round 1: mission: operator: Ctrl-C"):
        a_round(results, tmp_path, "model-based")
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
    policy = mad(learn(PLANT, ParameterSet(CONTROLLER), generations=2, hidden=4, plants=2).policy)
    if not guarded:
        far = tuple(1e9 for _ in policy.law.low)
        policy = replace(policy, law=replace(policy.law, low=tuple(-x for x in far), high=far, precision=(), distance=0.0))
    times = (0.0, 3.0, 16.0) if guarded else (0.0, 1.0, 5.0)  # the PID takes over for longer each time
    profile = Record({"time": np.array(times), "thrust_set": np.array([4.0, 8.0, 8.0])}, "step")
    own = policy.parameters(SETTINGS, setup.allowed.scales)
    done = run_on_rig(setup, KernelController(own.values, PERIOD, own.model), profile, tmp_path)
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
