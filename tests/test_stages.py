"""The search in stages: the speed given to the thrust stage, and how the thrust decides between effects of the speed."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from studies.synthetic import TRUTH, commands

from identification.demo import example_folder
from identification.diagnose import diagnose as diagnosing
from identification.diagnose import given_speed, stages
from identification.diagnose.diagnose import _channels, _other, _unknown_term, _with, diagnose
from identification.diagnose.effort import Effort
from identification.diagnose.given_speed import with_given_speed
from identification.diagnose.lack_of_fit import LackOfFit
from identification.diagnose.score_test import ScoreTest
from identification.diagnose.selection import Selection, nearest
from identification.diagnose.stages import Stage, lack_of, verdict_of
from identification.diagnose.validation import NOTHING_LEFT
from vpp_fmu.campaign import Campaign
from vpp_fmu.kernel.effects.measured_speed import AHEAD
from vpp_fmu.kernel.plant import LIBRARY, plant
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record
from vpp_fmu.rig import infer_rig
from vpp_fmu.sensors import SpeedSensor

NOISE, SPEED_NOISE, STEP = 0.1, 2.0, 0.008  # N, rpm, s
ENCODER = SpeedSensor("encoder")


def test_a_known_speed_replaces_that_of_the_model_between_rows():
    """It is linear between rows. At its start value, -1, it is unknown, and the model's speed is kept."""
    record = commands(np.random.default_rng(1), 3.0)
    known = 4000.0 + 500.0 * np.sin(record.time)
    given = record.with_columns(speed_at_row=known, speed_at_next_row=np.append(known[1:], known[-1:]))
    model = plant((), with_given_speed(LIBRARY))
    values = model.values(TRUTH)
    shown = Simulator(model).simulate(values, *given.run)
    np.testing.assert_allclose(shown[:, 1], known, rtol=1e-9)  # the start settles for a nanosecond
    late = given.with_columns(speed_instant_within=np.full(len(known), 0.002))
    shown_late = Simulator(model).simulate({**values, AHEAD: -0.5}, *late.run)[1:, 1]
    np.testing.assert_allclose(shown_late, known[1:] + 0.001 * np.diff(known) / np.diff(record.time), rtol=1e-6)
    plain = Simulator(plant()).simulate(plant().values(TRUTH), *record.run)
    np.testing.assert_allclose(shown[:, 2], plain[:, 2], rtol=1e-12)
    np.testing.assert_allclose(Simulator(model).simulate(values, *record.run), plain, rtol=1e-12)


def test_a_term_learned_in_one_stage_keeps_the_effects_of_the_other():
    """The speed's only effect is replaced by the learned term; that of the thrust stays, with its judgement and rivals."""
    term = SimpleNamespace(fit=SimpleNamespace(effects=("inflow_lag", "learned")), effect=SimpleNamespace(name="learned"))
    learned = SimpleNamespace(term=term, beside=SimpleNamespace(effects=()), judgement="of the term")
    judged = {"supply_sag": "of the sag", "inflow_lag": "of the inflow"}
    found = _with(Selection(None, None, None, judged, rivals={"supply_sag": {}, "inflow_lag": {"sensor_lag": None}}), learned)
    assert found.judgements == {"inflow_lag": "of the inflow", "learned": "of the term"}
    assert found.family == {"inflow_lag": ["sensor_lag"]}


@pytest.mark.parametrize(
    ("why", "dropped"),
    [(NOTHING_LEFT.format("speed_overshoot"), (0, "speed_overshoot")), ("it predicts worse", (1, "sensor_lag"))],
)
def test_an_effect_that_is_too_small_goes_first_and_else_the_weakest(why, dropped):
    evidence = [{"pitch_speed_coupling": 3000.0, "speed_overshoot": 900.0}, {"sensor_lag": 400.0}]
    each = [{n: SimpleNamespace(evidence=nats) for n, nats in own.items()} for own in evidence]
    found = [SimpleNamespace(selection=SimpleNamespace(judgements=own, rivals={})) for own in each]
    assert _other(SimpleNamespace(refuted=why, stages=found, less=lambda k, name, _: (k, name))) == dropped


