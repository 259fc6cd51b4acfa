"""A vibration at the rotor's speed: detected at any phase, with its size, and nothing else is taken for it."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from identification.diagnose.lack_of_fit import rotor_order_test
from vpp_fmu.record import Record

STEP, SECONDS = 0.004, 30.0
TIME = np.arange(0.0, SECONDS, STEP)
SPEED = 3000.0 + 1200.0 * np.sin(2.0 * np.pi * TIME / 11.0)
"""rpm: 30 to 70 turns a second, which includes the mains' 50 Hz."""


def fit_of(readings, speed=SPEED):
    """A model that predicts this speed and no thrust, with records of the readings."""
    commands = {"omega_ref": speed, "beta_ref": np.zeros(len(TIME))}
    records = [SimpleNamespace(record=Record({"time": TIME, **commands, "thrust": r}, "made")) for r in readings]
    experiment = SimpleNamespace(records=records, converter=SimpleNamespace(reads=lambda thrust: thrust))
    outputs = np.column_stack([np.zeros(len(TIME)), speed, np.zeros(len(TIME))])
    return SimpleNamespace(problem=SimpleNamespace(experiments=[experiment], outputs=lambda values: [outputs]), values={})


def noise(rng, rho=0.0):
    """Noise of 0.1 N with the autocorrelation rho."""
    return 0.1 * np.sqrt(1.0 - rho**2) * lfilter([1.0], [1.0, -rho], rng.standard_normal(len(TIME)))


def line(phase, speed=SPEED, amplitude=0.05):
    return amplitude * np.sin(2.0 * np.pi * np.cumsum(speed / 60.0) * STEP + phase)


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_a_vibration_of_any_phase_is_found_with_its_size(rho):
    rng = np.random.default_rng(1)
    found = rotor_order_test(fit_of([line(phase) + noise(rng, rho) for phase in (0.3, 2.4)]))
    assert found.p < 1e-6
    assert found.size == pytest.approx(0.05 / np.sqrt(2.0), rel=0.1)


def test_mains_hum_is_not_taken_for_a_vibration():
    hum = 0.1 * np.sin(2.0 * np.pi * 50.0 * TIME)
    found = rotor_order_test(fit_of([hum + noise(np.random.default_rng(3))]))
    assert found.p > 0.001


def test_at_constant_speed_a_vibration_is_not_distinguished_from_hum():
    steady = np.full(len(TIME), 3000.0)
    assert rotor_order_test(fit_of([line(0.0, steady) + noise(np.random.default_rng(4))], steady)).p == 1.0


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_noise_alone_is_rejected_at_the_level(rho):
    """At 5 % in 5 % of 300 draws, within 3 standard errors."""
    rng = np.random.default_rng(5)
    p = np.array([rotor_order_test(fit_of([noise(rng, rho)])).p for _ in range(300)])
    assert np.mean(p < 0.05) == pytest.approx(0.05, abs=3.0 * np.sqrt(0.05 * 0.95 / len(p)))
