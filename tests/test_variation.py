"""The second emulator of the studies against closed forms, and how the study of its variations counts."""

import numpy as np
import pytest
from builders import two_lags
from scipy.integrate import solve_ivp
from studies.physics import PAPER
from studies.variation import group
from studies.varied_rig import VariedRig

STEP = 0.004
W, B = 0.8, 0.6


def run(settings, w, b, seconds=8.0):
    """Time (rows,) s since the step and the normalised signals, of a step after one row, from `w[0]`, `b[0]` to the others."""
    rows = round(seconds / STEP)
    commands = (np.r_[np.full(2, float(c[0])), np.full(rows - 2, float(c[-1]))] for c in (w, b))
    rig = VariedRig(PAPER | settings, rate=1.0 / STEP)
    found = rig.signals(*commands)
    every = slice(None, None, rig.fine)
    return STEP * (np.arange(rows) - 2), *(each[every] for each in (found.omega, found.beta, found.load, found.volt))


def test_without_a_variation_it_is_two_lags_and_the_map():
    t, w, b, load, _ = run({}, (0.5, 0.9), (0.1, 0.8))
    np.testing.assert_allclose(w, 0.5 + 0.4 * two_lags(t, PAPER["tau_w1"], PAPER["tau_w2"]), rtol=0, atol=1e-5)
    np.testing.assert_allclose(b, 0.1 + 0.7 * two_lags(t, PAPER["tau_b1"], PAPER["tau_b2"]), rtol=0, atol=1e-5)
    terms = np.array([w**2, w * b, w**2 * b, w * b**2, w**3])
    np.testing.assert_allclose(load, np.array([0.355, 0.064, 0.8, -0.16, -0.081]) @ terms, rtol=0, atol=1e-12)


def test_a_battery_is_its_network_in_the_rotors_loop():
    now, late, time = 0.03, 0.08, 0.7
    t, w, _, _, volt = run({"battery_now": now, "battery_late": late, "battery_time": time}, (0.5, 0.9), (B, B))
    q = 0.2 + 0.3 * B + 0.5 * B**2
    rest = (np.sqrt(1.0 + 4.0 * (now + late) * q * 0.5**2) - 1.0) / (2.0 * (now + late) * q * 0.5)  # w = 0.5 (1 - r q w^2)

    def slope(_, x):
        y, w, v = x
        current = w**2 * q
        return [(0.9 * (1.0 - now * current - v) - y) / PAPER["tau_w1"], (y - w) / PAPER["tau_w2"], (late * current - v) / time]

    exact = solve_ivp(slope, (0.0, t[-1]), [rest, rest, late * q * rest**2], t_eval=t[2:], rtol=1e-9, atol=1e-9).y
    np.testing.assert_allclose(w[2:], exact[1], rtol=0, atol=5e-4)
    np.testing.assert_allclose(volt[2:], 1.0 - now * q * exact[1] ** 2 - exact[2], rtol=0, atol=5e-4)


@pytest.mark.parametrize("ratio", [0.3, 0.7])
def test_the_servo_overshoots_as_a_second_order_system(ratio):
    t, _, b, *_ = run({"servo_ratio": ratio}, (W, W), (0.0, 1.0))
    p = 1.0 / np.sqrt(PAPER["tau_b1"] * PAPER["tau_b2"])
    assert b.max() == pytest.approx(1.0 + np.exp(-np.pi * ratio / np.sqrt(1.0 - ratio**2)), abs=1e-3)
    d, since = p * np.sqrt(1.0 - ratio**2), np.maximum(t, 0.0)
    exact = 1.0 - np.exp(-ratio * p * since) * (np.cos(d * since) + ratio * p / d * np.sin(d * since))
    np.testing.assert_allclose(b, exact, rtol=0, atol=1e-9)


ROW = {"hidden": ["heating"], "failed": None, "family": {}, "effects": [], "learned": None, "verdict": "none"}


@pytest.mark.parametrize(
    ("change", "counted"),
    [
        ({}, "none"),
        ({"failed": "not done in 900 s"}, "failed"),
        ({"verdict": "unexplained"}, "says so"),
        ({"verdict": "attributed", "effects": ["thrust_gain_drift"]}, "right"),
        ({"verdict": "partly", "effects": ["thrust_gain_drift", "map_terms"]}, "wrong"),
        ({"verdict": "attributed", "effects": ["recirculation"]}, "related"),
        ({"verdict": "family", "effects": ["sensor_gain"], "family": {"sensor_gain": ["thrust_gain_drift"]}}, "right"),
        ({"verdict": "learned", "effects": ["learned"], "learned": ["thrust", "time"]}, "learned"),
        ({"hidden": ["gusts"], "verdict": "partly", "effects": ["inflow_lag"]}, "wrong"),
        ({"hidden": ["servo"], "verdict": "attributed", "effects": ["inflow_lag"]}, "related"),
    ],
)
def test_names_are_counted_as_listed(change, counted):
    assert group(ROW | change) == counted
