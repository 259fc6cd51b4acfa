"""Start values from step responses: known constants are recovered, and unusable runs are left out."""

import numpy as np
import pytest
from builders import simulator

from identification.steps.response import fit_steps
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.record import Record

STEP = 0.004
AT = 0.5
NOISE = 0.1
VALUES = BASE.values()
MAP = {name: VALUES[name] for name in ("c20", "c11", "c21", "c12", "c30")}


def run(channel, start, end, level, seconds=3.0, noise=0.0, seed=0, model=BASE, shown=True, **values) -> Record:
    """One step at 0.5 s: the model's thrust with noise, and its speed through a tachometer."""
    fine = 8
    rows = round(seconds / STEP)
    time = np.arange(rows * fine) * STEP / fine
    command = np.where(time < AT - 1e-9, start, end)
    held = np.full(len(time), float(level))
    inputs = {"omega_ref": command, "beta_ref": held} if channel == "omega" else {"omega_ref": held, "beta_ref": command}
    thrust, omega, _ = simulator(model).simulate(values, inputs, np.full(len(time) - 1, STEP / fine)).T
    rng = np.random.default_rng(seed)
    columns = {name: column[::fine] for name, column in inputs.items()} | {"time": np.arange(rows) * STEP}
    columns["thrust"] = thrust[::fine] + noise * rng.normal(size=rows)
    if shown:
        columns["omega"] = tachometer(time, omega, rng)[::fine]
    return Record(columns, f"steps.csv, run {seed}")


def tachometer(time, omega, rng) -> np.ndarray:
    """One mark a revolution, a timer of 4 us, 20 us of jitter; the value holds until the next pulse."""
    turned = np.concatenate([[0.0], np.cumsum((omega[1:] + omega[:-1]) / 2 * np.diff(time) / 60.0)]) + rng.uniform()
    pulses = np.interp(np.arange(1, int(turned[-1]) + 1), turned, time) + 20e-6 * rng.normal(size=int(turned[-1]))
    pulses = np.round(pulses / 4e-6) * 4e-6
    values = np.concatenate([[omega[0], omega[0]], 60.0 / np.diff(pulses)])
    return values[np.searchsorted(pulses, time, side="right")]


SPEEDS = [(2000.0, end) for end in (3000.0, 4000.0, 5000.0, 6000.0)] + [
    (6000.0, end) for end in (5000.0, 4000.0, 3000.0, 2000.0)
]
PITCHES = [(-5.0, end) for end in (0.0, 3.0, 6.0, 10.0)] + [(10.0, end) for end in (5.0, 2.0, -1.0, -5.0)]
FAST = {"tau_beta_1": 0.2, "tau_beta_2": 0.08}
"""A pitch actuator that settles within the runs."""


def runs(noise=NOISE, **values) -> list[Record]:
    """Steps of both channels, each at two levels of the other channel."""
    values = FAST | values
    made = []
    for channel, steps, levels in (("omega", SPEEDS, (0.0, 7.0)), ("beta", PITCHES, (4000.0, 6000.0))):
        for level in levels:
            for start, end in steps:
                made.append(run(channel, start, end, level, noise=noise, seed=len(made), **values))
    return made


@pytest.fixture(scope="module")
def noisy():
    """Steps of both channels with noise, fitted."""
    return fit_steps(runs(), VALUES, MAP)


def found(summary, channel, signal="thrust", direction="both"):
    wanted = channel, signal, direction
    return next(a for a in summary.averages if (a.channel, a.signal, a.direction) == wanted)


def test_constants_come_back_exactly_without_noise():
    summary = fit_steps([run("omega", 2000, 6000, 7, shown=False), run("beta", -5, 10, 6000, **FAST)], VALUES, MAP)
    speed, pitch = (r.fits["thrust"] for r in summary.runs)
    for fits, slow, fast in ((speed, 0.172, 0.053), (pitch, 0.2, 0.08)):
        for fit in (fits.plain, fits.delayed):
            assert (fit.slow, fit.fast, fit.delay) == pytest.approx((slow, fast, 0.0), abs=1e-6)
    assert speed.plain.gain == pytest.approx(summary.runs[0].expected)
    expected = {"tau_omega_1": 0.172, "tau_omega_2": 0.053, "tau_beta_1": 0.2, "tau_beta_2": 0.08}
    assert dict(summary.start) == pytest.approx(expected, abs=1e-6)
    assert not summary.outliers


