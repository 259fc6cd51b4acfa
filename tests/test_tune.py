"""Gains: the paper's cost, the order of the search, limits, draws of plants, and the command."""

import json
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from builders import FAST_PITCH, shorten_tuning

from identification.fit.problem import Prior
from identification.tune.draws import Posterior
from identification.tune.objective import Point
from identification.tune.profile import step_profile
from identification.tune.search import rounds, search
from identification.tune.summary import summary
from identification.tune.tune import TuningTask, tune
from vpp_fmu.app import cli
from vpp_fmu.app.report.pages.tuning import TuneResult
from vpp_fmu.kernel.controller import CONTROLLER, DUAL, SPEED_ONLY
from vpp_fmu.kernel.plant import FINE_TUNED, plant
from vpp_fmu.loop import run
from vpp_fmu.parameters import ParameterSet, read_parameters, to_json
from vpp_fmu.plants import KernelController, KernelPlant
from vpp_fmu.record import Record

CHAIN = {"delay": 0.29, "resolution": 0.003}
STARTS = {"dual": DUAL, "speed_only": SPEED_ONLY}

SHORT = Record({"time": np.array([0.0, 0.4, 1.2, 2.0]), "thrust_set": np.array([2.0, 10.0, 3.0, 3.0])}, "short")
SHORT_CSV = "time,thrust_set\n0,2\n0.4,10\n1.2,3\n2,3\n"


def a_task(profile=None, **more):
    parameters = ParameterSet(plant()).replaced(FAST_PITCH)
    return TuningTask(parameters, profile or step_profile(), assumed=tuple(FAST_PITCH), chain=CHAIN, **more)


@pytest.fixture(scope="module")
def nominal():
    with pytest.MonkeyPatch.context() as patch:
        shorten_tuning(patch.setattr)
        return tune(a_task(), STARTS)


@pytest.mark.parametrize("gains", [DUAL, SPEED_ONLY], ids=["dual", "speed only"])
def test_the_cost_is_the_papers(gains):
    """Squared normalised error, integrated over the loop's own record, and alpha times the squared norm of the gains."""
    objective = TuningTask(a_task().parameters, step_profile(), alpha=1e-5).objective(gains)
    names = [name for name in gains if name[:2] in ("kp", "ki", "kd")]
    assert set(objective.names) == set(names)
    record = run(KernelPlant(parameters=FAST_PITCH), KernelController(gains), step_profile(), objective.course.rest)
    error = ((record["thrust_set"] - record["thrust"]) / 15.0)[:-1]
    expected = np.sum(error**2) * 0.004 + 1e-5 * sum(gains[name] ** 2 for name in names)
    assert objective.cost(objective.gains) == pytest.approx(expected, rel=1e-12)


def test_the_penalty_is_proportional_to_the_excess_over_a_limit():
    free = replace(a_task().objective(DUAL), overshoot=1.0, sensitivity=100.0)
    gains, cost = free.gains, free.cost(free.gains)
    assert free.penalised(gains) == cost
    ((_, overshoot),) = free.merits(gains)
    assert 100.0 * overshoot == pytest.approx(max(step.overshoot for step in free.steps(gains)), rel=1e-12)
    assert replace(free, overshoot=overshoot / 1.5).penalised(gains) == pytest.approx(cost * (1.0 + 10.0 * 0.5))
    tight = replace(free, sensitivity=1.5, points=(Point(12.0, (5500.0, 8.0), ("omega", "beta")),))
    largest = tight.largest_sensitivity(gains)
    assert largest == pytest.approx(2.55, abs=0.05)
    assert tight.penalised(gains) == pytest.approx(cost * (1.0 + 10.0 * (largest / 1.5 - 1.0)))


@dataclass
class Bowl:
    """A cost with a known minimum over the gains, which records the gains that it was called with."""

    names: tuple[str, ...] = ("kp_omega", "kp_beta", "ki_omega", "ki_beta", "kd_omega", "kd_beta")
    best: tuple[float, ...] = (3.0, 0.5, 40.0, 7.0, 0.1, 0.0)
    time_scale: float = 0.5
    tried: list = field(default_factory=list)

    def penalised(self, gains):
        self.tried.append(gains.copy())
        best = np.array(self.best)
        off = np.r_[np.log(gains[:4] / best[:4]), 10.0 * (gains[4:] - best[4:])]
        return 1.0 + off @ off + 0.5 * off[0] * off[2] + 0.5 * off[2] * off[4]