def readings(beyond, noise, seed=0):
    """A record of 60 s at 100 Hz whose speed reads 5000 rpm and `beyond` (rows,), with noise."""
    time = np.arange(len(beyond)) / 100.0
    speed = 5000.0 + beyond + noise * np.random.default_rng(seed).standard_normal(len(time))
    columns = {"time": time, "omega_ref": np.full(len(time), 5000.0), "beta_ref": np.zeros(len(time)), "omega": speed}
    return Record(columns, "speed.csv", sensor=ENCODER)


def test_a_remainder_of_noise_is_smoothed_away():
    """The widest kernel, of 64 readings, leaves 1 / sqrt(2 sqrt(pi) 64) = 6.6 % of the noise."""
    found, error = given_speed._beyond(readings(np.zeros(6000), 10.0), np.full(6000, 5000.0))
    assert np.std(found) < 2.0 * 0.066 * 10.0
    assert error == pytest.approx(0.066 * 10.0, rel=0.3)


def test_a_fast_remainder_is_kept():
    """A dip of 100 rpm for 0.1 s, ten times the noise: a kernel of 64 readings would leave a tenth of it."""
    dip = np.where((np.arange(6000) >= 3000) & (np.arange(6000) < 3010), -100.0, 0.0)
    found, _ = given_speed._beyond(readings(dip, 10.0), np.full(6000, 5000.0))
    assert found[3003:3007].mean() < -70.0
    assert np.std(np.delete(found, slice(2800, 3210))) < 3.0


def rig(seed=0, noise=NOISE, step=STEP, **values) -> Campaign:
    """Records with an encoder's speed, a repeat and a validation record."""
    rng = np.random.default_rng(seed)
    first, other = commands(rng, 10.0, step), commands(rng, 6.0, step)
    model, records = plant({name.partition(".")[0] for name in values}), []
    for record, name in ((first, "open_loop"), (first, "repeat"), (other, "validation")):
        shown = Simulator(model).simulate(model.values(TRUTH | values), *record.run)
        noisy = shown[:, :2] + [noise, SPEED_NOISE] * rng.standard_normal((len(record), 2))
        measured = record.with_columns(thrust=noisy[:, 0], omega=noisy[:, 1])
        records.append(replace(measured, source=f"{name}.csv", sensor=ENCODER))
    sensor = {"kind": "encoder"}
    return Campaign(example_folder(), None, (), *records, rig=replace(infer_rig(records, None, {}), sensor=sensor))


DELAYS = tuple(e for e in LIBRARY if e.off is None or e.name in ("speed_delay", "speed_reading_delay", "thrust_gain_drift"))


def test_the_thrust_decides_whether_the_speed_or_its_reading_is_late():
    """Both are the same to the speed. An encoder has no delay of its own: that of a logger is named."""
    found = diagnose(rig(**{"speed_delay.delay": 0.05}), DELAYS, thorough=False)
    assert (found.verdict, found.final.effects) == ("attributed", ("speed_delay",))
    assert found.final.values["speed_delay.delay"] == pytest.approx(0.05, abs=0.003)
    shown = {"speed": ("attributed", ["speed_delay"]), "thrust": ("none", [])}
    assert {name: (one["verdict"], one["effects"]) for name, one in found.channels.items()} == shown
    found = diagnose(rig(**{"speed_reading_delay.delay": 0.05}), DELAYS, thorough=False)
    assert (found.verdict, found.final.effects) == ("attributed", ("speed_reading_delay",))
    assert found.final.values["speed_reading_delay.delay"] == pytest.approx(0.05, abs=0.003)


def test_readings_of_speed_early_by_part_of_a_row_are_no_fault_of_the_thrust():
    """An encoder's instant within the row of 4 ms is unknown. The thrust then seems to be late, by 1.6 ms."""
    lags = [e for e in LIBRARY if e.off is None or e.name in ("inflow_lag", "pitch_rate_feedthrough", "sensor_lag")]
    campaign = rig(noise=0.02, step=0.004)

    def early(record):
        return record.with_columns(omega=np.interp(record.time + 0.0016, record.time, record["omega"]))

    records = {name: early(getattr(campaign, name)) for name in ("open_loop", "repeat", "validation")}
    found = diagnose(replace(campaign, **records), lags, thorough=False)
    assert found.verdict == "none"
    assert found.logger.sensor.delay == pytest.approx(-0.0016, abs=2e-4)
    assert found.final.values["tau_omega_1"] == pytest.approx(TRUTH["tau_omega_1"], abs=5e-4)


