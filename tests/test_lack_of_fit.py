"""The tests of lack of fit: their level if nothing is missing, their power, and their part in the verdict."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import bilinear, lfilter
from scipy.stats import chi2, kstest
from scipy.stats import f as f_distribution

from identification.assessment.reading_noise import last_thirds
from identification.diagnose import command_shapes, lack_of_fit
from identification.diagnose.acceptance import gains_in_bands_of, with_flicker
from identification.diagnose.lack_of_fit import Band, spectra
from identification.diagnose.score_test import ScoreTest, scores_covariance
from identification.diagnose.validation import unnamed, verdict
from identification.fit.converter import Converter
from identification.fit.experiment import Experiment
from identification.fit.noise import independent
from identification.roles import Fitted
from vpp_fmu.kernel.plant import plant
from vpp_fmu.record import Record

RNG = np.random.default_rng(20)


def test_pure_error_has_its_level_on_noise_and_sees_what_repeats():
    """1000 draws: p-values of noise are uniform; a sine of half the noise's standard deviation is always detected."""
    from scipy.stats import f

    time, ps, seen = np.arange(600) * 0.05, [], []
    shared = 0.5 * np.sin(2.0 * np.pi * 0.5 * time)
    for _ in range(1000):
        noise = RNG.standard_normal((2, 600))
        for errors, found in ((noise, ps), (noise + shared, seen)):
            between, within = spectra(errors)
            inside = slice(10, 40)
            found.append(f.sf(between[inside].sum() / within[inside].sum(), 60, 60))
    assert kstest(ps, "uniform").pvalue > 1e-3
    assert abs(np.mean(np.array(ps) < 0.05) - 0.05) < 3.0 * np.sqrt(0.05 * 0.95 / 1000)
    assert np.mean(np.array(seen) < 0.05) > 0.95
    between, within = spectra(RNG.standard_normal((3, 1001)))
    assert between.sum() == pytest.approx(1.0, rel=0.2)
    assert within.sum() == pytest.approx(1.0, rel=0.15)


DRAWS = 400


@pytest.mark.parametrize("repeat", [False, True])
@pytest.mark.parametrize(("rho", "parameters"), [(0.0, 0), (0.5, 0), (0.5, 20)])
def test_the_score_test_keeps_its_level_where_the_noise_is_estimated(rho, parameters, repeat):
    """Slow shapes in noise that is not whitened, after a fit of slow sensitivities has removed its part. 1 % of the draws are
    rejected at 1 %, within 3 standard errors, with the noise estimated from another record or from the residual."""
    rng, rows, count = np.random.default_rng(7), 1200, 12
    rejected = 0
    for _ in range(DRAWS):
        slow = np.linalg.qr(np.cumsum(rng.standard_normal((rows, count + parameters)), axis=0))[0].T
        fitted, shapes = slow[:parameters], slow[parameters:]
        noise, other = lfilter([1.0], [1.0, -rho], rng.standard_normal((2, rows + 50)))[:, 50:]
        residual, score = noise - fitted.T @ (fitted @ noise), shapes @ noise
        left, gone = (residual - shapes.T @ score)[None], np.vstack([shapes, fitted])
        covariance, bands = scores_covariance([(shapes, other[None], shapes[:0]) if repeat else (shapes, left, gone)])
        statistic = float(score @ np.linalg.solve(covariance, score))
        if chi2.sf(statistic, count) < 0.01:  # F terms exceed those of a chi-square: p can't be smaller
            rejected += ScoreTest(0.5 * (statistic - count), count, bands).p < 0.01
    assert rejected / DRAWS < 0.01 + 3.0 * np.sqrt(0.01 * 0.99 / DRAWS)