def test_the_search_finds_a_known_minimum_in_the_papers_order():
    bowl = Bowl()
    found = search(bowl, np.array([9.82, 9.0, 115.3, 70.44, 0.318, 0.25]))
    np.testing.assert_allclose(found.gains, bowl.best, rtol=0.05, atol=0.005)
    tried = np.array(bowl.tried)
    proportional = int(np.argmax(tried[:, 4:].any(axis=1)))  # the first with a derivative
    again = int(np.argmax((np.arange(len(tried)) > proportional) & (tried[:, :4] != tried[proportional, :4]).any(axis=1)))
    assert 100 < proportional < again - 10 < len(tried) - 110
    assert (tried[:, :4] > 0.0).all()
    assert (tried[:, 4:] >= 0.0).all()
    assert found.cost == bowl.penalised(found.gains) == min(map(bowl.penalised, tried))


@pytest.mark.parametrize("name", STARTS)
def test_tuned_gains_cost_less_than_the_published_ones_and_keep_the_limits(nominal, name):
    tuned = nominal.tuned[name]
    assert tuned.cost("tuned") <= tuned.cost("start")
    found = tuned.objective.steps(tuned.gains["tuned"])
    assert max(step.overshoot for step in found) <= 1.02
    assert all(step.settling < 0.6 for step in found)
    assert all(m.stable for m in tuned.margins["tuned"])
    assert max(m.sensitivity for m in tuned.margins["tuned"]) <= 2.03
    assert tuned.fmu_difference == 0.0


def test_the_gains_do_not_depend_on_the_number_of_workers(short_search):
    objective = a_task(SHORT).objective(SPEED_ONLY)
    starts = {"speed_only": [(objective.gains, ("all",)), (0.5 * objective.gains, ("all",))]}
    alone, together = (rounds({"speed_only": objective}, starts, workers=n)["speed_only"][1] for n in (1, 2))
    np.testing.assert_array_equal(alone.gains, together.gains)
    assert alone.cost == together.cost


def test_robust_gains_are_better_over_the_plants_they_were_tuned_on(short_search):
    task = a_task(SHORT, robust="worst", draws=30)
    found = tune(task, {"speed_only": SPEED_ONLY})
    tuned = found.tuned["speed_only"]
    drawn = replace(tuned.objective, plants=task.plants(30, stream=0))
    assert drawn.cost(tuned.gains["robust"]) <= drawn.cost(tuned.gains["tuned"])
    judged = replace(tuned.objective, plants=found.plants)
    assert len(found.plants) == 200
    assert tuned.judged["robust"].max() == judged.cost(tuned.gains["robust"])
    assert tuned.cost("tuned") <= tuned.cost("robust")
    assert summary(found)["controllers"]["speed_only"]["judged"]["robust"]["worst"] == tuned.judged["robust"].max()
    assert "Robustness over plants within the uncertainty" in TuneResult(found).page().html()


EFFECTS = ("pitch_command_deadband", "pitch_backlash")
KNOWN = ParameterSet(plant(EFFECTS)).replaced(
    {"c20": 0.35, "pitch_command_deadband.half_width": 1.5, "pitch_backlash.half_gap": 0.02, "tau_beta_2": 0.05},
    {"c20": 0.01, "pitch_command_deadband.half_width": 0.2, "tau_beta_2": 0.03},
)