@pytest.mark.parametrize(
    ("lacks", "lacks_again", "refused", "complete"),
    [
        (False, False, (), True),
        (False, True, (), True),  # the new logger explains less: so it is refused
        (True, False, (), True),
        (True, True, (), False),
        (False, False, ("chance reaches it",), False),  # another search may find fewer effects
    ],
)
def test_with_another_logger_a_search_is_needed_only_if_it_may_find_a_simpler_set(lacks, lacks_again, refused, complete):
    def stage(lack, refused=()):
        selection = SimpleNamespace(judgements={"sensor_lag": SimpleNamespace(refused=refused)})
        return SimpleNamespace(selection=selection, after=SimpleNamespace(significant=lack))

    found, again = (stage(False), stage(lacks)), (stage(False), stage(lacks_again, refused))
    assert stages._no_simpler(found, again) is complete
    assert not stages._no_simpler((), ())


def test_with_another_logger_the_effects_are_fitted_to_its_records_without_a_search(monkeypatch):
    """The second logger, beside the effect, has commands half a row later. A fault of the thrust leaves the speed alone."""
    searches, second, stage, as_logged = [], [], stages._stage, diagnosing.as_logged

    def counted(*arguments):
        searches.append(arguments)
        return stage(*arguments)

    def later(gate, effects=(), *others, **options):
        found = as_logged(gate, effects, *others, **options)
        if not effects:
            return found
        second.append(effects)
        logger = replace(found.logger, rows=0.5, std=0.01, period=STEP)
        return replace(gate.changed(logger.applied), logger=logger)

    monkeypatch.setattr(stages, "_stage", counted)
    monkeypatch.setattr(diagnosing, "as_logged", later)
    found = diagnose(rig(**{"thrust_gain_drift.rate": -0.004}), DELAYS)
    assert {n: one["effects"] for n, one in found.channels.items()} == {"speed": [], "thrust": ["thrust_gain_drift"]}
    assert (len(second), len(searches)) == (1, 2)


def test_a_selection_on_other_records_has_their_noise(monkeypatch):
    """A single record, whose noise is estimated from its residual; then the same with three times the noise."""
    found, stage = [], stages._stage

    def kept(*arguments):
        found.append(stage(*arguments))
        return found[-1]

    monkeypatch.setattr(stages, "_stage", kept)
    diagnose(replace(rig(), repeat=None, validation=None), DELAYS, thorough=False)
    thrust = found[-1]
    (one,) = thrust.groups[0]
    more = np.sqrt(8.0) * NOISE * np.random.default_rng(7).standard_normal(len(one.record))
    noisier = thrust.on([[replace(one, record=one.record.with_columns(thrust=one.record["thrust"] + more))]], [], thrust.at)
    before, after = (s.judge.searcher.experiments[0].noise.slow for s in (thrust, noisier))
    # Powers below 10 Hz: of 320 blocks each, so their ratio has a standard error of an eighth at most.
    assert after / before == pytest.approx(9.0, rel=3.0 / 8.0)
    tried = nearest(noisier.judge, noisier.selection, noisier.options, Effort(), SimpleNamespace(map=map))
    assert {fit.problem.experiments for _, fit, _ in tried} == {noisier.judge.searcher.experiments}


@pytest.mark.parametrize(
    ("words", "whole"),
    [
        (("none", "none"), "none"),
        (("attributed", "none"), "attributed"),
        (("attributed", "family"), "family"),
        (("attributed", "unexplained"), "partly"),
        (("none", "unexplained"), "unexplained"),
        (("none", "partly"), "partly"),
    ],
)
def test_the_verdict_of_the_whole_is_the_weaker_one(words, whole):
    assert verdict_of([SimpleNamespace(word=word) for word in words]) == whole