def test_differences_of_repeated_records_have_the_noise_of_their_mean():
    """Three records of a sine and white noise of 0.2 N, whose mean is whitened to 1: two samples of mean square 1, independent
    of each other and of the residual."""
    time = np.arange(4000) * 0.01
    own = {"time": time, "omega_ref": np.zeros(4000), "beta_ref": np.zeros(4000)}
    shared = 3.0 * np.sin(time)
    thrust = shared + 0.2 * np.random.default_rng(5).standard_normal((3, 4000))
    records = [Fitted(f"{k}", Record(own | {"thrust": each}, "")) for k, each in enumerate(thrust)]
    e = Experiment(records, independent(0.2))
    samples = np.vstack([e.differences(), e.thrust_residual(shared)])
    assert samples @ samples.T / 4000 == pytest.approx(np.eye(3), abs=0.06)


@pytest.mark.parametrize(("wave", "share"), [(2, 0.25), (300, 1.0)])
def test_gains_are_down_weighted_in_bands_with_more_noise_than_assumed(wave, share):
    """White noise with four times the power below the twelfth ordinate; a wave is removed in that band or elsewhere."""
    rng, n, found = np.random.default_rng(11), 1200, []
    turns = 2.0 * np.pi * np.arange(n) / n
    for _ in range(60):
        spectrum = np.fft.rfft(rng.standard_normal(n))
        spectrum[:12] *= 2.0
        after = np.fft.irfft(spectrum, n)
        (fall,), level = gains_in_bands_of([after + 8.0 * np.sin(wave * turns), after], np.zeros((0, n)))
        found.append(np.sum(fall / level) / np.sum(fall))
    assert np.median(found) == pytest.approx(share, abs=0.05)


@pytest.mark.parametrize(("corner", "drift", "explains"), [(20.0, 0.0, False), (0.0, 20.0, True)])
def test_flicker_is_no_drift(corner, drift, explains):
    """Noise of power 1 + corner / ordinate, and a ramp of a size in standard errors of white noise. A white likelihood gains
    from a ramp beside flicker in many records; beside flicker of the most likely corner a gain of 5 nats is rare. A ramp beside
    white noise is no flicker: that would be seen at higher frequencies."""
    rng, n, white, beside = np.random.default_rng(6), 1200, [], []
    ramp = np.linspace(-1.0, 1.0, n)[None] / np.linalg.norm(np.linspace(-1.0, 1.0, n))
    nothing = np.zeros((0, n))
    for _ in range(100):
        spectrum = np.fft.rfft(rng.standard_normal(2 * n))  # of twice the length: a record's ends do not meet
        spectrum *= np.sqrt(1.0 + 2.0 * corner / np.maximum(np.arange(n + 1), 1.0))
        before = np.fft.irfft(spectrum, 2 * n)[:n] + drift * ramp[0]
        after = before - ramp[0] * (ramp[0] @ before)
        white.append(0.5 * (before @ before - after @ after))
        beside.append(with_flicker(after, ramp) - with_flicker(before, nothing))
    assert np.mean(np.array(white) > 5.0) > 0.3
    found = np.mean(np.array(beside) > 5.0)
    assert found > 0.95 if explains else found < 0.05


@pytest.mark.parametrize("statistic", [8.0, 20.0, 45.0])
def test_the_p_value_accounts_for_bands_with_few_estimates_of_the_noise(statistic):
    """Against half a million draws of the sum over bands of chi^2 over the estimated power of the noise."""
    bands, rng = ((5.0, 4.0), (2.0, 20.0), (1.0, 200.0)), np.random.default_rng(3)
    drawn = sum(rng.chisquare(own, 500_000) * known / rng.chisquare(known, 500_000) for own, known in bands)
    share = float(np.mean(drawn >= statistic))
    assert ScoreTest(0.5 * (statistic - 8), 8, bands).p == pytest.approx(share, rel=0.05)


def test_the_score_test_detects_a_residual_along_a_shape():
    """A shape with an amplitude of twenty times the noise's in its direction is always detected."""
    rng, rows, count = np.random.default_rng(8), 1200, 12
    shapes = np.linalg.qr(np.cumsum(rng.standard_normal((rows, count)), axis=0))[0].T
    residual = rng.standard_normal(rows) + 20.0 * shapes[3]
    score = shapes @ residual
    covariance, bands = scores_covariance([(shapes, (residual - shapes.T @ score)[None], shapes)])
    assert ScoreTest(0.5 * (float(score @ np.linalg.solve(covariance, score)) - count), count, bands).p < 1e-6