def test_draws_have_the_standard_deviations_and_the_correlation():
    std = {"c20": 0.01, "c30": 0.02, "pitch_command_deadband.half_width": 0.2, "pitch_backlash.half_gap": 0.05}
    covariance = np.array([[4.0, -5.4], [-5.4, 9.0]])
    knowledge = Prior(("c30", "c20"), np.zeros(2), covariance)
    posterior = Posterior(KNOWN, std, knowledge)
    drawn = posterior.draw(np.random.default_rng(0), 20_000)
    names = [p.name for p in KNOWN.model.parameters]
    columns = drawn[:, [names.index(name) for name in std]]
    np.testing.assert_allclose(columns[:, :3].mean(axis=0), [0.35, FINE_TUNED["c30"], 1.5], atol=0.005)
    np.testing.assert_allclose(columns[:, :3].std(axis=0), [0.01, 0.02, 0.2], rtol=0.03)
    assert np.corrcoef(columns.T)[0, 1] == pytest.approx(-0.9, abs=0.01)
    assert abs(np.corrcoef(columns.T)[0, 2]) < 0.03
    assert columns[:, 3].min() == 0.0  # held at the parameter's bound
    others = [names.index(name) for name in names if name not in std]
    assert (drawn[:, others] == np.array([KNOWN.values[names[k]] for k in others])).all()
    again, other = (posterior.draw(np.random.default_rng(seed), 5) for seed in (0, 1))
    np.testing.assert_array_equal(again, drawn[:5])
    assert not np.any(np.isclose(again[:, names.index("c20")], other[:, names.index("c20")]))


IDENTIFICATION = {
    "parameters": {"c20": {"value": 0.35, "std": 0.01}, "c30": {"value": -0.081, "std": 0.02}},
    "correlation": {"names": ["c20", "c30"], "matrix": [[1.0, -0.9], [-0.9, 1.0]]},
    "noise_floor_thrust": 0.1,
}


def vpp(folder, *arguments):
    return cli.main(["tune", "-o", str(folder / "out"), *arguments])


def test_the_command_writes_gains_that_export_takes(tmp_path, capsys, short_search):
    (tmp_path / "plant.json").write_text(to_json(KNOWN))
    (tmp_path / "p.csv").write_text(SHORT_CSV)
    (tmp_path / "known.json").write_text(json.dumps(IDENTIFICATION))
    arguments = ("--parameters", str(tmp_path / "plant.json"), "--profile", str(tmp_path / "p.csv"))
    arguments += ("--knowledge", str(tmp_path / "known.json"))
    assert vpp(tmp_path, *arguments, "--assume", "tau_beta_1=0.15", "--verbose") == 0
    said = capsys.readouterr().out
    assert "exported FMUs against the loop of the search: the same thrust to the bit" in said
    assert said.count("  2 → 10 N at 0.4 s: settling ") == said.count("  gain margin ") == 2
    content = json.loads((tmp_path / "out" / "tuning.json").read_text())
    assert content["objective"]["assumed"] == {"tau_beta_1": 0.15}
    assert content["objective"]["effects"] == list(EFFECTS)
    assert content["objective"]["measurement"]["noise"] == 0.1
    for file, name, label in (("gains.json", "dual", "both actuators"), ("gains_speed_only.json", "speed_only", "speed alone")):
        gains = read_parameters(tmp_path / "out" / file, lambda _: CONTROLLER)
        assert gains.values["speed_only"] == float(name == "speed_only")
        assert gains.source["parameters"] == {"file": "plant.json", "identity": KNOWN.identity}
        verdict = content["controllers"][name]["verdict"]["tuned"]
        assert f"tuned gains, {label}: {'better' if verdict['better'] else 'no better'} (" in said
        assert [[c["name"] for c in s["changes"]] for s in verdict["steps"]] == [["settling", "overshoot", "ringing"]] * 2
        assert gains.source["verdict"]["tuned"] == verdict["words"]
        told = content["controllers"][name][content["controllers"][name]["handed_out"]]
        assert {n: gains.values[n] for n in told["gains"]} == told["gains"]
        assert told["cost"] == pytest.approx(told["squared_error"] + 1e-8 * sum(g**2 for g in told["gains"].values()))
        assert [step["before"] for step in told["steps"]] == [2.0, 10.0]
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Both actuators against speed alone" in page
    assert "tau_beta_1 = 0.15" in page


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--assume", "tau=1"), "--assume: found tau=1"),
        (("--assume", "tau_beta_2=fast"), "--assume tau_beta_2: found fast"),
        (("--assume", "tau_beta_2=-1"), "a number from 0.001 to 30 s"),
        (("--delay", "0.1"), "--delay: found 0.1 s"),
        (("--parameters", "nowhere.json"), "no such file"),
        (("--profile", "nowhere.csv"), "no such file"),
    ],
)
def test_bad_options_are_refused_in_one_line(tmp_path, refused, arguments, told):
    assert told in refused("tune", "-o", tmp_path / "out", *arguments)
    assert not (tmp_path / "out").exists()
