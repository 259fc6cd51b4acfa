"""The judgement of effects: cross-validation, rules, selection, estimation and refutation, each against a closed form."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from identification.diagnose import acceptance, crossval, diagnose, selection, validation
from identification.diagnose.crossval import HeldOut, contiguous_folds, cross_validated, error_increases, folds, p_no_decrease
from identification.diagnose.effort import Effort
from identification.diagnose.judgement import (
    ALPHA,
    FOLDS,
    MIN_EVIDENCE,
    Judgement,
    chance_threshold,
    model_form_allowance,
    refusals,
)
from identification.diagnose.learned import learn
from identification.diagnose.search.refits import CandidateFit, added, evidence_over
from identification.fit.experiment import Experiment
from identification.fit.noise import independent
from identification.fit.problem import Block, Prior, Score
from identification.fit.uncertainty import WIDEST, Uncertainty, disagreement
from identification.roles import Unseen, roles
from vpp_fmu.campaign import Campaign
from vpp_fmu.kernel.plant import plant
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record

RNG = np.random.default_rng(20)

TIME = np.arange(0.0, 60.0, 0.05)


def fit_of(residual, jacobian, time, thresholds=()):
    """A linear fit as cross-validation sees it: its residual and Jacobian at the least-squares solution."""
    solution, *_ = np.linalg.lstsq(jacobian, -residual, rcond=None)
    left = residual + jacobian @ solution
    problem = SimpleNamespace(
        size=len(left),
        times=[(time, float(time[-1]))],
        experiments=(),
        model=SimpleNamespace(parameters=(), inputs=(), outputs=()),
        score_of=lambda r: SimpleNamespace(squares={"thrust": float(r @ r)}, counts={"thrust": len(r)}),
    )
    problem.coordinates = SimpleNamespace(jacobian=lambda x: np.eye(len(x)))
    parts = {"thresholds": {}, "values": {}, "parts": ()}
    return SimpleNamespace(problem=problem, solution=SimpleNamespace(value=solution), tangent=lambda: (left, jacobian), **parts)


SHORT = np.arange(0.0, 15.0, 0.05)


def estimate(name: str, **others):
    """A fit with its alternative estimates."""
    problem = SimpleNamespace(experiments=[SimpleNamespace(record=SimpleNamespace(time=SHORT))])
    made = {n: lambda *_, one=one: one for n, one in others.items()}
    return SimpleNamespace(name=name, problem=problem, at_rest=False, **made)


def judge_of(rms, runs=None):
    """A judge of fits by the rms of their errors in folds, N, which are 0.1 N but in one block of three if larger, so that no
    difference is significant; `runs`: their mean square errors on step runs."""

    def errors(value):
        return np.where(SHORT < 5.0, np.sqrt(3.0 * value**2 - 2.0 * 0.1**2), 0.1) if value >= 0.1 else np.full(300, value)

    held = {n: HeldOut({"thrust": value**2}, {"thrust": 1}, (errors(value),), ()) for n, value in rms.items()}
    runs = runs or {}
    given = {"runs": [*runs], "on_runs": lambda fit: np.array(runs.get(fit.name, ())), "searcher": None}
    return SimpleNamespace(held_out=lambda fit: held[fit.name], **given)


NO_DECREASE = "a partial explanation, and the held-out thrust error does not decrease significantly"
ON_RUNS = {"present": [0.02], "found": [0.05], "again": [0.05], "held": [0.01]}


@pytest.mark.parametrize(
    ("rms", "runs", "at_rest", "chosen"),
    [
        ((0.09, 0.08, 0.05, 0.2), {}, False, "agreed"),  # the estimate that agrees with the map has priority
        ((0.09, 0.12, 0.05, 0.2), {}, False, "found"),  # unless it predicts worse
        ((0.11, 0.12, 0.10, 0.2), {}, False, "again"),  # as identified only where the present model is better
        ((0.11, 0.12, 0.13, 0.2), {}, False, "found"),
        ((0.08, None, 0.09, 0.2), ON_RUNS | {"again": [0.01]}, False, "again"),  # or is so on step runs
        ((0.08, None, 0.09, 0.2), ON_RUNS, False, "found"),
        # neither goes where the step runs go: the map that was known before
        ((0.08, None, 0.07, 0.09), ON_RUNS, False, "held"),
        ((0.08, None, 0.07, 0.11), ON_RUNS, False, "again"),
        ((0.08, None, 0.07, 0.09), ON_RUNS | {"held": [0.03]}, False, "again"),
        ((0.08, None, 0.07, 0.09), ON_RUNS, True, "again"),  # it has bent the map
    ],
)
def test_the_choice_between_estimates(monkeypatch, rms, runs, at_rest, chosen):
    """Errors of the set as found, beside the agreed map, as identified, and with the map of the present model, of 0.1 N."""
    monkeypatch.setattr(validation, "error_increases", lambda pairs: np.sum(pairs[0][2] ** 2) > np.sum(pairs[0][1] ** 2))
    judge = judge_of(
        dict(zip(("found", "agreed", "again", "held", "present"), (*(r or 1.0 for r in rms), 0.1), strict=True)), runs
    )
    held = estimate("held")
    last = estimate("again", with_map_of=held)
    last.at_rest = at_rest
    own = {"as_identified": last, "with_map_of": held}
    fit = estimate("found", **own, agreed=estimate("agreed", **own))
    assert validation._estimated(judge, rms[1], estimate("present"), fit, []).name == chosen


@pytest.mark.parametrize(
    ("rms", "more", "told"),
    [
        # whatever the evidence, and even if the increase is not significant
        ((0.1, 0.2, 0.1001, 0.1001), {}, "cross-validated thrust error increases from 0.1 to 0.1001 N"),
        ((0.1, 0.2, 0.0999, 0.0999), {}, ""),
        # only the final estimate can refute a set: the static map as prior makes it known
        ((0.1, 0.2, 0.5, 0.09), {}, ""),
        ((0.1, 0.2, 0.5, 0.21), {}, "cross-validated thrust error increases from 0.2 to 0.21 N"),
        # on thirds, the error of a partial explanation must decrease significantly
        ((0.1, 0.1, 0.1, 0.1), {"third": 0.11, "partly": True}, "cross-validated thrust error increases from 0.1 to 0.11 N"),
        ((0.1, 0.1, 0.1, 0.1), {"third": 0.11}, ""),
        ((0.1, 0.1, 0.1, 0.1), {"partly": True}, NO_DECREASE),
        # Half of 40 step runs go further than the folds, or two much further: sqrt(0.01 + 0.48 / 2) = 0.5. The folds gain
        # 0.11^2 - 0.07^2 = 0.0072, less than 0.24 and more than 0.005.
        (
            (0.11, 0.11, 0.07, 0.07),
            {"every": 2, "rise": 0.48},
            "thrust error of the step responses increases from 0.1 to 0.5 N",
        ),
        (
            (0.11, 0.11, 0.07, 0.07),
            {"every": 20, "rise": 4.8},
            "thrust error of the step responses increases from 0.1 to 0.5 N",
        ),
        ((0.11, 0.11, 0.07, 0.07), {"every": 2, "rise": 0.01}, ""),
    ],
)
def test_held_out_data_refute_a_set_that_predicts_worse(monkeypatch, rms, more, told):
    """Errors in folds of the present model, of the base, and of the set as found and as estimated."""
    runs = (
        {n: 0.01 + np.where(np.arange(40) % more["every"], 0.0, more["rise"] * (n == "final")) for n in ("present", "final")}
        if "rise" in more
        else {}
    )
    names = ("present", "base", "found", "final")
    judge, thirds = (
        judge_of(dict(zip(names, rms, strict=True)), runs),
        judge_of({"present": rms[0], "final": more.get("third", rms[3])}),
    )
    monkeypatch.setattr(validation, "by_thirds", thirds.held_out)
    given = validation.Replacement(judge, *map(estimate, names), None, more.get("partly", False))
    assert validation.reason_against(given) == told


def test_cross_validation_is_that_of_refits_without_the_fold(monkeypatch):
    """For a linear model one step is exact: predicting each fold from a least-squares fit of the others."""
    monkeypatch.setattr(crossval, "_errors", lambda fit, moves, split: ((), ()))
    time = np.arange(0.0, 60.0, 0.1)
    jacobian = RNG.standard_normal((len(time), 4))
    measured = jacobian @ np.array([1.0, -2.0, 0.5, 3.0]) + RNG.standard_normal(len(time))
    held = cross_validated(fit_of(-measured, jacobian, time))
    expected, fold = 0.0, (time / 5.0).astype(int) % FOLDS
    for k in range(FOLDS):
        c, *_ = np.linalg.lstsq(jacobian[fold != k], measured[fold != k], rcond=None)
        expected += np.sum((measured[fold == k] - jacobian[fold == k] @ c) ** 2)
    assert held.squares["thrust"] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("split", [folds, contiguous_folds])
def test_a_fold_that_alone_tells_a_parameter_tests_the_model_with_its_value(monkeypatch, split):
    """Two orthogonal parameters; almost only the last fold tells the second, which keeps its value there."""
    monkeypatch.setattr(crossval, "_errors", lambda fit, moves, split: ((), ()))
    time = np.arange(0.0, 60.0, 0.1)
    fold = split(time, 60.0)
    last = fold == fold.max()
    sizes = np.column_stack([np.ones(len(time)), 0.1 + 0.9 * last])
    columns, noise = sizes * RNG.standard_normal(sizes.shape), RNG.standard_normal(len(time))
    for part in (last, ~last):
        one, other = columns[part].T
        columns[part, 1] = other - one * (one @ other) / (one @ one)
    residual = noise - columns @ np.linalg.lstsq(columns, noise, rcond=None)[0]
    expected = 0.0
    for k in range(fold.max() + 1):
        out, known = fold == k, [0] if k == fold.max() else [0, 1]
        c = np.linalg.lstsq(columns[~out][:, known], residual[~out], rcond=None)[0]
        expected += np.sum((residual[out] - columns[out][:, known] @ c) ** 2)
    held = cross_validated(fit_of(residual, columns, time), split)
    assert held.squares["thrust"] == pytest.approx(expected, rel=1e-9)


def test_every_row_is_in_one_fold_and_short_records_have_all_folds():
    for seconds in (3.0, 17.0, 90.0):
        time = np.arange(0.0, seconds, 0.01)
        counts = np.bincount(folds(time, seconds), minlength=FOLDS)
        assert (counts > 0).all()
        assert counts.sum() == len(time)


def test_gain_is_the_profile_likelihood_ratio():
    one, other = HeldOut({"thrust": 50.0}, {"thrust": 100}, (), ()), HeldOut({"thrust": 80.0}, {"thrust": 100}, (), ())
    assert one.gain(other)["thrust"] == pytest.approx(0.5 * 100 * np.log(80.0 / 50.0))


@pytest.mark.parametrize("count", [1, 3])
def test_chance_exceeds_the_threshold_as_often_as_the_level(count):
    """The best of many independent candidates without an effect: half a chi^2 each."""
    comparisons, draws = 50, 20000
    best = 0.5 * chi2.rvs(count, size=(draws, comparisons), random_state=1).max(axis=1)
    passed = np.mean(best > chance_threshold(count, comparisons))
    assert abs(passed - ALPHA) < 3.0 * np.sqrt(ALPHA * (1.0 - ALPHA) / draws)


def test_an_effect_must_pass_every_rule():
    good = {
        "likelihood_gain": 40.0,
        "needed": 10.0,
        "evidence": 30.0,
        "gain": {"thrust": 25.0, "omega": 3.0},
        "parameters": 1,
        "material": True,
    }
    assert refusals(**good) == []
    for change, word in (
        ({"likelihood_gain": 9.0}, "chance"),
        ({"evidence": MIN_EVIDENCE}, "evidence too weak"),
        ({"gain": {"thrust": -4.0, "omega": 3.0}}, "cross-validation gains nothing"),
        ({"gain": {"thrust": -2.0, "omega": 30.0}}, "thrust is predicted worse"),
        ({"material": False}, "least size"),
    ):
        (reason,) = refusals(**good | change)
        assert word in reason
    assert refusals(**good | {"gain": {"thrust": -0.4, "omega": 30.0}}) == []  # the cost of a parameter without effect


def record(**columns):
    time = np.arange(500) * 0.01
    base = {"omega_ref": 4000.0 + 500.0 * (time > 2.0), "beta_ref": 4.0 + 0.0 * time, "thrust": RNG.standard_normal(500)}
    return Record({"time": time, **base, **columns}, "record")


def test_roles_are_kept_apart_by_type(tmp_path):
    own, other = record(), record(beta_ref=np.linspace(0.0, 5.0, 500))
    campaign = Campaign(tmp_path, None, (), own, record(thrust=own["thrust"] + 1.0), other)
    (group,), unseen = roles(campaign, {})
    assert [one.name for one in group] == ["open_loop", "repeat"]
    assert isinstance(unseen, Unseen)
    with pytest.raises(TypeError, match="fitted"):
        Experiment([unseen], None)
    groups, _ = roles(campaign, {"more": other})
    assert [[one.name for one in g] for g in groups] == [["open_loop", "repeat"], ["more"]]


def search_of(monkeypatch, worth, refused=(), lack=None, small=lambda names: (), contains=None, effort=None):
    """The selection by a search on made-up numbers.

    A set of effects has the log-likelihood of the best of its subsets in `worth`. "lag:2" is the lag in its second form.
    `refused`: names that the judge refuses; `lack`: lack of fit of a set, 0 if not listed; `small`: names in a set that are
    below the minimum size; `contains`: special cases of effects."""
    contains, keys = contains or {}, sorted({key for listed in worth for key in listed.split()})

    def fit(*own):
        nats = max(value for listed, value in worth.items() if {*listed.split()} <= {*own})
        names = tuple(sorted(key.partition(":")[0] for key in own))
        model = SimpleNamespace(effects=[SimpleNamespace(name=n, contains=contains.get(n, {})) for n in names])
        parts = {"problem": SimpleNamespace(model=model, experiments=()), "values": {}, "free": (), "slow_first": {}}
        parts |= {"forms": {f"{n}.form": form for n, _, form in (key.partition(":") for key in own)}, "thresholds": {}}
        parts |= {"at_bound": (), "idle": False, "leaves_open": lambda effect: False, "deviance": -2.0 * nats}
        parts |= {"score": SimpleNamespace(counts={"thrust": 1})}
        return SimpleNamespace(effects=names, keys=" ".join(sorted(own)), bic=lambda: -2.0 * nats, **parts)

    def refit(effects, forms, *_, **__):
        return fit(*(n + (form and f":{form}") for n, form in ((n, forms[f"{n}.form"]) for n in effects)))

    def search_round(searcher, beside, *_):
        found = []
        for name, _, form in (key.partition(":") for key in keys):
            parts = {"effect": SimpleNamespace(contains=contains.get(name, {})), "form": {f"{name}.form": form}}
            candidate = SimpleNamespace(name=name, free=(), sizes=(), **parts)
            if name not in beside.effects:
                new = added(searcher, beside, candidate, {}, {})
                found.append(CandidateFit(candidate, beside.effects, 0.0, new, evidence_over(new, beside)))
        return found

    class Judged:
        searcher, base = SimpleNamespace(fit=refit, again=lambda one: one, experiments=()), fit()
        within_sensor = staticmethod(lambda judged: False)

        def __call__(self, name, with_it, without):
            nats, less = evidence_over(with_it, without), name in small(with_it.effects)
            why = ("no",) if less or name in refused or nats <= MIN_EVIDENCE else ()
            return Judgement(name, nats + 5.0, 5.0, nats, {}, 0.2, 0.1, not less, why, less and name not in refused)

        def lack(self, fit):
            missing = (lack or {}).get(fit.keys, 0.0)
            return SimpleNamespace(significant=missing > 0.0, missing=missing)

    monkeypatch.setattr(selection, "search_round", search_round)
    pool, effort = SimpleNamespace(map=map), effort or Effort(thorough=False)
    return selection.select(Judged(), [], lambda judge, fit: None, effort, pool)[1]


BAND = {"contains": {"limits": {"band": {}}}}
SAG = {"": 0.0, "sag": 900.0, "lag sag": 990.0}
BOTH = {"": 0.0, "sag": 900.0, "lag sag": 945.0, "band sag": 940.0, "band lag sag": 980.0}
SELECTED = {
    "a special case fits as well": ({"limits": 100.2, "band": 100.0}, BAND, "band"),
    "the wider effect fits better": ({"limits": 120.0, "band": 100.0}, BAND, "limits"),
    "a special case fits as well beside another": (
        {"limits": 100.0, "band": 75.0, "limits wake": 150.0, "band wake": 149.5},
        BAND,
        "band wake",
    ),
    "the wider effect fits better beside another": (
        {"limits": 100.0, "band": 75.0, "limits wake": 150.0, "band wake": 147.0},
        BAND,
        "limits wake",
    ),
    "another fits better beside it": ({"a": 100.0, "lag": 75.0, "a wake": 150.0, "lag wake": 152.0}, {}, "lag wake"),
    "its other form fits better beside it": ({"a": 100.0, "a:2": 90.0, "a wake": 150.0, "a:2 wake": 160.0}, {}, "a:2 wake"),
    "two others replace it": (
        {"a": 100.0, "b": 60.0, "c": 60.0, "a b": 160.0, "a c": 150.0, "b c": 200.0, "a b c": 202.0},
        {},
        "b c",
    ),
    "it becomes too small": (
        {"clock": 100.0, "band": 90.0, "band clock": 200.0},
        {"small": lambda names: ("clock",) if "band" in names else ()},
        "band",
    ),
    # of a lack of fit of 100 that the first leaves, a correction of its law removes 40, another effect 60
    "it corrects a law": (SAG, {"lack": {"": 1000.0, "sag": 100.0, "lag sag": 60.0}}, "sag"),
    "it explains most of what is left": (SAG, {"lack": {"": 1000.0, "sag": 100.0, "lag sag": 40.0}}, "lag sag"),
    # of two of one size neither removes most of the 100; together they must remove 75, as two that each do so
    "two explain most together": (
        BOTH,
        {"lack": {"": 1000.0, "sag": 100.0, "lag sag": 58.0, "band sag": 62.0, "band lag sag": 22.0}},
        "band lag sag",
    ),
    "two explain too little together": (
        BOTH,
        {"lack": {"": 1000.0, "sag": 100.0, "lag sag": 58.0, "band sag": 62.0, "band lag sag": 28.0}},
        "sag",
    ),
    "weak beside one that is refused": ({"sag": 100.0, "band": 40.0}, {"refused": ("sag",)}, ""),
    "strong beside one that is refused": ({"sag": 100.0, "band": 60.0}, {"refused": ("sag",)}, "band"),
}


@pytest.mark.parametrize("name", SELECTED)
def test_which_effects_are_selected(monkeypatch, name):
    worth, given, names = SELECTED[name]
    assert search_of(monkeypatch, {"": 0.0} | worth, **given).final.keys == names


@pytest.mark.parametrize(("remains", "whole"), [(0.0, "lag"), (5.0, "")])
def test_an_effect_below_the_minimum_size_is_a_nuisance_if_it_explains_all(monkeypatch, remains, whole):
    small = {"small": lambda names: names, "lack": {"": 10.0, "lag": remains}}
    found = search_of(monkeypatch, {"": 0.0, "lag": 50.0}, **small)
    assert (found.whole.keys, found.final.keys, found.judgements) == (whole, "", {})


def test_rivals_have_equal_evidence_in_the_place_of_the_effect(monkeypatch):
    """A lag was near it in its round only; a wider effect that fits as well is no rival."""
    worth = {"": 0.0, "limit": 800.0, "limit:2": 790.0, "band": 795.0, "wide": 800.5, "wake": 200.0, "limit wake": 1100.0}
    worth |= {"band wake": 1097.0, "wide wake": 1100.5, "limit map": 1097.0, "lag limit": 1080.0}
    found = search_of(monkeypatch, worth, contains={"wide": {"limit": {}}})
    assert (found.final.keys, found.family) == ("limit wake", {"limit": ["band"], "wake": ["map"]})


def test_the_budget_ends_a_search_between_rounds(monkeypatch):
    spent = Effort(budget=0.0, thorough=False)
    found = search_of(monkeypatch, {"": 0.0, "limits": 39.0, "limits map": 50.0}, effort=spent)
    assert (found.final.keys, spent.not_tried) == ("limits", ["a further effect + limits"])


@pytest.mark.parametrize(("gained", "word"), [(100.0, "partly"), (8.0, "unexplained")])
def test_a_residual_of_the_speed_does_not_hide_an_explained_thrust(gained, word):
    """A set gains 100 or 8 nats of log-likelihood, and generic regressors 10 more; the speed's residual is unchanged."""
    base, final = (SimpleNamespace(deviance=-2.0 * gain, effects=effects) for gain, effects in ((0.0, ()), (gained, ("lag",))))
    common = {"bands": (), "significant": True, "turns": False, "transient_lack_of_fit": False, "speed_lack_of_fit": True}
    scores = [SimpleNamespace(gain=gain, count=9) for gain in (gained + 10.0, 10.0)]
    before, after = (SimpleNamespace(score=score, speed=0.9, **common) for score in scores)
    assert validation.verdict(base, final, before, after, {}) == word


