"""The second emulator of the studies against closed forms, and how the study of its variations counts."""

import numpy as np
import pytest
from builders import two_lags
from scipy.integrate import solve_ivp
from studies.physics import PAPER
from studies.variation import HIDDEN, VariedCase, group
from studies.varied_rig import VariedRig

STEP = 0.004
W, B = 0.8, 0.6
POWER = W**3 * (0.2 + 0.3 * B + 0.5 * B**2)


def run(settings, w, b, seconds=8.0, rng=None):
    """Time (rows,) s since the step and the normalised signals, of a step after one row, from `w[0]`, `b[0]` to the others."""
    rows = round(seconds / STEP)
    commands = (np.r_[np.full(2, float(c[0])), np.full(rows - 2, float(c[-1]))] for c in (w, b))
    rig = VariedRig(PAPER | settings, rate=1.0 / STEP)
    found = rig.signals(*commands, rng)
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


def test_heat_takes_thrust_as_a_lag_of_the_power():
    t, _, _, load, _ = run({"heating_loss": 0.2, "heating_time": 3.0}, (W, W), (B, B))
    *_, cold, _ = run({}, (W, W), (B, B))
    np.testing.assert_allclose(load, cold * (1.0 - 0.2 * POWER * (1.0 - np.exp(-(t - t[0]) / 3.0))), rtol=1e-9)


@pytest.mark.parametrize("ratio", [0.3, 0.7])
def test_the_servo_overshoots_as_a_second_order_system(ratio):
    t, _, b, *_ = run({"servo_ratio": ratio}, (W, W), (0.0, 1.0))
    p = 1.0 / np.sqrt(PAPER["tau_b1"] * PAPER["tau_b2"])
    assert b.max() == pytest.approx(1.0 + np.exp(-np.pi * ratio / np.sqrt(1.0 - ratio**2)), abs=1e-3)
    d, since = p * np.sqrt(1.0 - ratio**2), np.maximum(t, 0.0)
    exact = 1.0 - np.exp(-ratio * p * since) * (np.cos(d * since) + ratio * p / d * np.sin(d * since))
    np.testing.assert_allclose(b, exact, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("pitch", "channel"), [(1.0, "b"), (0.0, "w")])
def test_a_warming_lag_is_the_integral_of_its_rate(pitch, channel):
    """With one lag: share left = exp(-integral of dt / tau(t)), tau(t) = tau (1 + a exp(-t / T))."""
    a, long, tau = 2.0, 1.5, 0.4
    lags = {f"tau_{channel}1": tau, f"tau_{channel}2": 1e-4}
    warming = {"warming_slower": a, "warming_time": long, "warming_pitch": pitch}
    t, w, b, *_ = run(lags | warming, (0.5, 0.9), (0.5, 0.9))
    clock, begin = t - t[0], -t[0]
    rate = long / tau * np.log((np.exp(np.maximum(clock, begin) / long) + a) / (np.exp(begin / long) + a))
    np.testing.assert_allclose(b if pitch else w, 0.9 - 0.4 * np.exp(-rate), rtol=0, atol=1e-3)


def test_gusts_are_of_their_record_and_no_command_drives_them():
    def load(seed):
        return run({"gust": 0.05}, (W, W), (B, B), 80.0, np.random.default_rng(seed))[3]

    *_, calm, _ = run({}, (W, W), (B, B), 80.0)
    blown = (load(0) - calm) / (W * 0.05)
    assert 0.5 < np.abs(blown).max() < 2.0  # two gusts may meet
    assert 0.3 < np.mean(np.abs(blown) < 1e-9) < 0.95
    assert np.array_equal(load(0), load(0))
    assert np.abs(load(0) - load(1)).max() > 0.01


@pytest.mark.parametrize("name", HIDDEN)
def test_a_case_has_the_size_that_is_asked_for(name):
    case = VariedCase("variation", (name,), 6, given=(("size", "paper"),))
    assert 2.0 <= case.times <= 6.0
    assert case.changed(case.x) == pytest.approx(case.times, rel=0.02) or case.x == HIDDEN[name].most
    assert {e for own in case.each.values() for e in own} <= set(case.rig.settings)


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
