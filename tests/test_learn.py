"""vpp learn: a law that follows the set-point on unseen plants, its files, and its FMU."""

import json
from dataclasses import replace

import numpy as np
import pytest

from identification.tune.controllers import controllers
from identification.tune.learn import random_steps
from identification.tune.profile import reach, rig_profile
from identification.tune.tune import TuningTask
from vpp_fmu.app.cli import main
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import FINE_TUNED, plant
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.native.closed_loop import ClosedLoop, Course
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.policy import read_policy


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    """A folder with the files of 40 generations of learning; gains.json are the published ones."""
    folder = tmp_path_factory.mktemp("learned")
    std = {"tau_omega_1": 0.02, "tau_beta_2": 0.04, "c20": 0.01, "c21": 0.05}
    ParameterSet(plant()).replaced({n: FINE_TUNED[n] for n in std}, std).save(folder)
    (folder / "gains").mkdir()
    gains = ParameterSet(CONTROLLER).replaced({"t_filter": 0.02}).save(folder / "gains") / "parameters.json"
    words = ["learn", str(folder), "--gains", str(gains), "--generations", "40", "--plants", "8", "-o", str(folder / "policy")]
    assert main(words) == 0
    return folder / "policy"


def test_it_follows_the_set_point_on_a_plant_that_it_has_not_seen(learned):
    policy = read_policy(learned).parameters()
    law, rig = Simulation(policy.model, policy.values), Simulation(plant(), {"tau_beta_2": 0.41, "c21": 0.78})
    thrust = rig.start({"omega_ref": 2000.0, "beta_ref": -5.0})["thrust"]
    law.start({"thrust_set": 3.0, "thrust": thrust})
    for wanted in (3.0, 9.0, 6.0):
        for _ in range(500):
            commands = law.advance({"thrust_set": wanted, "thrust": thrust}, 0.004)
            assert commands.pop("fallback") == 0.0
            thrust = rig.advance(commands, 0.004)["thrust"]
        assert abs(thrust - wanted) < 0.5


def test_the_learning_curve_decreases_and_held_out_plants_are_compared(learned):
    curve = np.loadtxt(learned / "learning_curve.csv", delimiter=",", skiprows=1)
    assert (np.diff(curve[:, 0]) > 0).all()
    assert np.median(curve[-5:, 1]) < 0.5 * curve[0, 1]
    found = json.loads((learned / "learning.json").read_text())
    assert found["held_out_plants"] == 8
    assert set(found["held_out"]) == {"policy", "PID"}
    assert 0.0 <= found["share_of_plants_with_less_error"] <= 1.0
    assert "<script" in (learned / "report.html").read_text()


def test_the_loop_of_a_learned_law_is_the_loop_of_its_functions(learned):
    """The compiled loop of the search against plant and law in Python, without a measurement chain."""
    policy = read_policy(learned).parameters()
    model = replace(policy.model, outputs=policy.model.outputs[:2])
    loop, wanted = ClosedLoop(plant(), model), np.repeat([2.0, 8.0], 50)
    values = np.array(list(model.values({n: policy.values[n] for n in model.values()}).values()))
    sets = [*(np.array(list(m.values().values())) for m in loop.models[:2]), values]
    run = loop.run(sets, Course(wanted, 0.0 * wanted, 0.004, 15.0))
    law, rig = Simulation(model, policy.values), Simulation(plant())
    thrust = rig.start({"omega_ref": 0.0, "beta_ref": 0.0})["thrust"]
    law.start({"thrust_set": 2.0, "thrust": thrust})
    for k, goal in enumerate(wanted.tolist()):
        commands = law.advance({"thrust_set": goal, "thrust": thrust}, 0.004)
        assert (commands["omega_ref"], commands["beta_ref"]) == (run["omega_ref"][k], run["beta_ref"][k])
        thrust = rig.advance(commands, 0.004)["thrust"]


def test_the_pid_is_tuned_on_set_points_of_the_same_kind():
    own = controllers(ParameterSet(plant()))
    task = TuningTask(ParameterSet(plant()), rig_profile(ParameterSet(plant()), own.settings))
    profile = random_steps(task, own.settings["dual"])
    low, high = reach(task.parameters, own.settings["dual"])
    assert (low < profile["thrust_set"]).all()
    assert (profile["thrust_set"] < high).all()
    assert np.diff(profile.time)[:-1].min() > 2.0 * 0.5 - 0.005  # time scales of 0.5 s
    assert np.diff(profile.time)[:-1].max() < 4.0 * 0.5 + 0.005


def test_a_missing_folder_is_refused_in_one_line(tmp_path, refused):
    refused("learn", tmp_path / "nowhere", "-o", tmp_path / "out")