@pytest.mark.parametrize(("steps", "ships"), [(0.05, ("vibration", "lag")), (0.2, ("lag",)), (None, ("lag",))])
def test_an_effect_with_an_arbitrary_phase_is_kept_only_if_step_runs_confirm_it(monkeypatch, steps, ships):
    """Step runs have phases of their own: without the effect their prediction error is 0.1 N."""
    declared = [SimpleNamespace(name=n, parameters=[SimpleNamespace(initial=n == "vibration")]) for n in ("vibration", "lag")]
    problem = SimpleNamespace(model=SimpleNamespace(effects=declared))
    both, rest = (SimpleNamespace(effects=names, problem=problem) for names in (("vibration", "lag"), ("lag",)))
    rms = {both.effects: steps, rest.effects: 0.1}
    runs = [] if steps is None else [1]
    rng = np.random.default_rng(8)
    squares = {names: None if r is None else r**2 * rng.uniform(0.9, 1.1, 12) for names, r in rms.items()}
    judge = SimpleNamespace(searcher=None, runs=runs, on_runs=lambda one: squares[one.effects], matters=lambda *_: True)
    monkeypatch.setattr(validation, "without", lambda searcher, base, one, name: rest)
    monkeypatch.setattr(validation, "_estimated", lambda judge, knowledge, present, one, parts: one)
    monkeypatch.setattr(validation, "reason_against", lambda given: "")
    final, why = validation.validated(judge, None, None, SimpleNamespace(), SimpleNamespace(effects=()), both)
    assert (final.effects, why) == (ships, "")


