"""Tuned gains are chosen only if no step settles later, overshoots or rings more, in the search and after it."""

from dataclasses import replace

import numpy as np
import pytest

from identification.tune.controllers import controllers
from identification.tune.margins import Margins, least
from identification.tune.profile import rig_profile
from identification.tune.search import SearchResult
from identification.tune.summary import summary
from identification.tune.tune import TuningTask, tune
from identification.tune.verdict import verdict
from vpp_fmu.app.report.pages.tuning import TuneResult
from vpp_fmu.kernel.plant import plant
from vpp_fmu.native.closed_loop import Course
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record
from vpp_fmu.response import steps
from vpp_fmu.rig import Rig

DIAGNOSED = {
    "pitch_command_deadband.half_width": 1.7014,
    "tau_beta_1": 0.1029,
    "tau_beta_2": 0.05,
    "tau_omega_1": 0.15694,
    "tau_omega_2": 0.05064,
    "c20": 0.35797,
    "c11": 0.05864,
    "c21": 0.77136,
    "c12": -0.1826,
    "c30": -0.08796,
}
"""Diagnosed parameters of the example campaign, with --assume tau_beta_2=0.05 as in the help."""

CREEPING = np.array([1.7208, 5.7744, 24.6139, 10.4041, 0.0, 0.0])
"""Gains of less cost than the published ones, within the limits on overshoot and sensitivity, with a slow tail: the first step
has not settled when the next one comes."""


@pytest.fixture(scope="module")
def example():
    """(task, settings of the dual controller)."""
    rig = Rig(pitch=(-10.0, 10.0), thrust=(0.78, 12.47), scales=replace(Rig().scales, time_scale=0.3))
    model = plant(["pitch_command_deadband"])
    parameters = ParameterSet(model, source={"rig": rig.summary()}).replaced(DIAGNOSED)
    own = controllers(parameters).settings
    chain = {"delay": 0.29, "resolution": 0.003}
    return TuningTask(parameters, rig_profile(parameters, own), ("tau_beta_2",), chain), own["dual"]


def response(time, thrust, wanted=1.0):
    """A record of a step from 0 to `wanted` N at 0 s; the first row is before it."""
    time, thrust = np.r_[-1.0, time], np.r_[0.0, thrust]
    return Record({"time": time, "thrust_set": np.r_[0.0, np.full(len(time) - 1, wanted)], "thrust": thrust}, "made up")


@pytest.mark.parametrize("damping", [0.2, 0.5, 0.7])
@pytest.mark.parametrize("size", [1.0, -8.0])
def test_a_second_order_loop_overshoots_and_rings_as_the_textbook_says(damping, size):
    """The overshoot is exp(-pi zeta / sqrt(1 - zeta^2)), and the following undershoot is its square."""
    time, root = np.linspace(0.0, 30.0, 30001), np.sqrt(1.0 - damping**2)
    thrust = 1.0 - np.exp(-damping * time) * (np.cos(root * time) + damping / root * np.sin(root * time))
    (step,) = steps(response(time, size * thrust, size))
    first = np.exp(-np.pi * damping / root)
    assert step.overshoot == pytest.approx(100.0 * first, rel=1e-4)
    assert step.ringing == pytest.approx(100.0 * first**2, rel=1e-4)
    assert (step.time, step.end) == (0.0, 30.0)


def test_gains_that_cost_less_and_settle_later_are_not_chosen(example, monkeypatch):
    """The search is replaced by one that returns such gains, so that only the verdict can reject them."""
    task, settings = example
    objective = task.objective(settings)
    cost = objective.cost(CREEPING)
    assert cost < 0.99 * objective.cost(objective.gains)
    assert objective.penalised(CREEPING) == cost  # within all limits but those that the first gains set
    brought = {"dual": (objective, SearchResult(CREEPING, cost))}
    monkeypatch.setattr("identification.tune.tune.rounds", lambda *_: brought)
    found = tune(task, {"dual": settings})
    tuned = found.tuned["dual"]
    assert tuned.chosen == "start"
    np.testing.assert_array_equal(tuned.final, objective.gains)
    words = tuned.verdicts["tuned"].words()
    edge = least(tuned.margins["start"]).sensitivity
    assert edge > 2.02
    kept = f"no better: kept the gains it started from, though their sensitivity is {edge:.3g}, limit 2; settling 0.4"
    assert words.startswith(kept)
    assert "→ not settled on the step 1.5 → 12 N at 1.8 s" in words
    content = summary(found)["controllers"]["dual"]
    assert content["handed_out"] == "published"
    assert content["verdict"]["tuned"]["better"] is False
    page = TuneResult(found).page().html()
    assert "Chosen: the published gains." in page
    assert "not settled worse" in page


def test_the_search_keeps_the_settling_times_of_the_first_gains(example, short_search):
    """On the same plant the real search finds gains that settle no later, and they are chosen."""
    task, settings = example
    found = tune(task, {"dual": settings}).tuned["dual"]
    verdict = found.verdicts["tuned"]
    assert found.chosen == "tuned", verdict.words()
    assert found.cost("tuned") < found.cost("start")
    for step in verdict.steps:
        settling = step.changes[0]
        assert settling.other <= settling.first + 1.01 * found.objective.course.dt
    assert verdict.margins[1].sensitivity <= 2.03


SOUND = Margins(True, 4.0, 0.0, 40.0, 10.0, 0.02, 1.5)


class Loop:
    """The part of an objective that a verdict uses: two steps, the second of which can be changed."""

    overshoot, sensitivity = 0.01, 2.0
    course = Course(np.zeros(2), np.zeros(2), 0.004, 15.0)
    gains = "first"

    def __init__(self, **other):
        time, thrust = np.arange(0.0, 2.0, 0.004), 1.0 - np.exp(-np.arange(0.0, 2.0, 0.004) / 0.1)
        (step,) = steps(response(time, thrust))
        self.known = {"first": (step, step), "other": (step, replace(step, **other))}

    def steps(self, gains):
        return self.known[gains]


SETTLED = 0.392  # 0.1 s ln 50, at the next sample


@pytest.mark.parametrize(
    ("other", "worse"),
    [
        ({"settling": SETTLED + 0.004}, ""),
        ({"settling": SETTLED + 0.008}, "settling 0.392 → 0.4 s on the step 0 → 1 N at 0 s"),
        ({"settling": None}, "settling 0.392 → not settled on the step"),
        ({"overshoot": 1.0}, ""),
        ({"overshoot": 1.1}, "overshoot 0.00 → 1.10 %"),
        ({"ringing": 0.9}, ""),
        ({"ringing": 3.0}, "ringing 0.00 → 3.00 %"),
    ],
)
def test_a_step_is_worse_by_more_than_a_sample_or_beyond_the_limit(other, worse):
    found = verdict(Loop(**other), "other", ((SOUND,), (SOUND,)), (1.0, 0.5))
    assert found.better == (not worse)
    assert worse in found.words()
    assert found.words().startswith("no better: kept the gains it started from" if worse else "better: ")