@pytest.mark.parametrize(
    ("refuted", "doubted", "thrust"),
    [
        ("", (), ("attributed", ["lag"])),
        ("", ("thrust",), ("partly", ["lag"])),  # a learned term fits better, or the unseen record shows it
        ("rises", (), ("unexplained", [])),
    ],
)
def test_each_channel_agrees_with_the_verdict(refuted, doubted, thrust):
    """A refuted set leaves its channel unexplained if something is missing there."""
    base = {"lacks": False, "accepted": SimpleNamespace(effects=())}
    stages = [SimpleNamespace(name="speed", word="none", **base)]
    stages.append(SimpleNamespace(name="thrust", word="attributed", lacks=True, accepted=SimpleNamespace(effects=("lag",))))
    shown = _channels(SimpleNamespace(stages=stages), None, refuted, doubted)
    assert {name: (one["verdict"], one["effects"]) for name, one in shown.items()} == {"speed": ("none", []), "thrust": thrust}


def lack(missing: float) -> SimpleNamespace:
    return SimpleNamespace(significant=missing > 0.0, missing=missing)


@pytest.mark.parametrize(
    ("terms", "chosen"),
    [
        ({"thrust": (0.0, "")}, "thrust"),
        ({"speed": (0.0, "")}, "speed"),
        ({"speed": (0.4, "")}, "speed"),  # of 1 that is missing beside the base
        ({"speed": (0.6, "")}, None),  # it leaves most of it
        ({"speed": (0.0, "worse on validation.csv")}, None),
        ({"thrust": (0.0, "worse on validation.csv")}, "thrust"),  # the verdict says so
        ({"thrust": (0.0, "worse on validation.csv"), "speed": (0.0, "")}, "speed"),
        ({}, None),
    ],
)
def test_a_term_of_a_stage_without_lack_of_fit_must_explain_most(monkeypatch, terms, chosen):
    """The thrust shows a lack of fit, the speed none. `terms`: what remains beside the one learned there, and is missed."""
    speed, thrust = (SimpleNamespace(name=name) for name in ("speed", "thrust"))
    judge = SimpleNamespace(base="base", lack=lambda fit: lack(1.0 if fit == "base" else terms[fit][0]))
    found = SimpleNamespace(judge=judge, final="present")

    def learned(task, found, stage, present):
        term = SimpleNamespace(term=SimpleNamespace(fit=stage.name)) if stage.name in terms else None
        return SimpleNamespace(learned=term), stage.name

    monkeypatch.setattr(diagnosing, "_learned", learned)
    monkeypatch.setattr(diagnosing, "_with", lambda selection, term: selection)
    monkeypatch.setattr(diagnosing, "_seen_by_validation", lambda found, selection, fit: (fit, terms[fit][1]))
    task = SimpleNamespace(effort=Effort(None, True))
    _, with_term = _unknown_term(task, found, [(thrust, False), (speed, True)], None)
    assert (with_term and with_term.stage.name) == chosen


def test_a_stage_that_explains_less_than_half_gives_no_effect_to_the_model(monkeypatch):
    parts = SimpleNamespace(base="base", final="final", family={})
    stage = Stage(None, (), (), None, parts, None, None)
    for word, accepted in (("unexplained", "base"), ("partly", "final"), ("none", "base")):
        monkeypatch.setattr(Stage, "word", word)
        assert stage.accepted == accepted


@pytest.mark.parametrize(
    ("channel", "effects", "significant", "turns", "lacks"),
    [
        ("speed", ("lag",), False, False, True),
        ("speed", (), False, False, False),
        ("thrust", ("drift",), False, False, False),  # slow noise of a single record may look like it
        ("thrust", ("drift",), True, False, True),
        ("thrust", ("drift",), False, True, True),
    ],
)
def test_what_is_missing_if_a_set_is_refuted(monkeypatch, channel, effects, significant, turns, lacks):
    monkeypatch.setattr(Stage, "accepted", SimpleNamespace(effects=effects))
    lack = SimpleNamespace(significant=significant, turns=turns)
    at = SimpleNamespace(channels=("omega",) if channel == "speed" else ("thrust",))
    assert Stage(at, (), (), None, None, lack, SimpleNamespace(significant=False, turns=False)).lacks is lacks


