"""The judgement of effects: cross-validation, rules, selection, estimation and refutation, each against a closed form."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from identification.diagnose import acceptance, crossval, diagnose, selection, validation
from identification.diagnose.crossval import HeldOut, cross_validated, error_increases, folds, p_no_decrease
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
from identification.diagnose.selection import _ranked
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


def reason_against(judge, shipped, base, found, final, partly=False):
    """Reason of `validation` against a set without a validation record."""
    return validation.reason_against(validation.Replacement(judge, shipped, base, found, final, None, partly))


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


def test_a_special_case_ranks_before_the_wider_effect_that_fits_as_well():
    def tried(name, evidence, contains=()):
        effect = SimpleNamespace(contains=dict.fromkeys(contains))
        return SimpleNamespace(candidate=SimpleNamespace(name=name, effect=effect), evidence=evidence)

    wide, narrow, other = tried("limits", 100.2, ("band",)), tried("band", 100.0), tried("lag", 90.0)
    assert [t.candidate.name for t in _ranked([wide, narrow, other])] == ["band", "limits", "lag"]
    better = tried("limits", 120.0, ("band",))
    assert [t.candidate.name for t in _ranked([better, narrow, other])] == ["limits", "band", "lag"]


@pytest.mark.parametrize(("band", "lag", "name"), [(-0.5, -0.5, "band"), (-3.0, 0.5, "limits"), (-3.0, 2.0, "lag")])
def test_the_order_of_effects_is_tried_again_beside_the_whole_set(monkeypatch, band, lag, name):
    """The wider effect, first when alone, is replaced if its special case fits as well, or another effect better."""
    wide = SimpleNamespace(name="limits", contains={"band": {}})
    problem = SimpleNamespace(model=SimpleNamespace(effects=[wide]))
    for other in ("wake", "band", "lag"):
        problem.model.effects.append(SimpleNamespace(name=other, contains={}))
    worth = {"limits": 0.0, "band": band, "lag": lag}
    fits = {n: SimpleNamespace(effects=(n, "wake"), problem=problem, bic=lambda w=w: -w, worth=w) for n, w in worth.items()}
    near = [SimpleNamespace(candidate=SimpleNamespace(name=n)) for n in worth]
    monkeypatch.setattr(selection, "without", lambda *_: SimpleNamespace())
    monkeypatch.setattr(selection, "_near", lambda found, effect: near if effect in worth else [])
    monkeypatch.setattr(selection, "_in_place", lambda searcher, rest, tried: fits[tried.candidate.name])
    monkeypatch.setattr(selection, "evidence_over", lambda fit, other: fit.worth - other.worth)
    monkeypatch.setattr(selection, "_pruned", lambda judge, one, nuisances: (one, dict.fromkeys(one.effects)))
    found = selection.Selection(None, None, fits["limits"], dict.fromkeys(("limits", "wake")))
    judge = type("Judged", (), {"searcher": None, "base": None, "__call__": lambda *_: SimpleNamespace(refused=())})()
    while selection._exchanged(found, judge, set(), SimpleNamespace(map=map)):
        pass
    assert found.whole.effects == (name, "wake")


def weighed(effect, evidence, size):
    return Judgement(effect, evidence + 5.0, 5.0, evidence, {}, size, 0.1, material=size >= 0.1)


@pytest.mark.parametrize(("size", "kept"), [(0.2, ("band", "clock")), (0.01, ("band",))])
def test_an_effect_that_became_too_small_beside_another_is_dropped(monkeypatch, size, kept):
    """The clock has enough evidence. Below the minimum size it leaves the set, and no other effect leaves with it."""
    monkeypatch.setattr(selection, "without", lambda searcher, base, fit, name: SimpleNamespace(effects=fit.effects[:1]))
    whole, evidence, sizes = (
        SimpleNamespace(effects=("band", "clock")),
        {"band": 1500.0, "clock": 14.0},
        {"band": 0.3, "clock": size},
    )
    judge = type("Judged", (), {"searcher": None, "base": None})()
    judge.__class__.__call__ = lambda _, name, fit, rest: weighed(name, evidence[name], sizes[name])
    assert selection._pruned(judge, whole, set())[0].effects == kept
    found, named = selection._pruned(judge, whole, {"clock"})  # a nuisance stays, and is not named
    assert (found.effects, list(named)) == (("band", "clock"), ["band"])


def searched_by(monkeypatch, worth, refused=(), lack=lambda effects: 0.0):
    """A search in which each set of effects has this evidence over none. `refused`: names that the judge refuses; `lack`: what
    a set of effects leaves of the lack of fit."""
    names = sorted({name for effects in worth for name in effects})
    model = SimpleNamespace(effects=[SimpleNamespace(name=n, contains={}) for n in names])

    def fit(*effects):
        problem = SimpleNamespace(model=model, experiments=())
        more = {"forms": {}, "at_bound": (), "thresholds": {}, "problem": problem}
        return SimpleNamespace(effects=effects, worth=worth[tuple(sorted(effects))], **more)

    def search_round(searcher, beside, options, pool, progress):
        sets = {n: (*beside.effects, n) for n in names if n not in beside.effects}
        known = {n: fit(*effects) for n, effects in sets.items() if tuple(sorted(effects)) in worth}
        effect = lambda n: SimpleNamespace(name=n, effect=SimpleNamespace(contains={}), form={})  # noqa: E731
        gains = {n: f.worth - beside.worth for n, f in known.items()}
        return [SimpleNamespace(candidate=effect(n), fit=f, evidence=gains[n], beside=beside.effects) for n, f in known.items()]

    def left(fit):
        return SimpleNamespace(significant=lack(fit.effects) > 0.0, missing=lack(fit.effects))

    monkeypatch.setattr(selection, "search_round", search_round)
    monkeypatch.setattr(selection, "_exchanged", lambda *_: False)
    monkeypatch.setattr(selection, "_rivals", lambda *_: {})
    monkeypatch.setattr(
        selection, "_pruned", lambda judge, one, nuisances: (one, {n: weighed(n, 90.0, 0.3) for n in one.effects})
    )
    parts = {"searcher": SimpleNamespace(again=lambda one: one), "base": fit(), "lack": lambda _, fit: left(fit)}
    judge = type("Judged", (), parts | {"within_sensor": lambda *_: False})()
    judge.__class__.__call__ = lambda _, name, *rest: Judgement(
        name, 9.0, 5.0, 8.0, {}, 0.2, 0.1, refused=("no",) if name in refused else ()
    )
    effort = Effort(thorough=False)
    _, found = selection.select(judge, [], lambda judge, fit: None, effort, None)
    return found


def test_a_further_effect_must_explain_most_of_what_is_left(monkeypatch):
    """A wrong law leaves 100; a correction to it 60, the other hidden effect 40."""
    worth = {(): 0, ("sag",): 900, ("lag", "sag"): 990}
    for leaves, names in ((60.0, ("sag",)), (40.0, ("sag", "lag"))):
        lack = {(): 1000.0, ("sag",): 100.0, ("sag", "lag"): leaves}
        found = searched_by(monkeypatch, worth, lack=lambda effects, lack=lack: lack[effects])
        assert found.final.effects == names
    assert "lag" not in found.refused


@pytest.mark.parametrize(("weak", "named"), [(40, ()), (60, ("band",))])
def test_nothing_weak_is_accepted_beside_a_strong_refused_candidate(monkeypatch, weak, named):
    """The leader of 100 nats is refused: a candidate of less than half of that would stand in for it."""
    worth = {(): 0, ("sag",): 100, ("band",): weak}
    assert searched_by(monkeypatch, worth, refused=("sag",)).final.effects == named


def test_the_budget_ends_a_search_between_rounds(monkeypatch):
    worth = {(): 0, ("limits",): 39, ("limits", "map"): 50}
    spent = Effort(budget=0.0, thorough=False)
    monkeypatch.setitem(globals(), "Effort", lambda **_: spent)
    assert searched_by(monkeypatch, worth).final.effects == ("limits",)
    assert spent.not_tried == ["a further effect + limits"]


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


@pytest.mark.parametrize(("partly", "told"), [(True, "cross-validated thrust error increases from 0.1 to 0.11 N"), (False, "")])
def test_a_partial_explanation_must_not_increase_the_error_on_thirds(monkeypatch, partly, told):
    """The error of left-out thirds increases by a tenth, in one of three blocks alone, which is not significant."""
    old, new = np.full(300, 0.1), np.where(SHORT < 5.0, np.sqrt(3.0 * 0.11**2 - 2.0 * 0.1**2), 0.1)
    assert refuted(monkeypatch, old, old, new, partly) == told


SHORT = np.arange(0.0, 15.0, 0.05)


def refuted(monkeypatch, was, now, thirds, partly=False, runs=()):
    """The reason against a set beside which the errors (300,) at SHORT are `now` in folds and `thirds` in thirds, instead of
    `was`. `runs`: mean squares on step runs, `was` and `now`."""
    shipped = SimpleNamespace()
    fit = SimpleNamespace(problem=SimpleNamespace(experiments=[SimpleNamespace(record=SimpleNamespace(time=SHORT))]))
    old, *new = (HeldOut({"thrust": 1.0}, {"thrust": 1}, (errors,), ()) for errors in (was, now, thirds))
    monkeypatch.setattr(validation, "cross_validated", lambda one, split: old if one is shipped else new[1])
    judge = SimpleNamespace(runs=list(runs), on_runs=lambda one: runs["was" if one is shipped else "now"])
    judge.held_out = lambda one: old if one is shipped else new[0]
    return reason_against(judge, shipped, shipped, fit, fit, partly)


class Estimates:
    """A judge of fits given by the rms of their errors in folds, scaled from one noise: all differences are significant."""

    runs = ()

    def __init__(self, **rms):
        noise = np.random.default_rng(5).standard_normal(len(TIME))
        errors = {n: value * noise / np.sqrt(np.mean(noise**2)) for n, value in rms.items()}
        self._held = {n: HeldOut({"thrust": rms[n] ** 2}, {"thrust": 1}, (e,), ()) for n, e in errors.items()}

    def held_out(self, fit):
        return self._held[fit.name]


def estimate(name: str, **others):
    """A fit with its alternative estimates."""
    problem = SimpleNamespace(experiments=[SimpleNamespace(record=SimpleNamespace(time=TIME))])
    made = {n: lambda *_, one=one: one for n, one in others.items()}
    return SimpleNamespace(name=name, problem=problem, at_rest=False, **made)


@pytest.mark.parametrize(
    ("found", "agreed", "again", "chosen"),
    [
        (0.09, 0.08, 0.05, "agreed"),  # the estimate that agrees with the map has priority
        (0.09, 0.12, 0.05, "found"),  # unless it predicts worse
        (0.11, 0.12, 0.10, "again"),  # as identified only where the present model is better
        (0.11, 0.12, 0.13, "found"),
    ],
)
def test_the_choice_between_estimates_by_cross_validation(found, agreed, again, chosen):
    judge = Estimates(present=0.1, found=found, agreed=agreed, again=again, held=0.2)
    last = estimate("again", with_map_of=estimate("held"))
    own = {"as_identified": last, "with_map_of": estimate("held")}
    fit = estimate("found", **own, agreed=estimate("agreed", **own))
    assert validation._estimated(judge, object(), estimate("present"), fit).name == chosen


@pytest.mark.parametrize(
    ("at_rest", "held", "runs", "chosen"),
    [
        (False, 0.09, 0.01, "held"),  # neither estimate of its own goes where the step runs go, and the map was known before
        (False, 0.11, 0.01, "again"),
        (False, 0.09, 0.03, "again"),
        (True, 0.09, 0.01, "again"),  # it has bent the map
    ],
)
def test_the_previous_map_is_kept_if_step_runs_refute_the_new_one(at_rest, held, runs, chosen):
    judge = Estimates(present=0.1, found=0.08, again=0.07, held=held)
    judge.runs, judge.on_runs = [1], lambda fit: np.full(3, {"present": 0.02, "held": runs}.get(fit.name, 0.05))
    last = estimate("again", with_map_of=estimate("held"))
    last.at_rest = at_rest
    fit = estimate("found", as_identified=last)
    assert validation._estimated(judge, None, estimate("present"), fit, []).name == chosen


@pytest.mark.parametrize(("losses", "p"), [([1.0, 2.0, 3.0, 40.0, 500.0, 6e3], 1 / 64), ([-1.0, 2.0], 1 / 2), ([0.0] * 6, 1.0)])
def test_an_error_that_decreases_in_every_block_has_the_least_p_value(losses, p):
    """One of the 64 sign combinations of six differences has a mean as large, however unequal they are; a t test gives 0.16.
    (0.5 and 1.5 of [-1, 2]: two of four.)"""
    assert p_no_decrease([], losses) == pytest.approx(p)


def test_rivals_come_from_the_round_that_added_the_effect():
    """Alone: a limit 800 nats, in another form 790, a wake 200; beside the limit a map has nearly the evidence of the wake."""

    def tried(name, evidence, form=1.0):
        return SimpleNamespace(candidate=SimpleNamespace(name=name, form={f"{name}.form": form}), evidence=evidence, fit=True)

    first = [tried("limit", 800.0), tried("limit", 790.0, 2.0), tried("band", 795.0), tried("wake", 200.0)]
    rounds = [first, [tried("wake", 300.0), tried("map", 280.0)]]
    judgements = {"limit": SimpleNamespace(evidence=900.0), "wake": SimpleNamespace(evidence=300.0)}
    final = SimpleNamespace(effects=("limit", "wake"), forms={"limit.form": 1.0, "wake.form": 1.0})
    found = SimpleNamespace(rounds=rounds, whole=final, judgements=judgements)
    near = {
        effect: [(t.candidate.name, *t.candidate.form.values()) for t in selection._near(found, effect)]
        for effect in judgements
    }
    assert near == {"limit": [("limit", 2.0), ("band", 1.0)], "wake": [("map", 1.0)]}


@pytest.mark.parametrize(
    ("on_runs", "chosen"), [({"found": 0.02, "again": 0.01}, "again"), ({"found": 0.02, "again": 0.03}, "found")]
)
def test_step_runs_can_choose_the_other_estimate(on_runs, chosen):
    held = estimate("held")
    judge = Estimates(present=0.1, found=0.08, again=0.09, held=0.2)
    judge.runs, judge.on_runs = [1], lambda fit: np.full(3, {"present": 0.01, "held": 1.0, **on_runs}[fit.name])
    fit = estimate("found", as_identified=estimate("again", with_map_of=held), with_map_of=held)
    assert validation._estimated(judge, None, estimate("present"), fit, []).name == chosen


@pytest.mark.parametrize(
    ("found", "final", "told"),
    [
        (0.1001, 0.1001, "cross-validated thrust error increases from 0.1 to 0.1001 N"),
        (0.0999, 0.0999, ""),
        (0.5, 0.09, ""),  # only the final estimate can refute a set: the static map as prior makes it known
        (0.5, 0.21, "cross-validated thrust error increases from 0.2 to 0.21 N"),
    ],
)
def test_a_model_with_a_larger_cross_validation_error_is_refuted(monkeypatch, found, final, told):
    """Whatever the evidence, and even if the increase is not significant."""
    monkeypatch.setattr(validation, "error_increases", lambda *_: False)
    judge = Estimates(present=0.1, found=found, final=final, base=0.2)
    monkeypatch.setattr(validation, "cross_validated", lambda one, split: judge.held_out(one))
    fits = (estimate(name) for name in ("present", "base", "found", "final"))
    assert reason_against(judge, *fits) == told


@pytest.mark.parametrize(
    ("every", "rise", "told"),
    [
        (2, 0.48, "thrust error of the step responses increases from 0.1 to 0.5 N"),
        (20, 4.8, "thrust error of the step responses increases from 0.1 to 0.5 N"),
        (2, 0.01, ""),
    ],
)
def test_a_larger_error_on_step_runs_refutes_a_set(monkeypatch, every, rise, told):
    """A limit at the edge of the fitted commands: half of 40 runs go further, or two much further (not significant in a t
    test). Their mean square increases from 0.01 N^2 by `rise`, sqrt(0.01 + 0.48 / 2) = 0.5. The folds gain 0.11^2 - 0.07^2 =
    0.0072, less than 0.24 and more than 0.005."""
    runs = {"was": np.full(40, 0.01), "now": 0.01 + np.where(np.arange(40) % every, 0.0, rise)}
    was, now = np.full(300, 0.11), np.full(300, 0.07)
    assert refuted(monkeypatch, was, now, now, runs=runs) == told


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
    ("ahead", "leaves", "elsewhere", "refuted", "driver", "looks", "shipped"),
    [
        (9.0, False, False, "", "thrust", ["base"], "term beside base"),
        (9.0, False, True, "", "thrust", ["base"], "term beside base"),  # one that explains everything may be at either place
        (
            4.0,
            False,
            False,
            "",
            "thrust",
            ["base", "known"],
            "term beside known",
        ),  # as much evidence as the listed effects have
        (9.0, True, False, "", "thrust", ["base", "known"], "term beside known"),
        (9.0, True, True, "", "thrust", ["base", "known"], "present"),
        (9.0, False, False, "rises", "thrust", ["base", "known"], "present"),
        (9.0, False, False, "", "time", ["base", "known"], "present"),
    ],
)
def test_when_a_learned_term_is_accepted(monkeypatch, ahead, leaves, elsewhere, refuted, driver, looks, shipped):
    """Beside the base it needs 5 nats more than the effects of the list, and no lack of fit may remain. Beside those effects it
    is rejected if lack of fit remains and a term elsewhere explains as much. There is no record of other commands here, so a
    term of time is rejected."""
    base, known, seen = SimpleNamespace(name="base"), SimpleNamespace(name="known", effects=("one", "other")), []

    class Tried(diagnose.Attempt):
        def joined(self, fit):
            return self

    def learn(judge, beside, *_):
        seen.append(beside.name)
        fit, lead = SimpleNamespace(name=f"term beside {beside.name}"), SimpleNamespace(driver=driver)
        term = SimpleNamespace(fit=fit, lead=lead, searcher=lambda other: other)
        return Tried(learned=SimpleNamespace(term=term, curve=None, elsewhere=("another",) * elsewhere))

    monkeypatch.setattr(diagnose, "learn", learn)
    monkeypatch.setattr(diagnose, "joined", lambda searcher, base, fits: fits[-1])
    monkeypatch.setattr(diagnose, "evidence_over", lambda term, other: ahead)
    judge = SimpleNamespace(lack=lambda fit: SimpleNamespace(significant=leaves), searcher=None, base=base, runs=[])
    stage = SimpleNamespace(judge=judge, selection=SimpleNamespace(base=base), accepted=known)
    shipping = lambda present, beside, term, parts: (term, refuted)  # noqa: E731
    search = SimpleNamespace(
        stages=[stage], judge=judge, unseen=None, at=SimpleNamespace(rig=SimpleNamespace(scales=None)), shipped=shipping
    )
    task = SimpleNamespace(pool=None, effort=None)
    attempt, final = diagnose._learned(task, search, stage, SimpleNamespace(name="present"))
    assert (seen, final.name) == (looks, shipped)
    assert (attempt.learned is None) == (shipped == "present")


@pytest.mark.parametrize(
    ("beaten", "needed", "by", "left", "doubted"),
    [
        ((), (), 20.0, (("b", "a"), ("c", "sensor_lag")), set()),
        (("b",), ("a explains too little",), 20.0, ((), ("c", "sensor_lag")), {"speed"}),
        (("b",), (), 20.0, (("a",), ("c", "sensor_lag")), {"speed"}),
        (("b",), (), 200.0, (("a",), ("c",)), {"speed"}),  # more than the evidence of the delay
        (("b",), ("b",), 20.0, (("b", "a"), ("c", "sensor_lag")), {"speed"}),  # the term is something else
        (("a", "b"), (), 20.0, (("a",), ("c", "sensor_lag")), {"speed"}),  # the strongest of a stage stays
        (("a",), (), 20.0, (("b", "a"), ("c", "sensor_lag")), {"speed"}),
        (("sensor_lag",), (), 20.0, (("b", "a"), ("c",)), {"thrust"}),
    ],
)
def test_names_that_stand_in_for_something_else_are_dropped(monkeypatch, beaten, needed, by, left, doubted):
    """Effects with 100 nats and more. A learned term beats some of them `by` so many nats; some are `needed` beside it. A delay
    of the thrust is no finding where more is missing in the speed."""
    evidence = {"a": 130.0, "b": 110.0, "c": 120.0, "sensor_lag": 100.0}

    def stage(name, effects):
        judged = {n: SimpleNamespace(evidence=evidence[n]) for n in effects}
        fit = SimpleNamespace(effects=effects)
        judge = SimpleNamespace(searcher=None)
        return SimpleNamespace(name=name, accepted=fit, judge=judge, selection=SimpleNamespace(judgements=judged, base=None))

    class Found(SimpleNamespace):
        def less(self, k, effect, why):
            had = self.stages[k]
            stages = list(self.stages)
            left = tuple(n for n in had.accepted.effects if n != effect)
            stages[k] = stage(had.name, left)
            if f"{left[0]} explains too little" in needed:
                stages[k].accepted = SimpleNamespace(effects=())
            return Found(stages=stages, at=self.at)

    def better(judge, rest, fit, scales, pool):
        return SimpleNamespace(fit=None, lead=SimpleNamespace(port="thrust")) if rest in beaten else None

    monkeypatch.setattr(diagnose, "without", lambda searcher, base, fit, name: fit.effects[fit.effects.index(name)])
    monkeypatch.setattr(diagnose, "better_than", better)
    monkeypatch.setattr(diagnose, "remains_beside", lambda term, searcher, rest, fit: rest in needed)
    monkeypatch.setattr(diagnose, "evidence_over", lambda term, other: by)
    task = SimpleNamespace(pool=None, effort=SimpleNamespace(allows=lambda step: True, stage=lambda step: None))
    stages = [stage("speed", ("b", "a")), stage("thrust", ("c", "sensor_lag"))]
    found, doubts = diagnose._undoubted(task, Found(stages=stages, at=SimpleNamespace(rig=SimpleNamespace(scales=None))))
    assert tuple(s.accepted.effects for s in found.stages) == left
    assert set(doubts) == doubted


@pytest.mark.parametrize(("error", "chosen"), [(1.0, "few"), (1.0012, "few"), (1.0014, "many"), (0.9, "few")])
def test_a_logger_replaces_a_delay_where_it_predicts_as_well(error, chosen):
    """An error of form, 0.25 % of the power, is 0.125 % of the rms. Fewer effects that explain everything come before more that
    do not, whatever the error."""

    def found(name, effects, rmse, verdict="attributed"):
        final, held_out = SimpleNamespace(effects=effects), SimpleNamespace(rmse_thrust=rmse)
        return SimpleNamespace(name=name, final=final, held_out_after=held_out, word=verdict)

    few, many = found("few", ("a",), error), found("many", ("a", "delay"), 1.0)
    assert diagnose._simpler(few, many).name == diagnose._simpler(many, few).name == chosen
    part = found("many", ("a", "delay"), 1.0, "partly")
    assert diagnose._simpler(few, part).name == diagnose._simpler(part, few).name == "few"
    nothing, some = found("few", (), error, "none"), found("many", (), 1.0, "unexplained")
    assert diagnose._simpler(nothing, some).name == diagnose._simpler(some, nothing).name == chosen


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
    rest, term = SimpleNamespace(effects=()), SimpleNamespace(fit="term")
    channels = []

    def screened(fit, spread, channel):
        channels.append(channel)
        return []

    monkeypatch.setattr(learn, "screened", screened)
    monkeypatch.setattr(learn, "_refitted", lambda *_: [term])
    monkeypatch.setattr(learn, "evidence_over", lambda one, other: gained if one == "term" else explained)
    judge, pool = SimpleNamespace(searcher=None, evidence=lambda *_: beside_flicker), SimpleNamespace(map=map)
    assert learn.better_than(judge, rest, with_it, None, pool) is (term if stands_in else None)
    assert channels == ["beta"]


@pytest.mark.parametrize(("kept", "remains"), [(60.0, True), (40.0, False)])
def test_an_effect_beside_a_learned_term_must_keep_most_of_its_evidence(kept, remains):
    """Of 100 nats. The set of the term gets the effect with its form and free parameters, from the values of both."""
    asked = {}

    def fit(effects, forms, free, start, order, thorough):
        asked.update(effects=effects, forms=forms, free=free, start=start)
        return SimpleNamespace(bic=lambda: 500.0 - 2.0 * kept)

    def made(effects, bic):
        names = [f"{name}.size" for name in effects]
        forms, values = {f"{name}.form": 2.0 for name in effects}, dict.fromkeys(names, float(len(effects)))
        return SimpleNamespace(effects=effects, forms=forms, free=names, values=values, slow_first={}, bic=lambda: bic)

    term = SimpleNamespace(fit=made(("learned",), 500.0), searcher=lambda other: SimpleNamespace(fit=fit))
    rest, with_it = made(("sag",), 900.0), made(("sag", "lag"), 700.0)
    assert learn.remains_beside(term, None, rest, with_it) is remains
    assert asked == {
        "effects": ["learned", "lag"],
        "forms": {"learned.form": 2.0, "lag.form": 2.0},
        "free": ["learned.size", "lag.size"],
        "start": {"learned.size": 1.0, "lag.size": 2.0},
    }