def test_a_set_whose_sensitivities_diverge_is_refuted(monkeypatch):
    """A learned term may be unstable beside what another channel asks for."""
    jacobian = np.where(TIME[:, None] > 30.0, np.nan, np.ones((len(TIME), 2)))
    steady, unstable = fit_of(-TIME, np.ones((len(TIME), 1)), TIME), fit_of(-TIME, np.ones((len(TIME), 2)), TIME)
    unstable.tangent, unstable.effects, unstable.problem.model.effects = (lambda: (TIME, jacobian)), ("learned",), []
    monkeypatch.setattr(crossval, "_errors", lambda fit, moves, split: ((np.ones(1),), ()))
    judge = acceptance.Judge(SimpleNamespace(experiments=()), steady, None, ())
    final, why = validation.validated(judge, None, None, steady, SimpleNamespace(effects=()), unstable)
    assert final is steady
    assert "diverges" in why


def test_an_effect_below_the_minimum_size_after_estimation_is_refuted(monkeypatch):
    fit = SimpleNamespace(effects=("band",), problem=SimpleNamespace(model=SimpleNamespace(effects=[])))
    monkeypatch.setattr(validation, "_estimated", lambda judge, knowledge, present, one, parts: one)
    present, judge = SimpleNamespace(name="present"), SimpleNamespace(matters=lambda *_: False)
    final, why = validation.validated(judge, None, None, present, SimpleNamespace(effects=()), fit)
    assert final is present
    assert "band is below the minimum size" in why


