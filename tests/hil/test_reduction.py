"""The paper's reductions against the full model: its poles, its settled slopes, and small steps of it."""

import numpy as np
import pytest
from builders import simulator
from scipy.signal import StateSpace, lsim

from hil.physics.reduction import poles, reduced, state_space, two_lags, wiener
from hil.physics.rig_model import FULL_RIG
from vpp_fmu.kernel.plant import BASE

RPM, DEG = np.pi / 30.0, np.pi / 180.0
POINTS = [(2000.0, -5.0), (4000.0, 2.5), (6000.0, 10.0), (6000.0, -5.0), (3000.0, 8.0)]
each_point = pytest.mark.parametrize(("omega", "beta"), POINTS)


@each_point
def test_four_states_have_the_four_slow_poles_of_the_full_model(omega, beta):
    of_paper = np.linalg.eigvals(state_space(reduced(omega, beta))[0])
    full = poles(omega, beta)
    slow, fast = full[full.real > -50.0], full[full.real < -50.0]
    assert len(slow) == 4
    np.testing.assert_allclose(np.sort_complex(slow), np.sort_complex(of_paper), rtol=0.012)
    assert len(fast) == 3  # inflow, current of the motor, current of the actuator
    np.testing.assert_allclose(sorted(fast.real)[:2], [-18.5 / 2e-3, -0.07 / 2.5e-5], rtol=0.01)


def small_steps(omega, beta, rpm, deg, rows=500, dt=0.004):
    """(time, moves of speed [rad/s] and pitch [rad]) of the full model after small steps of both commands."""
    inputs = {"omega_ref": np.r_[omega, np.full(rows, omega + rpm)], "beta_ref": np.r_[beta, np.full(rows, beta + deg)]}
    y = simulator(FULL_RIG).simulate({}, inputs, np.r_[1e-9, np.full(rows - 1, dt)])[1:]
    return np.arange(rows) * dt, (y[:, 1] - omega) * RPM, (y[:, 2] - beta) * DEG


@each_point
@pytest.mark.parametrize(("rpm", "deg"), [(10.0, 0.0), (0.0, 0.05), (-10.0, 0.05)])
def test_small_steps_of_the_full_model_are_the_linear_system(omega, beta, rpm, deg):
    a, b = state_space(reduced(omega, beta))
    time, speed, pitch = small_steps(omega, beta, rpm, deg)
    held = np.column_stack([np.full(500, rpm * RPM), np.full(500, deg * DEG), np.zeros(500)])
    # The rig's LAC does not use the command's rate: that input is 0, and the damping stays in A.
    linear = lsim(StateSpace(a, b, np.eye(4)[[0, 2]], np.zeros((2, 3))), held, time)[1]
    # The effect of pitch on speed leads by the inflow's lag, 16 ms at 2000 rpm, which the reduction neglects.
    size = 0.015 * abs(rpm) * RPM + 0.035 * abs(deg * DEG * reduced(omega, beta).k_beta)
    np.testing.assert_allclose(speed, linear[:, 0], rtol=0, atol=size)
    np.testing.assert_allclose(pitch, linear[:, 1], rtol=0, atol=0.006 * abs(deg) * DEG + 1e-9)


@each_point
def test_the_pitch_channel_is_two_lags(omega, beta):
    slow, fast = (tau.real for tau in two_lags(reduced(omega, beta))["beta"])
    r = reduced(omega, beta)
    assert slow * fast == pytest.approx(1.0 / (r.b_beta * r.k_p_beta))
    assert slow + fast == pytest.approx((r.a_beta + r.b_beta * r.k_d_beta) / (r.b_beta * r.k_p_beta))
    time, _, pitch = small_steps(omega, beta, 0.0, 0.05)
    lags = 1.0 - (slow * np.exp(-time / slow) - fast * np.exp(-time / fast)) / (slow - fast)
    np.testing.assert_allclose(pitch / (0.05 * DEG), lags, rtol=0, atol=0.006)


def test_the_wiener_model_is_the_full_models_for_small_moves():
    """The remaining errors are that of the map and, in the dynamics, the neglected zero and coupling."""
    rows, rng = 2000, np.random.default_rng(2)
    omega = np.repeat(4000.0 + rng.uniform(-300.0, 300.0, 10), 200)
    beta = np.repeat(2.5 + rng.uniform(-1.0, 1.0, 20), 100)
    inputs, steps = {"omega_ref": omega, "beta_ref": beta}, np.full(rows - 1, 0.004)
    full, model = simulator(FULL_RIG).simulate({}, inputs, steps), simulator(BASE).simulate(wiener(4000.0, 2.5), inputs, steps)
    error = model - full
    assert np.ptp(full[:, 0]) > 1.0
    assert np.sqrt(np.mean((error[:, 0] - error[:, 0].mean()) ** 2)) < 0.05
    assert np.sqrt(np.mean(error[:, 2] ** 2)) < 0.02
    grid = {"omega_ref": np.repeat([2000.0, 4000.0, 6000.0], 4), "beta_ref": np.tile([-5.0, 0.0, 5.0, 10.0], 3)}
    settled = [simulator(m).simulate(p, {n: np.array([x, x]) for n, x in point.items()}, np.ones(1))[0, 0]
               for m, p in ((FULL_RIG, {}), (BASE, wiener(4000.0, 2.5)))
               for point in (dict(zip(grid, row, strict=True)) for row in zip(*grid.values(), strict=True))]  # fmt: skip
    np.testing.assert_allclose(settled[12:], settled[:12], rtol=0, atol=0.25)
