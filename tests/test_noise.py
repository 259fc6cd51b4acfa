"""The noise of a record: filters against known processes, block means, and the noise that a fit removes."""

import os
import shutil

import numpy as np
import pytest
from scipy.fft import dct
from scipy.signal import lfilter

from identification.fit import ar_filter, noise
from identification.fit.noise import Blocks, colour_of

RNG = np.random.default_rng(20)


def test_a_filter_recovers_its_autoregression():
    """An autoregression of two lags: its coefficients are found; the residual is white with the innovations' power."""
    driving = 0.3 * RNG.standard_normal(40000)
    noise = np.zeros(40000)
    for k in range(2, 40000):
        noise[k] = 0.9 * noise[k - 1] - 0.4 * noise[k - 2] + driving[k]
    colour = colour_of([noise])
    np.testing.assert_allclose(colour.weights[:3], [1.0, -0.9, 0.4], atol=0.03)
    assert colour.innovation == pytest.approx(0.3, rel=0.02)
    left = colour.whiten(noise)
    assert np.std(left) == pytest.approx(1.0, rel=0.02)
    assert abs(np.corrcoef(left[1:], left[:-1])[0, 1]) < 0.02
    np.testing.assert_allclose(left, np.convolve(noise, colour.weights, "valid") / colour.innovation, atol=1e-9)


def risen(rng: np.random.Generator, rows: int, corner: float, power: int) -> np.ndarray:
    """(rows,) white noise plus noise that increases below a corner [cycles a row], cut out of twice the length."""
    frequency = np.fft.rfftfreq(2 * rows)
    frequency[0] = np.inf
    slow = np.fft.rfft(rng.standard_normal(2 * rows)) * (corner / frequency) ** (0.5 * power)
    return rng.standard_normal(rows) + np.fft.irfft(slow, 2 * rows)[:rows]


@pytest.mark.parametrize(("corner", "power"), [(0.02, 1), (0.1, 1), (0.02, 2)])
def test_noise_that_increases_at_low_frequencies_is_whitened(corner, power):
    """Flicker noise and a random walk: the mean power of the ten lowest ordinates of another draw, 1 for white noise, over 40
    draws. At the lowest ordinate it was 1 + (corner / frequency)^power, 81 to 6400; at most a tenth remains for flicker noise,
    a hundredth for a random walk."""
    rng, ordinates = np.random.default_rng(13), []
    for _ in range(40):
        colour, other = colour_of([risen(rng, 2000, corner, power)]), risen(rng, 2000, corner, power)
        ordinates.append(dct(colour.whiten(other - other.mean()), norm="ortho")[1:11] ** 2)
    assert 0.6 < np.mean(ordinates) < 2.5
    assert np.mean(ordinates, axis=0)[0] < 0.1**power * (1.0 + (corner * 2.0 * 2000.0) ** power)


def test_block_means_leave_empty_cells_out():
    values = np.arange(12.0)
    values[[4, 6, 7, 8]] = np.nan
    at = Blocks(np.array([0, 3, 6, 9, 12]), np.zeros(4))
    np.testing.assert_array_equal(at.mean(values), [1.0, 4.0, np.nan, 10.0])


@pytest.mark.parametrize("phi", [0.5, 0.99999])
def test_products_of_restored_columns_are_those_of_brute_force(phi):
    """Products of restored columns with their later rows, over rows that have a full past. A filter near a random walk leaves
    the level almost undetermined; its products at the ends would be taken for innovations."""
    columns = np.column_stack([np.full(300, 50.0 / (1.0 - phi)), np.cumsum(np.random.default_rng(2).standard_normal(300))])
    found = noise._with_later(columns, 9)
    brute = [[sum(columns[t - i] @ columns[t - j] for t in range(9, 300)) for j in range(10)] for i in range(10)]
    np.testing.assert_allclose(found, brute, rtol=1e-9)
    innovations = found[0, 0] - 2.0 * phi * found[0, 1] + phi**2 * found[1, 1]
    direct = float(np.sum((columns[9:] - phi * columns[8:-1]) ** 2))
    assert innovations == pytest.approx(direct, abs=1e-9 * found[0, 0])


@pytest.mark.parametrize("rho", [0.0, 0.6])
def test_a_filter_corrects_for_the_power_that_a_fit_removed(rho):
    """600 rows of an autoregression without their part in 30 slow directions. The mean of 60 draws recovers the power at rest,
    1 / (1 - rho)^2, and the innovation, 1; the residual alone has lost most of that power."""
    rng, rows = np.random.default_rng(9), 600
    slow = np.linalg.qr(np.cos(np.pi * np.arange(30) * (np.arange(rows)[:, None] + 0.5) / rows))[0]
    noises = [lfilter([1.0], [1.0, -rho], rng.standard_normal(rows + 50))[50:] for _ in range(60)]
    left = [noise - slow @ (slow.T @ noise) for noise in noises]
    back, bare = [colour_of([part], slow) for part in left], [colour_of([part]) for part in left]
    at_rest, lost = (np.mean([np.log(c.innovation**2 / c.weights.sum() ** 2) for c in each]) for each in (back, bare))
    assert at_rest == pytest.approx(np.log(1.0 / (1.0 - rho) ** 2), abs=0.15)
    assert lost < at_rest - 0.3
    assert np.mean([c.innovation for c in back]) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("shape", [(400,), (400, 3), (2000, 1)])
@pytest.mark.parametrize("spans", [(), ((1, 1), (2, 2)), ((1, 1), (2, 5), (6, 96))])
def test_compiled_and_interpreted_filters_give_the_same_bits_and_those_of_the_sums_as_they_are_written(shape, spans):
    """400 numbers are fewer than one part of the compiled loop, 1200 and 2000 are several."""
    values, factors = np.random.default_rng(5).standard_normal(shape), [0.7, -0.2, 0.01][: len(spans)]
    found = ar_filter.ar_residuals(values, spans, factors, 0.3)
    order = max((last for _, last in spans), default=0)
    np.testing.assert_array_equal(found, ar_filter.by_numpy(values, order, spans, factors, 0.3))
    assert ar_filter._compiled() is not None or not shutil.which(
        os.environ.get("CC", "cc")
    )  # else numpy was compared with itself
    brute = [
        values[t] / 0.3
        - sum(f * values[t - last : t - first + 1].sum(axis=0) for (first, last), f in zip(spans, factors, strict=True))
        for t in range(order, len(values))
    ]
    np.testing.assert_allclose(found, brute, atol=1e-9)