def set_checks(monkeypatch, **results):
    """The checks of lack of fit return these results; the others find nothing."""
    nothing = {
        "pure_error": (),
        "score_test": ScoreTest(0.0, 10, ((10.0, 1000.0),)),
        "_score_size": 0.0,
        "structured_speed_share": 0.0,
        "transient_power_share": (0.0, 0.0),
    }
    for name, result in (nothing | results).items():
        monkeypatch.setattr(lack_of_fit, name, result if callable(result) else lambda *_, result=result: result)


@pytest.mark.parametrize(
    ("effects", "p", "certain"), [((), 0.0005, True), ((), 0.002, False), (("one",), 0.002, True), (("one",), 0.02, False)]
)
def test_a_model_that_claims_to_explain_all_must_pass_a_stricter_test(monkeypatch, effects, p, certain):
    """Five bands and a score test: the smallest of six p-values is below q as often as p = 1 - (1 - q)^6."""
    q = 1.0 - (1.0 - p) ** (1.0 / 6.0)
    set_checks(monkeypatch, pure_error=tuple(Band(0.0, 1.0, 0.01, 0.001, each) for each in (q, *[0.5] * 4)))
    found = lack_of_fit.lack_of_fit(SimpleNamespace(effects=effects), least=0.1)
    assert found.p == pytest.approx(p)
    assert (found.certain, found.significant) == (certain, certain)
    assert not lack_of_fit.lack_of_fit(SimpleNamespace(effects=effects), least=0.3).significant  # it is 0.22 N


def test_what_the_forms_of_effects_leave_is_no_lack_of_fit(monkeypatch):
    """A right form may be 5 % off in amplitude, so 1/400 of the power, and of the nats, that it explains remains."""
    key, without, beside = (0.0, 1.0, 2), np.array([500.0, 20.0, 500.0, 20.0, 20.0]), np.array([21.2, 20.0, 21.2, 20.0, 20.0])
    monkeypatch.setattr(lack_of_fit, "_powers", lambda fit: {key: (beside if fit.effects else without).copy()})
    base, fit = SimpleNamespace(effects=(), score=None), SimpleNamespace(effects=("one",))
    (band,) = lack_of_fit.pure_error(fit, base)
    assert band.power == pytest.approx((21.2 - (500.0 - 21.2) / 400.0 - 20.0) / 2.0)
    assert band.p == pytest.approx(f_distribution.sf((21.2 - (500.0 - 21.2) / 400.0) / 20.0, 20.0, 20.0))
    set_checks(monkeypatch, score_test=ScoreTest(18.0, 45, ()))
    monkeypatch.setattr(ScoreTest, "p", 0.5)
    fit.score = SimpleNamespace(gain_over=lambda other: {"thrust": 4000.0})
    assert lack_of_fit.lack_of_fit(fit, 0.1, 0.0, base).score.gain == pytest.approx(18.0 - 10.0)


@pytest.mark.parametrize(("share", "size", "lacks"), [(0.4, 0.3, False), (0.6, 0.3, True), (0.6, 0.05, False)])
def test_a_wrong_speed_is_a_lack_of_fit_though_the_thrust_is_right(monkeypatch, share, size, lacks):
    """If more than half of the speed's residual is structured, and it is worth more than 0.1 N."""
    set_checks(monkeypatch, structured_speed_share=share, thrust_equivalent=(size, 7.0))
    found = lack_of_fit.lack_of_fit(SimpleNamespace(effects=()), least=0.1, least_speed=5.0)
    assert (found.certain, found.speed_lack_of_fit, found.significant) == (False, lacks, lacks)
    assert found.only_speed is lacks
    assert not lack_of_fit.lack_of_fit(SimpleNamespace(effects=()), least=0.1, least_speed=9.0).significant  # it is 7 rpm
    assert found.summary()["speed"]["share"] == share