@pytest.mark.parametrize(("after", "worse"), [(0.2, True), (0.1, False), (0.05, False)])
def test_an_error_increases_if_the_blocks_agree(after, worse):
    """Twelve blocks of noise with an rms of 0.1 before."""
    rng, time = np.random.default_rng(3), np.arange(0.0, 60.0, 0.05)
    assert error_increases([(time, 0.1 * rng.standard_normal(len(time)), after * rng.standard_normal(len(time)))]) is worse


@pytest.mark.parametrize(("losses", "p"), [([1.0, 2.0, 3.0, 40.0, 500.0, 6e3], 1 / 64), ([-1.0, 2.0], 1 / 2), ([0.0] * 6, 1.0)])
def test_an_error_that_decreases_in_every_block_has_the_least_p_value(losses, p):
    """One of the 64 sign combinations of six differences has a mean as large, however unequal they are; a t test gives 0.16.
    (0.5 and 1.5 of [-1, 2]: two of four.)"""
    assert p_no_decrease([], losses) == pytest.approx(p)


def test_the_allowance_for_the_form_of_another_effect():
    """An effect that explains 8000 nats, with an amplitude error of 5 %, may leave 0.05^2 of them, 20, in its own band."""
    left = 0.05**2 * 8000.0
    assert model_form_allowance(np.array([25.0, 0.0]), np.array([8000.0, 0.0])) == pytest.approx(left)
    assert model_form_allowance(np.array([3.0, 25.0]), np.array([8000.0, 0.0])) == 3.0
    assert model_form_allowance(np.array([-3.0, 25.0]), np.array([8000.0, -3.0])) == 0.0


