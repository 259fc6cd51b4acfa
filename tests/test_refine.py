"""The fit of the Wiener model against transfer functions in scipy, and scipy's solver on them."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter
from studies.synthetic import STEP, TRUTH, commands, measured

from identification.fit.least_squares import solve
from identification.fit.problem import Problem
from identification.fit.refine import BASE_PARAMETERS, independent_readings, refine
from vpp_fmu.kernel.plant import AVERAGED, BASE

SCALE = BASE.values()["thrust_scale"]


@pytest.fixture(scope="module")
def record():
    rng = np.random.default_rng(3)
    return measured(commands(rng, 10.0), rng)


def two_lags(command, tau_1, tau_2):
    """Response (rows,) of two lags in series to a held command, from the step response; the constants may be complex."""
    e_1, e_2 = np.exp(-STEP / tau_1), np.exp(-STEP / tau_2)
    first = 1.0 - (tau_1 * e_1 - tau_2 * e_2) / (tau_1 - tau_2)
    poles, moved = [1.0, -e_1 - e_2, e_1 * e_2], command - command[0]
    return command[0] + lfilter([0.0, first, (1.0 - e_1) * (1.0 - e_2) - first], poles, moved)


def predicted(p, record):
    """Normalised thrust (rows,) for the nine parameters."""
    w = two_lags(record["omega_ref"] / 6000.0, p[0], p[1])
    b = two_lags((record["beta_ref"] + 5.0) / 15.0, p[2], p[3])
    return p[4] * w**2 + p[5] * w * b + p[6] * w**2 * b + p[7] * w * b**2 + p[8] * w**3


def complex_step(p, record):
    """Derivatives (rows, 9) of the normalised thrust, exact to rounding."""
    return np.column_stack([predicted(p + 1e-30j * own, record).imag / 1e-30 for own in np.eye(9)])


def test_many_good_steps_do_not_make_the_damping_of_collinear_parameters_vanish():
    """The first parameter is halved in each step; the others have the same column."""

    def rows(x):
        return np.array([x[0] ** 2, x[1] + x[2] - 1.0]), np.array([[2.0 * x[0], 0.0, 0.0], [0.0, 1.0, 1.0]])

    found = solve(rows, np.array([1.0, 0.0, 0.0]), np.full(3, -9.0), np.full(3, 9.0)).value
    assert found[0] == pytest.approx(0.0, abs=1e-6)
    assert found[1] + found[2] == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(4))
def test_a_coarse_tolerance_still_ends_at_the_optimum_of_a_curved_valley(seed):
    """Rate and time constant of a drift: only their product is known early. The last step has its own Jacobian; with that of
    an earlier point the search ended up to 0.3 short in log-likelihood."""
    t = np.linspace(0.0, 60.0, 3000)
    lower, upper = np.array([-0.05, 10.0]), np.array([0.05, 1000.0])
    drift = -0.0044 * 15.5 * (1.0 - np.exp(-t / 15.5)) + 0.05 * np.random.default_rng(seed).standard_normal(3000)

    def residual(x):
        return (x[0] * x[1] * (1.0 - np.exp(-t / x[1])) - drift) / 0.05

    def rows(x):
        decay = np.exp(-t / x[1])
        return residual(x), np.column_stack([x[1] * (1.0 - decay), x[0] * (1.0 - decay - t / x[1] * decay)]) / 0.05

    optimum = least_squares(residual, [-0.004, 15.0], x_scale=[0.001, 1.0], xtol=1e-15, ftol=1e-15, gtol=1e-15).cost
    for start in ([-0.001, 300.0], [-0.0014, 75.0]):
        found = solve(rows, np.array(start), lower, upper, 1.0 / 3000, residual_at=residual)
        assert found.converged
        assert found.cost < optimum + 0.02


def test_sensitivities_are_those_of_the_transfer_functions(record):
    problem = Problem(BASE, independent_readings([record], BASE.values(), ("thrust",)), BASE.values(), BASE_PARAMETERS)
    p = np.array([TRUTH[n] for n in BASE_PARAMETERS])
    residual, jacobian = problem.rows(TRUTH)
    expected = complex_step(p, record)
    np.testing.assert_allclose(residual, predicted(p, record) - record["thrust"] / SCALE, atol=1e-12)
    np.testing.assert_allclose(jacobian, expected, atol=1e-10 * np.abs(expected).max())


def test_the_minimum_is_that_of_scipy_on_the_transfer_functions(record):
    read, found = record["thrust"] / SCALE, refine(BASE, [record], AVERAGED, channels=("thrust",))
    start = np.array([TRUTH[n] for n in BASE_PARAMETERS])
    tolerances = dict.fromkeys(("ftol", "xtol", "gtol"), 1e-15)
    other = least_squares(lambda p: predicted(p, record) - read, start, lambda p: complex_step(p, record), **tolerances)
    assert found.solution.cost == pytest.approx(other.cost, rel=1e-11)
    assert found.cost_final == pytest.approx(other.cost / len(record), rel=1e-11)
    for name, value in zip(BASE_PARAMETERS, other.x, strict=True):
        assert abs(found.values[name] - value) < 1e-4 * found.std[name]


TIME = np.linspace(0.0, 3.0, 40)
READ = 2.0 * np.exp(-1.3 * TIME) + 0.05 * np.random.default_rng(0).standard_normal(40)


def decay(amplitude, rate):
    """(residual, derivatives) of an exponential against READ."""
    shape = np.exp(-rate * TIME)
    return amplitude * shape - READ, np.column_stack([shape, -amplitude * TIME * shape])


@pytest.mark.parametrize("is_chord", [True, False])
@pytest.mark.parametrize("most", [10.0, 1.0])
def test_a_fit_in_other_coordinates_has_the_same_minimum(is_chord, most):
    """In the logarithm of the rate, with the Jacobian in the rate itself, free and at its bound."""
    expected = least_squares(lambda p: decay(*p)[0], [1.0, 0.5], bounds=([0.0, 0.1], [10.0, most]), xtol=1e-15, gtol=1e-15)
    rows = lambda x: decay(x[0], np.exp(x[1]))  # noqa: E731
    residual_at = (lambda x: rows(x)[0]) if is_chord else None
    inner = lambda x: np.diag([1.0, np.exp(x[1])])  # noqa: E731
    lower, upper = np.array([0.0, np.log(0.1)]), np.array([10.0, np.log(most)])
    found = solve(rows, np.array([1.0, np.log(0.5)]), lower, upper, residual_at=residual_at, inner=inner)
    assert found.converged
    assert found.cost == pytest.approx(expected.cost, rel=1e-9)
    assert [found.value[0], np.exp(found.value[1])] == pytest.approx(expected.x, rel=1e-4)
    assert found.active.tolist() == [False, most == 1.0]
    residual, jacobian = rows(found.value)
    np.testing.assert_allclose(found.residual, residual, atol=1e-8)
    if not is_chord:
        np.testing.assert_allclose(found.jacobian, jacobian @ inner(found.value), atol=1e-3)