TIME = np.arange(0.0, 60.0, 0.01)


def fit_with_transients(monkeypatch, std=1.0, verified=False, count=0.0, slow=0.0):
    """A fit whose residual is noise of 1 and a sine of 3 in the first half of each hold of 4 s: its power is 4.5 / 2 in all and
    none at rest. Thrust is read by a converter of `count` N; the sensor of the speed has the uncertainty `std`. `slow`: size of
    noise that is constant for a hold, in the thrust."""
    record = {"time": TIME, "omega_ref": np.floor(TIME / 4.0), "beta_ref": np.zeros(len(TIME)), "thrust": np.zeros(len(TIME))}
    # The noise of means over 0.05 s, which is that below 10 Hz, is 1 too.
    noise = [RNG.standard_normal(len(TIME)), RNG.standard_normal(len(TIME) // 5).repeat(5)]
    noise[1] = noise[1] + slow * (-1.0) ** np.floor(TIME / 4.0)
    speed, thrust = (np.where(TIME % 4.0 < 2.0, 3.0 * np.sin(2.0 * np.pi * TIME), 0.0) + each for each in noise)
    sensor = SimpleNamespace(rows=np.arange(len(TIME)), measured=np.zeros(len(TIME)), std=std, shows=lambda omega: omega)
    record = Record(record, "")
    e = SimpleNamespace(
        record=record,
        records=[SimpleNamespace(record=record)],
        tachometers=[sensor],
        converter=Converter(count, 0.0, 1.0),
        noise=SimpleNamespace(verified=verified),
        channels=("thrust", "omega"),
    )
    values = {f"tau_{u}_{k}": 0.2 for u in ("omega", "beta") for k in (1, 2)}
    monkeypatch.setattr(lack_of_fit, "predicted_rows", lambda fit, e: np.column_stack([thrust, speed, speed]))
    return SimpleNamespace(problem=SimpleNamespace(experiments=[e]), values=values, effects=("one",))


POWER = 0.5 * 0.5 * 3.0**2


@pytest.mark.parametrize(
    ("std", "verified", "effects", "asked"),
    [(1.0, False, ("one",), True), (2.0, False, ("one",), False), (1.0, True, ("one",), False), (1.0, False, (), False)],
)
def test_a_speed_residual_that_is_absent_during_holds_is_not_noise(monkeypatch, std, verified, effects, asked):
    """Not checked if the sensor's uncertainty explains it, if a repeat gives the noise, or if the model has no effects."""
    fit = fit_with_transients(monkeypatch, std, verified)
    fit.effects = effects
    monkeypatch.setattr(lack_of_fit, "channel_rows", lambda fit, channel: [slice(0, len(TIME))])
    monkeypatch.setattr(lack_of_fit, "_followed_share", lambda fit, parts: 0.1)
    assert lack_of_fit.structured_speed_share(fit) == pytest.approx(POWER / (1.0 + POWER) if asked else 0.1, abs=0.03)


@pytest.mark.parametrize(("count", "verified", "beyond"), [(0.0, False, POWER), (8.0, False, 0.0), (0.0, True, 0.0)])
def test_a_thrust_residual_that_is_absent_during_holds_is_not_noise(monkeypatch, count, verified, beyond):
    """Beyond the least noise of rounding to counts: 8 N / 12^0.5 is more than all of it."""
    share, size = lack_of_fit.transient_power_share(fit_with_transients(monkeypatch, verified=verified, count=count), "thrust")
    assert share == pytest.approx(beyond / (1.0 + beyond), abs=0.05)
    assert size == pytest.approx(np.sqrt(beyond), abs=0.1)


def test_noise_slower_than_a_hold_is_there_at_rest_too(monkeypatch):
    """Its power of 9 is part of the whole, and of the reference."""
    share, size = lack_of_fit.transient_power_share(fit_with_transients(monkeypatch, slow=3.0), "thrust")
    assert share == pytest.approx(POWER / (1.0 + 9.0 + POWER), abs=0.05)
    assert size == pytest.approx(np.sqrt(POWER), abs=0.2)


@pytest.mark.parametrize(
    ("claims", "share", "size", "lacks"),
    [(True, 0.6, 0.3, True), (False, 0.6, 0.3, False), (True, 0.4, 0.3, False), (True, 0.6, 0.05, False)],
)
def test_a_transient_residual_is_a_lack_of_fit_beside_an_accepted_effect(monkeypatch, claims, share, size, lacks):
    """If it is more than half of the residual, and more than 0.1 N."""
    moving = lambda fit, channel: (share, size) if channel == "thrust" else (0.0, 0.0)  # noqa: E731
    set_checks(monkeypatch, score_test=ScoreTest(0.0, 0, ()), transient_power_share=moving)
    found = lack_of_fit.lack_of_fit(SimpleNamespace(effects=("one",) if claims else ()), least=0.1)
    assert (found.transient_lack_of_fit, found.significant) == (lacks, lacks)


@pytest.mark.parametrize(("was", "word"), [(0.5, "partly"), (0.4, "unexplained")])
def test_a_partial_explanation_must_remove_half_of_the_transient_power(was, word):
    """A residual of 0.3 N remains: of 0.5 N, 64 % of the power is removed; of 0.4 N, 44 %."""
    score, fits = ScoreTest(0.0, 0, ()), [SimpleNamespace(effects=e, deviance=d) for e, d in (((), 100.0), (("one",), 0.0))]
    lacks = [lack_of_fit.LackOfFit((), score, 0.5, 0.0, 0.1, bool(m - was), moving=0.6, transient_size=m) for m in (was, 0.3)]
    assert verdict(*fits, *lacks, {"one": []}) == word


def test_steady_parts_are_the_last_thirds_of_long_holds():
    """Commands move at 3 and at 4 s of 10."""
    time = np.arange(0.0, 10.05, 0.1)
    moves = {"omega_ref": np.where(time < 2.95, 0.0, 1.0), "beta_ref": np.where(time < 3.95, 0.0, 1.0)}
    found = last_thirds(Record({"time": time, **moves}, ""), 2.0)
    assert found == [pytest.approx((2.0, 3.0)), pytest.approx((8.0, 10.0))]


def test_the_shapes_include_an_oscillation_of_the_speed_loop():
    """The speed responds with an oscillation of 1.2 Hz and a damping of 0.2 instead of lags of 0.1 and 0.2 s: the shapes
    explain the difference to a few per cent."""
    time = np.arange(0.0, 40.0, 0.01)
    command = 4000.0 + 500.0 * np.random.default_rng(4).integers(0, 4, 20).repeat(200)
    swing = bilinear([1.0], [1.0 / (2.0 * np.pi * 1.2) ** 2, 0.4 / (2.0 * np.pi * 1.2), 1.0], 100.0)
    lags = bilinear([1.0], [0.02, 0.3, 1.0], 100.0)
    true, speed = (4000.0 + lfilter(*each, command - 4000.0) for each in (swing, lags))
    values = plant(()).values({"tau_omega_1": 0.2, "tau_omega_2": 0.1})
    record = Record({"time": time, "omega_ref": command, "beta_ref": np.full(len(time), 3.0)}, "")
    outputs = np.column_stack([1e-6 * speed**2, speed, record["beta_ref"]])
    columns = np.stack(list(command_shapes.speed_shapes(values, record, outputs)), axis=1)
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, size > 0.0] / size[size > 0.0]
    shares, *_ = np.linalg.lstsq(columns, true - speed, rcond=1e-6)
    assert np.var(true - speed - columns @ shares) < 0.05 * np.var(true - speed)


@pytest.mark.parametrize(("found", "turns", "word"), [(0, 0, "none"), (1, 0, "unexplained"), (0, 1, "unexplained")])
def test_the_verdict_after_a_refutation_is_that_of_the_base_model(found, turns, word):
    assert unnamed(SimpleNamespace(significant=bool(found), turns=bool(turns))) == word