def thrust_fit(rows):
    """A fit with whitened thrust residuals `rows`, of one record with a repeat, and a speed that it explains."""
    squares, counts = {"thrust": float(rows @ rows), "omega": 10.0}, {"thrust": len(rows), "omega": 10}
    problem = SimpleNamespace(
        residual_at=lambda values: np.append(rows, np.ones(10)),
        scale={"thrust": 1.0, "omega": 1.0},
        experiments=[SimpleNamespace(noise=SimpleNamespace(verified=True))],
        blocks=(Block(0, "thrust", TIME, slice(len(rows))), Block(0, "omega", TIME, slice(len(rows), len(rows) + 10))),
    )
    return SimpleNamespace(problem=problem, values={}, score=Score(squares, counts))


@pytest.mark.parametrize(("weak", "accepted"), [("wave of 2 Hz", True), ("error of the drift's form", False)])
def test_beside_a_strong_drift_an_effect_of_30_nats_is_accepted_in_another_band_alone(weak, accepted):
    """90 s at 100 Hz. A drift explains 16 000 nats, of which its form may leave 40. A lag is visible at 2 Hz, where the drift
    has no power; the error of the drift's form is the residual of a line fitted to a drift that settles."""
    count, since = 9000, np.linspace(-1.0, 1.0, 9000)
    drift = since * np.sqrt(3.0 * np.expm1(2.0 * 16000.0 / count))
    wave, curve = np.sin(2.0 * np.pi * 2.0 * 90.0 * np.arange(count) / count), since**2 - np.mean(since**2)
    trace = wave if weak == "wave of 2 Hz" else curve
    trace *= np.sqrt(2.0 * 30.0 / (trace @ trace))
    known = np.stack([wave, curve, since, np.ones(count)], axis=1)
    noise = np.random.default_rng(4).standard_normal(count)
    noise -= known @ np.linalg.lstsq(known, noise, rcond=None)[0]  # so that the nats are exact
    base, without, with_it = (thrust_fit(rows) for rows in (noise + trace + drift, noise + trace, noise))
    fall, by_forms = acceptance.Judge(SimpleNamespace(experiments=()), base, None, ()).likelihood_gain(with_it, without)
    assert fall == pytest.approx({"thrust": 30.0, "omega": 0.0}, rel=0.02)
    assert by_forms == pytest.approx(0.0 if accepted else fall["thrust"], abs=0.5)
    needed = chance_threshold(1, 500) + by_forms
    assert (refusals(fall["thrust"], needed, 25.0, fall, 1, True) == []) is accepted


