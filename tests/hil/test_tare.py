"""The tare: its statistics by closed form, and each of its gates."""

import numpy as np
import pytest
from scipy.signal import lfilter

from hil.safety.tare import TareGate, TareRefused, tare

SCALE = 0.004  # N per count
GATE = TareGate(noise_max=0.3, drift_max=0.05, offset_max=5.0, samples_min=200)


def readings(noise=20.0, n=500, zero=1200.0, seed=1):
    """White readings [counts]."""
    return zero + noise * np.random.default_rng(seed).standard_normal(n)


def test_the_standard_error_includes_coloured_noise():
    """First-order noise of correlation a: the mean's variance is (1 + a)/(1 - a) times that of white noise."""
    a = 0.8
    white = np.random.default_rng(0).standard_normal((300, 2100))
    coloured = lfilter([(1 - a * a) ** 0.5], [1.0, -a], white)[:, 100:]
    found = [tare(1200.0 + 5.0 * row, SCALE, 1200.0, GATE) for row in coloured]
    zeros, errors = np.array([(t.zero, t.error) for t in found]).T
    expected = 5.0 * ((1 + a) / (1 - a) / 2000) ** 0.5
    assert zeros.std() == pytest.approx(expected, rel=0.1)
    assert np.sqrt((errors**2).mean()) == pytest.approx(expected, rel=0.1)


RAMP = np.linspace(-0.5, 0.5, 500)


@pytest.mark.parametrize(
    ("counts", "said"),
    [
        (readings(n=199), "found 199, expected 200 or more"),
        (readings(noise=100.0), r"scatter: found 0\.3\d* N, expected at most 0.3 N"),
        (readings() + 100.0 * RAMP, r"drift: found 0\.2\d* N .* expected at most 0.05 N"),
        (readings(zero=1200.0 + 5.1 / SCALE), r"5\.1\d* N from the calibration's, expected at most 5 N"),
        (np.full(500, 1200.0), "frozen"),
        (np.append(readings(), np.nan), "expected finite numbers"),
    ],
    ids=["few", "noisy", "drifting", "far off", "frozen", "nan"],
)
def test_a_bad_zero_is_refused(counts, said):
    with pytest.raises(TareRefused, match=said):
        tare(counts, SCALE, 1200.0, GATE)
    with pytest.raises(TareRefused, match=said):
        tare(2400.0 - counts, -SCALE, 1200.0, GATE)  # a cell wired the other way round


@pytest.mark.parametrize(("memory", "slow"), [(0.01, 0.0), (0.13, 0.05), (0.3, 0.05)])
def test_a_still_cell_is_hardly_ever_refused(memory, slow):
    """White noise and an amplifier's slow noise [N], of correlation time 0.13 or 0.3 s: two seconds, a thousand times."""
    dice, a = np.random.default_rng(9), np.exp(-0.004 / memory)
    white = 30.0 * dice.standard_normal((1000, 500))
    drive = slow / SCALE * np.sqrt(1.0 - a * a) * dice.standard_normal((1000, 500))
    counts, refused = 1200.0 + white + lfilter([1.0], [1.0, -a], drive, axis=1), 0
    for row in counts:
        try:
            tare(row, SCALE, 1200.0, GATE)
        except TareRefused:
            refused += 1
    assert refused <= 2