def stages_of_a_search(monkeypatch, takes_pitch: bool, map_error: float = 0.0) -> list[float]:
    """The errors of the known speed [rpm] of the stages that `searched` runs, in their order: 0 of the speed's. The readings
    give 1.5 rpm."""
    errors = []

    def stage(groups, runs, at, speed_error, *_):
        errors.append(speed_error)
        fit = SimpleNamespace(effects=(), values={})
        noise = SimpleNamespace(experiments=[SimpleNamespace(noise=None)])
        selection = SimpleNamespace(rivals={}, judgements={}, whole=fit, final=fit, base=fit)
        return SimpleNamespace(judge=SimpleNamespace(searcher=noise), selection=selection, corroborated=False)

    at = SimpleNamespace(library=(), names=(), first={}, values={}, of_channels=lambda *_, **__: at)
    monkeypatch.setattr(stages, "_stage", stage)
    monkeypatch.setattr(stages, "_keeping", lambda at, *_: at)
    monkeypatch.setattr(stages, "_takes_pitch", lambda fit: takes_pitch)
    monkeypatch.setattr(stages, "with_given_speed", lambda library: library)
    monkeypatch.setattr(stages, "with_speed_of", lambda groups, *_: (groups, 1.5))
    monkeypatch.setattr(stages, "fitted_base", lambda *_: (None, SimpleNamespace(deviance=0.0)))
    monkeypatch.setattr(stages, "replace", lambda found, **_: found)
    groups = [[SimpleNamespace(record={"omega": np.ones(3)})]]
    stages.searched(groups, [], at, [], None, SimpleNamespace(allows=lambda step: True), None, map_error)
    return errors


@pytest.mark.parametrize(("map_error", "expected"), [(0.0, 1.5), (3.4, 3.4), (1.0, 1.5)])
def test_the_error_of_a_speed_map_bounds_what_the_thrust_shows(monkeypatch, map_error, expected):
    assert stages_of_a_search(monkeypatch, False, map_error) == [0.0, expected]


def test_both_channels_are_searched_again_where_the_speed_takes_the_pitch(monkeypatch):
    assert stages_of_a_search(monkeypatch, True) == [0.0, 1.5, 0.0, 1.5]


def test_where_the_speed_takes_the_pitch_its_readings_tell_the_lags_of_the_pitch(monkeypatch):
    """A noisy thrust tells them poorly. With its lags held, the truth would explain the speed better than the fit does."""
    library = [e for e in LIBRARY if e.off is None or e.name == "pitch_speed_coupling"]
    hidden, found = {"pitch_speed_coupling.gain": 12.0}, []
    searched = stages.searched
    monkeypatch.setattr("identification.diagnose.diagnose.searched", lambda *a: found.extend(searched(*a)) or found)
    diagnose(replace(rig(3, 2.0, **hidden), repeat=None, validation=None), library, thorough=False)
    fit = found[0].selection.final
    assert fit.effects == ("pitch_speed_coupling",)
    there = fit.problem.residual_at(TRUTH | hidden)
    assert np.sum(fit.problem.residual_at(fit.values) ** 2) <= np.sum(there**2) + 0.1
    # Where the values of both stages are exported, the lags of the pitch and their errors are those of the thrust.
    thrust = found[1].selection.final
    both = fit.with_values_of((fit, thrust))
    for name in ("tau_beta_1", "tau_beta_2"):
        assert (both.values[name], both.std()[name]) == (thrust.values[name], thrust.std()[name])
    assert {*both.uncertainty.names} <= {p.name for p in both.problem.model.parameters}  # no shift of the known speed


def test_the_lack_of_fit_of_the_speed_is_that_of_its_stage():
    def shown(speed, size):
        return LackOfFit((), ScoreTest(0.0, 0, ()), 0.5, size, 0.1, True, speed, speed, 10.0 * speed, 3.0)

    stages = [SimpleNamespace(before=shown(0.9, 0.0)), SimpleNamespace(before=shown(0.0, 0.4))]
    both = lack_of(stages, "before")
    assert (both.speed, both.thrust_equivalent, both.speed_rpm, both.size) == (0.9, 0.9, 9.0, 0.4)
    assert lack_of(stages[1:], "before") is stages[1].before