@pytest.mark.parametrize(("away", "factor"), [(0.5, 1.0), (2.0, None), (500.0, WIDEST)])
def test_prior_knowledge_is_widened_by_its_disagreement_with_the_records(away, factor):
    """For one parameter d^2 = C + f^2 S has a closed form; f is at least 1 and at most WIDEST."""
    of_records, known = 0.6, 0.3
    uncertainty = Uncertainty(("c20",), np.array([1.0 + away]), np.array([[of_records**2]]), np.ones(1))
    told = Prior(("c20", "c11"), np.array([1.0, 7.0]), np.diag([known**2, 1.0]))
    expected = factor or np.sqrt((away**2 - of_records**2) / known**2)
    assert disagreement(told, uncertainty) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("ahead", "leaves", "elsewhere", "refuted", "driver", "shipped"),
    [
        (9.0, False, False, "", "thrust", "term beside base"),
        (9.0, False, True, "", "thrust", "term beside base"),  # one that explains everything may be at either place
        (4.0, False, False, "", "thrust", "term beside known"),  # as much evidence as the listed effects have
        (9.0, True, False, "", "thrust", "term beside known"),
        (9.0, True, True, "", "thrust", "present"),
        (9.0, False, False, "rises", "thrust", "present"),
        (9.0, False, False, "", "time", "present"),
    ],
)
def test_when_a_learned_term_is_accepted(monkeypatch, ahead, leaves, elsewhere, refuted, driver, shipped):
    """Beside the base it needs 5 nats more than the effects of the list, and no lack of fit may remain. Beside those effects it
    is rejected if lack of fit remains and a term elsewhere explains as much. There is no record of other commands here, so a
    term of time is rejected."""
    base, known = SimpleNamespace(name="base"), SimpleNamespace(name="known", effects=("one", "other"))

    class Tried(diagnose.Attempt):
        joined = lambda self, fit: self  # noqa: E731

    def learn(judge, beside, *_):
        fit, lead = SimpleNamespace(name=f"term beside {beside.name}"), SimpleNamespace(driver=driver)
        term = SimpleNamespace(fit=fit, lead=lead, searcher=lambda other: other)
        return Tried(learned=SimpleNamespace(term=term, curve=None, elsewhere=("another",) * elsewhere))

    monkeypatch.setattr(diagnose, "learn", learn)
    monkeypatch.setattr(diagnose, "joined", lambda searcher, base, fits: fits[-1])
    monkeypatch.setattr(diagnose, "evidence_over", lambda term, other: ahead)
    judge = SimpleNamespace(lack=lambda fit: SimpleNamespace(significant=leaves), searcher=None, base=base, runs=[])
    stage = SimpleNamespace(judge=judge, selection=SimpleNamespace(base=base), accepted=known)
    given = {"stages": [stage], "judge": judge, "unseen": None, "at": SimpleNamespace(rig=SimpleNamespace(scales=None))}
    search = SimpleNamespace(shipped=lambda present, beside, term, parts: (term, refuted), **given)
    task = SimpleNamespace(pool=None, effort=None)
    attempt, final = diagnose._learned(task, search, stage, SimpleNamespace(name="present"))
    assert (final.name, attempt.learned is None) == (shipped, shipped == "present")


