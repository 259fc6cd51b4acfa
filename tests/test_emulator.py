"""The studies' emulator of rigs against closed forms, and the studies' handling of cases."""

from dataclasses import replace

import numpy as np
import pytest
from builders import two_lags
from studies import command_sequences, scores
from studies.cases import WHOLE
from studies.detectable import STEP, behind, evidence
from studies.noise import HUM, SPIKE, SPIKES, Noise
from studies.noise import KINDS as NOISES
from studies.physics import PAPER, Frame, in_time, run
from studies.rig import SIZES, Files, Rig, campaign, random_base, save

from vpp_fmu.campaign import read_campaign

PLAIN = Frame(row=0.004, step=1e-4, slow=1.0, full=6000.0)


def commands(clock, seconds=12.0, seed=3):
    return command_sequences.both(np.random.default_rng(seed), clock, seconds)


@pytest.mark.parametrize("name", SIZES)
def test_a_rig_at_rest_shows_its_map(name):
    size = SIZES[name]
    rig = Rig(in_time(PAPER, size.slow), size, 250.0)
    w, b = 0.7, 0.4
    found = rig.run(*size.commands(np.full(50, w), np.full(50, b)))
    c = rig.settings
    map_ = c["c20"] * w**2 + c["c11"] * w * b + c["c21"] * w**2 * b + c["c12"] * w * b**2 + c["c30"] * w**3
    assert found.omega == pytest.approx(np.full(50, w), rel=1e-9)
    assert rig.force(found, 0, 0) == pytest.approx(np.full(50, size.thrust * map_), rel=1e-6)


def test_lags_answer_a_step_as_two_lags_do():
    w = np.repeat([0.5, 0.9], [25, 475])
    found = run(PAPER, PLAIN, w, w)
    t = 0.004 * (np.arange(500) - 25)
    for signal, a, c in ((found.omega, 0.172, 0.053), (found.beta, 0.2, 0.07)):
        assert signal == pytest.approx(0.5 + 0.4 * two_lags(t, a, c), abs=0.4 * 2e-3)  # steps of 0.1 ms against 53 ms


@pytest.mark.parametrize("kind", [*NOISES, "1/f"])
def test_noise_has_its_declared_power_spectrum(kind):
    noise, rows = Noise(kind, 0.13, 0.004, 1.0, 0.003), 2**17
    # A force that wanders over many counts: else one of a coarse converter's counts would always be the same.
    force = np.cumsum(0.01 * np.random.default_rng(1).standard_normal(rows))
    error = noise.reading(np.random.default_rng(2), force) - force
    turns = np.fft.rfftfreq(rows)[1:]
    if kind == "spikes":
        struck = np.abs(error) > 0.5 * SPIKE[0] * noise.std
        assert struck.mean() == pytest.approx(SPIKES, rel=4.0 / np.sqrt(SPIKES * rows))
        error = np.where(struck, 0.0, error)
    ratio = np.abs(np.fft.rfft(error)[1:]) ** 2 / rows / noise.power(turns)
    lines = kind == "1/f + hum"
    if lines:
        hum = np.any([np.abs(turns / 0.004 - f) < 0.3 for f in HUM], axis=0)
        assert ratio[hum].max() > 1000.0
        ratio, turns = ratio[~hum], turns[~hum]
    bands = np.array_split(ratio, 8)
    # Each ratio is exponential with mean 1 where the noise is Gaussian; Student's t of 3 degrees has no fourth moment.
    error_of_mean = 1.0 / np.sqrt(len(bands[0]))
    for band in bands:
        assert band.mean() == pytest.approx(1.0, abs=(12.0 if kind == "Student t" else 5.0) * error_of_mean)
    slowest = ratio[: 2000 if not lines else 500]
    assert slowest.mean() == pytest.approx(1.0, abs=0.25)


def test_a_campaign_has_its_factors_in_memory_and_as_a_folder(tmp_path):
    for flags in ((True, False, True, False), (False, True, False, True)):
        files = Files(15.0, *flags)
        rig = Rig(random_base(np.random.default_rng(0), 0.3), SIZES["micro"], 100.0)
        measured = campaign(rig, np.random.default_rng(0), files)
        there = tuple(f"{n}.csv" for n, had in zip(WHOLE, flags, strict=True) if not had)
        assert set(measured.missing) == set(there)
        assert measured.open_loop.time[-1] == pytest.approx(15.0, abs=0.05)
        save(measured, rig.size, tmp_path / str(flags[0]))
        again = read_campaign(tmp_path / str(flags[0]))
        assert again.missing == measured.missing
        assert again.rig.summary() == measured.rig.summary() | {"thrust": again.rig.summary()["thrust"]}
        assert again.open_loop["thrust"] == pytest.approx(measured.open_loop["thrust"], abs=1e-9)
        # No command leaves the range that rig.json declares, and the map's scales are those in which it was drawn.
        low, high = measured.rig.speed
        for record in (again.open_loop, again.validation, *again.steps):
            assert record is None or low <= record["omega_ref"].min() <= record["omega_ref"].max() <= high
        assert {n: getattr(again.rig.scales, n) for n in rig.size.scales} == rig.size.scales