def test_without_a_map_the_lags_are_those_of_the_normalised_thrust():
    straight = {"c12": 0.0}
    record = run("beta", -5, 10, 5000, **FAST, **straight)
    fit = fit_steps([record], VALUES).runs[0].fits["thrust"].plain
    assert (fit.slow, fit.fast) == pytest.approx((0.2, 0.08), abs=1e-6)
    bent = fit_steps([run("omega", 2000, 6000, 7, shown=False)], VALUES).runs[0].fits["thrust"].plain
    assert bent.slow + bent.fast > 1.05 * 0.225  # thrust is proportional to the square of the speed: upwards it is later


def test_standard_deviations_are_those_of_repeats():
    made = [run("omega", 2000, 5000, 7, noise=NOISE, seed=seed) for seed in range(60)]
    fits = [r.fits for r in fit_steps(made, VALUES, MAP).runs]
    # A pulse that comes late makes one revolution long and the next short: such jitter hardly moves a lag, and the deviations
    # from white residuals are larger than what repeats show.
    for signal, least in (("thrust", 0.7), ("omega", 0.2)):
        plain = [f[signal].plain for f in fits]
        pulls = [(p.slow + p.fast - 0.225) / p.std["sum"] for p in plain]
        assert least < np.sqrt(np.mean(np.square(pulls))) < 1.4
    gains = np.array([f["thrust"].plain.gain for f in fits])
    assert gains.std() == pytest.approx(np.mean([f["thrust"].plain.std["gain"] for f in fits]), rel=0.35)


def test_averages_are_near_the_truth_and_slow_comes_first(noisy):
    for channel, slow, fast in (("omega", 0.172, 0.053), ("beta", 0.2, 0.08)):
        for direction, number in (("up", 8), ("down", 8), ("both", 16)):
            average = found(noisy, channel, direction=direction)
            assert average.runs == number
            assert average.slow > average.fast
            error = 4 * average.spread["slow"] / np.sqrt(number)
            assert average.slow == pytest.approx(slow, abs=error)
            assert average.slow + average.fast == pytest.approx(slow + fast, rel=0.03)
        assert not noisy.delayed(channel)


def test_the_speed_lags_are_fitted_through_the_tachometer(noisy):
    average = found(noisy, "omega", "omega")
    assert not average.delayed
    assert (average.slow, average.fast) == pytest.approx((0.172, 0.053), rel=0.02)
    assert (noisy.start["tau_omega_1"], noisy.start["tau_omega_2"]) == (average.slow, average.fast)
    assert "omega" not in next(r for r in noisy.runs if r.channel == "beta").fits


@pytest.fixture(scope="module")
def pitch_runs():
    return [run("beta", *s, 6000.0, noise=NOISE, seed=k, **FAST) for k, s in enumerate(PITCHES)]


def reason(records, odd) -> str:
    """Why `odd` is left out among `records`, which must all be used."""
    summary = fit_steps([*records, odd], VALUES, MAP)
    assert not any(r.reason for r in summary.runs[:-1])
    return summary.runs[-1].reason


@pytest.mark.parametrize(
    ("end", "noise", "lags", "why"),
    [
        (3.0, 1.5, FAST, "noise is "),
        (-4.99, NOISE, FAST, "step too small"),
        (3.0, 0.0, {"tau_beta_1": 1.5, "tau_beta_2": 0.1}, "not settled"),
    ],
)
def test_a_run_that_is_noisy_small_or_short_is_left_out(pitch_runs, end, noise, lags, why):
    assert reason(pitch_runs, run("beta", -5.0, end, 6000, noise=noise, seed=99, **lags)).startswith(why)


def test_a_command_not_reached_is_detected_by_the_thrust(pitch_runs):
    half = run("beta", -5, 2, 6000, noise=NOISE, seed=99, **FAST)
    odd = half.with_columns(beta_ref=np.where(half.time < AT - 1e-9, -5.0, 10.0))
    assert "thrust changes by 5" in reason(pitch_runs, odd)


def test_overshoot_is_measured_and_flagged(pitch_runs):
    record = run("beta", -5, 10, 6000, noise=NOISE, seed=99, **FAST)
    size = 8.0
    time = record.time - AT
    lump = np.where(time > 0, 0.15 * size * (time / 0.6) * np.exp(1.0 - time / 0.6), 0.0)
    summary = fit_steps([*pitch_runs, record.with_columns(thrust=record["thrust"] + lump)], VALUES, MAP)
    assert summary.runs[-1].overshoots
    assert 5.0 < summary.runs[-1].overshoot < 16.0
    assert not any(r.overshoots for r in summary.runs[:-1])