LAG = "sensor_lag"


@pytest.mark.parametrize(
    ("beaten", "needed", "by", "left", "doubted"),
    [
        ((), (), 20.0, [("b", "a"), ("c", LAG)], []),
        (("b",), (), 20.0, [("a",), ("c", LAG)], ["speed"]),
        (("b",), (), 200.0, [("a",), ("c",)], ["speed"]),  # more than the evidence of the delay
        (("b",), ("b",), 20.0, [("b", "a"), ("c", LAG)], ["speed"]),  # the term is something else
        (("a", "c"), (), 20.0, [("b", "a"), ("c", LAG)], ["speed", "thrust"]),  # the strongest of a stage stays
        (("b", "a"), (), 20.0, [(), ("c", LAG)], ["speed"]),  # without the weaker one it explains too little
        ((LAG,), (), 20.0, [("b", "a"), ("c",)], ["thrust"]),
    ],
)
def test_names_that_stand_in_for_something_else_are_dropped(monkeypatch, beaten, needed, by, left, doubted):
    """Effects with 100 nats and more. A learned term beats some of them `by` so many nats; some are `needed`
    beside it. A delay of the thrust is no finding where more is missing in the speed."""
    evidence = {"a": 130.0, "b": 110.0, "c": 120.0, LAG: 100.0}

    def stage(name, *effects):
        judged = {n: SimpleNamespace(evidence=evidence[n]) for n in effects}
        given = {"selection": SimpleNamespace(judgements=judged, base=None), "judge": SimpleNamespace(searcher=None)}
        return SimpleNamespace(name=name, accepted=SimpleNamespace(effects=effects), **given)

    def found(*stages):
        def less(k, effect, why):
            rest = stage(stages[k].name, *(n for n in stages[k].accepted.effects if n not in (effect, *beaten[1:])))
            return found(*stages[:k], rest, *stages[k + 1 :])

        return SimpleNamespace(stages=stages, less=less, at=SimpleNamespace(rig=SimpleNamespace(scales=None)))

    term = SimpleNamespace(fit=None, lead=SimpleNamespace(port="thrust"))
    monkeypatch.setattr(diagnose, "without", lambda searcher, base, fit, name: fit.effects[fit.effects.index(name)])
    monkeypatch.setattr(diagnose, "better_than", lambda judge, name, *_: term if name in beaten else None)
    monkeypatch.setattr(diagnose, "remains_beside", lambda term, searcher, name, fit: name in needed)
    monkeypatch.setattr(diagnose, "evidence_over", lambda term, other: by)
    task = SimpleNamespace(pool=None, effort=Effort())
    given, doubts = diagnose._undoubted(task, found(stage("speed", "b", "a"), stage("thrust", "c", LAG)))
    assert [s.accepted.effects for s in given.stages] == left
    assert [*doubts] == doubted


@pytest.mark.parametrize(
    ("one", "other", "chosen"),
    [
        # (number of effects, held-out error, verdict); an error of form, 0.25 % of the power, is 0.125 % of the rms
        ((1, 1.0, "attributed"), (2, 1.0, "attributed"), 1),
        ((1, 1.0012, "attributed"), (2, 1.0, "attributed"), 1),
        ((1, 1.0014, "attributed"), (2, 1.0, "attributed"), 2),
        ((1, 2.0, "attributed"), (2, 1.0, "partly"), 1),  # fewer that explain everything
        ((0, 1.0012, "none"), (0, 1.0, "unexplained"), "none"),
    ],
)
def test_a_logger_replaces_a_delay_where_it_predicts_as_well(one, other, chosen):
    def found(count, rmse, verdict):
        final, held_out = SimpleNamespace(effects=("a", "delay")[:count]), SimpleNamespace(rmse_thrust=rmse)
        return SimpleNamespace(final=final, held_out_after=held_out, word=verdict)

    for simpler in (diagnose._simpler(found(*one), found(*other)), diagnose._simpler(found(*other), found(*one))):
        assert chosen in (len(simpler.final.effects), simpler.word)


def unseen_beside(monkeypatch, more, zero=0.0, shift=0.0):
    """(an unseen record of 60 s with the error `more` (rows,) N beside noise of 0.1 N, its noise model, a fit without misfit).
    The model predicts no thrust; one standard error of its parameter is the share `shift` of `more`."""
    rng, time = np.random.default_rng(3), np.arange(0.0, 60.0, 0.01)
    thrust = zero + more(time) + 0.1 * rng.standard_normal(len(time))
    monkeypatch.setattr(validation, "_error_and_shifts", lambda fit, record: np.array([-thrust, shift * more(time)]))
    record = Record({"time": time, "omega_ref": 0.0 * time, "beta_ref": 0.0 * time, "thrust": thrust}, "validation.csv")
    noise, white = replace(independent(0.1 / np.sqrt(5.0)), block=0.05), rng.standard_normal(1200)
    about = SimpleNamespace(residual=white - white.mean(), directions=lambda rows: np.full((1, 1200), 1200.0**-0.5))
    experiment = SimpleNamespace(records=[None], sizes={"thrust": 1200})
    problem = SimpleNamespace(experiments=[experiment], scale={"thrust": 1.0})
    return Unseen("validation", record), SimpleNamespace(problem=problem, linearised=lambda: about), noise