def test_evidence_is_zero_without_an_effect_and_adds_up_over_records():
    rig = Rig(dict(PAPER), rate=100.0)
    told = rig.size.commands(*commands(rig.clock))
    assert evidence(rig, PAPER, *told) == pytest.approx(0.0, abs=1e-6)
    bent = replace(rig, settings=PAPER | {"backlash": 0.05})
    one, two = (evidence(bent, PAPER, *told, records=n) for n in (1, 2))
    assert two == pytest.approx(2.0 * one)
    assert evidence(bent, PAPER, *told, {"backlash": 0.05}) == pytest.approx(0.0, abs=1e-6)
    # Half the noise, four times the log-likelihood, but for the speed's share and the converter's counts.
    quiet = evidence(replace(bent, level=0.5), PAPER, *told)
    assert quiet == pytest.approx(4.0 * two, rel=0.02)


def test_a_model_is_behind_the_truth_by_half_the_square_of_what_it_misses():
    rig = Rig(dict(PAPER), rate=100.0)
    record, true = rig.observed(np.random.default_rng(0), commands(rig.clock), "")
    omega = rig.run(record["omega_ref"], record["beta_ref"], STEP).omega * rig.size.speed
    n, turns = len(true), 7 / len(true)
    missed = 0.01 * np.sin(2.0 * np.pi * turns * np.arange(n))
    integrated = behind(rig, record, true, omega, 1)  # in other steps than the record
    assert integrated < 0.5
    power = float(rig.noise.power(np.array([turns]))[0])  # of a wave's n / 2 squares, in units of the noise there
    assert behind(rig, record, true + missed, omega, 2) == pytest.approx(2 * 0.5 * (n / 2) * 0.01**2 / power, rel=0.1)


ROW = {"kind": "single", "hidden": ["pitch_backlash"], "verdict": "attributed", "effects": ["pitch_backlash"], "family": {}}
ROW |= {"equal": {}, "evidence": 100.0, "behind": 7.0, "true_error": [0.2, 0.02], "failed": None}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({}, {"hit"}),
        ({"effects": ["pitch_backlash", "rotor_vibration"]}, {"hit"}),  # it is present on every rig
        ({"effects": ["pitch_backlash", "map_terms"]}, {"wrong"}),
        ({"effects": ["map_terms"]}, {"wrong"}),
        ({"effects": ["map_terms"], "family": {"map_terms": ["pitch_backlash"]}}, {"hit"}),
        ({"effects": ["map_terms"], "verdict": "partly"}, set()),
        ({"effects": [], "verdict": "unexplained"}, {"honest"}),
        ({"effects": [], "verdict": "none"}, set()),
        ({"hidden": ["pitch_backlash", "sensor_lag"], "kind": "pair"}, {"passed_over"}),
        ({"hidden": ["pitch_backlash", "sensor_lag"], "kind": "pair", "verdict": "partly"}, {"honest"}),
        ({"hidden": ["pitch_backlash", "sensor_lag"], "kind": "pair", "effects": ["pitch_backlash", "cell"]}, {"wrong"}),
        (
            {"hidden": ["pitch_backlash", "sensor_lag"], "kind": "pair", "effects": ["pitch_backlash", "cell"]}
            | {"equal": {"sensor_lag": ["cell"]}},
            {"hit"},
        ),
        ({"hidden": ["stick_slip"], "kind": "outside"}, {"wrong"}),
        ({"hidden": ["stick_slip"], "kind": "outside", "effects": ["pitch_stop_band"]}, {"passed_over"}),  # a relative
        ({"hidden": [], "kind": "none"}, {"wrong"}),
        ({"true_error": [0.02, 0.021]}, {"hit", "worse"}),
    ],
)
def test_scores_of_outcomes(change, said):
    row = ROW | change
    assert {f.__name__ for f in (scores.hit, scores.wrong, scores.honest, scores.passed_over, scores.worse) if f(row)} == said
