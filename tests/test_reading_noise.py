"""The noise of one thrust reading, from records whose noise is known."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from studies.synthetic import NOISE, STEP, TRUTH, commands

from identification.assessment.prediction import Prediction, predict
from identification.assessment.reading_noise import HOLDS, POINTS, REPEATS, reading_noise
from identification.demo import example_folder
from identification.identify import identify
from vpp_fmu.campaign import Campaign, StaticMap, read_campaign
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.record import Record

SEEDS = range(5)


def coloured(noise: np.ndarray, memory: float) -> np.ndarray:
    """First-order autoregressive noise of variance 1 from white noise of variance 1; `memory` s."""
    rho = np.exp(-STEP / memory)
    return lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], noise, zi=[rho * noise[0]])[0]


def flicker(noise: np.ndarray) -> np.ndarray:
    """1/f noise over the record's length, of mean square 1 in it."""
    frequency = np.fft.rfftfreq(len(noise))
    frequency[0] = np.inf
    found = np.fft.irfft(np.fft.rfft(noise) / np.sqrt(frequency), len(noise))
    return found / found.std()


def shown(rng: np.random.Generator, noise, count: float = 0.0, record: Record | None = None) -> tuple[Prediction, float]:
    """(a record with the true model's prediction, the rms error of its readings), read by a converter of `count` N."""
    record = record or commands(rng)
    true = predict(BASE, TRUTH, record)
    reading = true.thrust + NOISE * noise(rng.standard_normal(len(record)))
    reading = count * np.round(reading / count) if count else reading
    error = float(np.sqrt(np.mean((reading - true.thrust) ** 2)))
    return replace(true, record=record.with_columns(thrust=reading)), error


def white(noise: np.ndarray) -> np.ndarray:
    """White noise, unchanged."""
    return noise


@pytest.mark.parametrize("seed", SEEDS)
def test_white_noise_is_known_within_a_tenth_without_a_repeat(seed):
    rng = np.random.default_rng(seed)
    one, error = shown(rng, white)
    found = reading_noise([one], None, TRUTH)
    assert found.source == HOLDS
    assert found.std == pytest.approx(error, rel=0.1)
    assert found.low < error < found.high < 1.2 * error


@pytest.mark.parametrize(
    ("noise", "count"),
    [(lambda n: coloured(n, 0.1), 0.0), (white, NOISE), (white, 3.0 * NOISE), (flicker, 0.0)],
    ids=["AR(1) of 0.1 s", "a count of noise", "three counts of noise", "1/f"],
)
def test_the_range_holds_the_error_of_other_noise_without_a_repeat(noise, count):
    held = []
    for seed in range(40):
        one, error = shown(np.random.default_rng(seed), noise, count)
        found = reading_noise([one], None, TRUTH)
        assert found.source == HOLDS
        held.append(found.low < error < found.high)
    # Fewer than 34 of 40 have a probability of 0.1 % where 95 % of the ranges hold it.
    assert sum(held) >= 34


def test_repeated_records_include_slow_noise_that_steady_holds_miss():
    rng = np.random.default_rng(1)
    first, error = shown(rng, flicker)
    second, other = shown(rng, flicker, record=first.record)
    found = reading_noise([first, second], None, TRUTH)
    assert found.source == REPEATS
    assert found.std == pytest.approx(np.hypot(error, other) / np.sqrt(2.0), rel=0.05)
    assert reading_noise([first], None, TRUTH).std < error


def test_the_noise_from_steady_points_is_weighted_by_their_samples():
    std, samples = np.array([0.1, 0.1, 0.2]), np.array([100.0, 100.0, 200.0])
    points = StaticMap(*(np.arange(3.0),) * 4, std, samples, "static.csv")
    found = reading_noise([], points, TRUTH)
    assert found.source == POINTS
    assert found.std == pytest.approx(np.sqrt((0.01 + 0.01 + 2 * 0.04) / 4))
    assert found.low < found.std < found.high
    assert reading_noise([], replace(points, thrust_std=np.zeros(3)), TRUTH) is None


def alone(**changes) -> Campaign:
    """The campaign of the project without its repeat."""
    return replace(read_campaign(example_folder()), repeat=None, **changes)


TRUE = 0.128
"""Noise [N] of the project's campaign, from its repeat."""


@pytest.mark.parametrize("changes", [{}, {"static": None}], ids=["with steady points", "records alone"])
def test_an_effect_outside_the_model_is_not_taken_for_noise(changes):
    found = identify(alone(**changes), starts=1)
    # The model lacks a dead band of 1.7 deg.
    assert found.predictions["open_loop"].rmse_thrust > 1.5 * TRUE
    assert found.noise.std == pytest.approx(TRUE, rel=0.1)
    assert found.noise.low < TRUE < found.noise.high < found.predictions["open_loop"].rmse_thrust
    said = json.loads(json.dumps(found.summary(), allow_nan=False))
    assert said["noise_floor_thrust"] == found.noise.std
    assert said["noise_floor_thrust_range"] == [found.noise.low, found.noise.high]
    assert said["noise_floor_thrust_from"] == (HOLDS if changes else POINTS)


def test_the_noise_is_estimated_from_steps_alone():
    found = identify(alone(static=None, open_loop=None, validation=None))
    assert found.noise.source == HOLDS
    assert found.noise.std == pytest.approx(TRUE, rel=0.1)