@pytest.mark.parametrize(
    ("extra", "shift", "missed"),
    [
        (0.0, 0.0, False),
        (0.04, 0.0, True),
        (0.04, 0.5, False),  # two standard errors of a parameter
        (0.04, 0.1, True),  # ten
        (0.04, 0.01, True),  # a hundred
    ],
)
def test_an_unseen_record_may_have_no_more_power_than_the_noise(monkeypatch, extra, shift, missed):
    """In blocks of 0.05 s the noise is 0.1 / sqrt(5) N; a sine of 2 Hz of 0.04 N rms has 0.8 of its power.

    The 120 ordinates from 1 to 3 Hz have a ratio of powers within 1.4 of 1 in 999 of 1000 draws. A constant error is the zero
    of another day.
    """
    sine = lambda time: np.sqrt(2.0) * extra * np.sin(4.0 * np.pi * time)  # noqa: E731
    unseen, fit, noise = unseen_beside(monkeypatch, sine, 0.5, shift)
    why = validation.worse_than_noise(unseen, fit, noise, fit, 0.01)
    assert ("worse than the noise allows" in why) is missed
    assert validation.worse_than_noise(unseen, fit, noise, fit, 0.1) == ""  # smaller than anything of interest


def test_slow_noise_of_another_draw_is_no_misfit(monkeypatch):
    """A swing of three periods in the record is two ordinates of six below 0.1 Hz: four degrees of freedom show nothing at ten
    times the noise's power there. The mean of all ordinates below 10 Hz would."""
    swing = lambda time: 0.008 * np.sin(2.0 * np.pi * 0.05 * time)  # noqa: E731
    unseen, fit, noise = unseen_beside(monkeypatch, swing)
    assert validation.worse_than_noise(unseen, fit, noise, fit, 0.001) == ""


def test_the_variance_of_a_prediction_is_that_of_its_parameters():
    """Two collinear parameters and one known exactly; the variance of the thrust is that of the linear model."""
    covariance = np.array([[4e-4, -1.9e-4, 0.0], [-1.9e-4, 1e-4, 0.0], [0.0, 0.0, 0.0]])
    names, model = ("c20", "c21", "c30"), plant()
    known = Uncertainty(names, np.ones(3), covariance, np.ones(3))
    fit = SimpleNamespace(problem=SimpleNamespace(model=model), values=model.values(), uncertainty=known)
    one = record()
    _, *shifts = validation._error_and_shifts(fit, one)
    tangents = Simulator(model, names).sensitivities(fit.values, *one.run)[1][:, 0]
    variance = np.einsum("ri,ij,rj->r", tangents, covariance, tangents)
    assert np.sum(np.square(shifts), axis=0) == pytest.approx(variance, rel=1e-6)


@pytest.mark.parametrize(
    ("gained", "beside_flicker", "explained", "stands_in"),
    [(4.0, 4.0, 0.0, False), (6.0, 6.0, 0.0, True), (20.0, 20.0, 8000.0, False), (40.0, 2.0, 0.0, False)],
)
def test_a_learned_term_must_not_fit_better_than_a_named_effect(monkeypatch, gained, beside_flicker, explained, stands_in):
    """By more than 5 nats, beside flicker noise, and the 0.25 % that the form of a right effect may leave: 20 of 8000."""
    effect = SimpleNamespace(name="lag", channels=("beta",), in_speed=False, reading="")
    with_it = SimpleNamespace(effects=("lag",), problem=SimpleNamespace(model=SimpleNamespace(effects=[effect])))
    rest, term, channels = SimpleNamespace(effects=()), SimpleNamespace(fit="term"), []
    monkeypatch.setattr(learn, "screened", lambda fit, spread, channel: channels.append(channel) or [])
    monkeypatch.setattr(learn, "_refitted", lambda *_: [term])
    monkeypatch.setattr(learn, "evidence_over", lambda one, other: gained if one == "term" else explained)
    judge, pool = SimpleNamespace(searcher=None, evidence=lambda *_: beside_flicker), SimpleNamespace(map=map)
    assert learn.better_than(judge, rest, with_it, None, pool) is (term if stands_in else None)
    assert channels == ["beta"]


@pytest.mark.parametrize(("kept", "remains"), [(60.0, True), (40.0, False)])
def test_an_effect_beside_a_learned_term_must_keep_most_of_its_evidence(kept, remains):
    """Of 100 nats. The set of the term gets the effect with its form and free parameters, from the values of both."""
    asked = []

    def fit(*arguments, thorough):
        asked.extend(arguments[:4])
        return SimpleNamespace(bic=lambda: 500.0 - 2.0 * kept)

    def made(bic, *effects):
        values = {f"{name}.size": float(len(effects)) for name in effects}
        more = {"forms": {f"{name}.form": 2.0 for name in effects}, "free": [*values], "values": values, "slow_first": {}}
        return SimpleNamespace(effects=effects, bic=lambda: bic, **more)

    term = SimpleNamespace(fit=made(500.0, "learned"), searcher=lambda other: SimpleNamespace(fit=fit))
    assert learn.remains_beside(term, None, made(900.0, "sag"), made(700.0, "sag", "lag")) is remains
    forms, free = {"learned.form": 2.0, "lag.form": 2.0}, ["learned.size", "lag.size"]
    assert asked == [["learned", "lag"], forms, free, {"learned.size": 1.0, "lag.size": 2.0}]
