"""Lags, map, plant and schedule against closed forms, high precision and scipy."""

import ctypes
import math
from decimal import Decimal, localcontext
from fractions import Fraction
from importlib.resources import files

import numpy as np
import pytest
from builders import TWO_DELAYS, paper_map, random_steps, reference, simulator, steps_through, two_lags
from scipy.signal import lsim

from vpp_fmu.kernel.exponential import exp, expm1
from vpp_fmu.kernel.ops import NUMBERS
from vpp_fmu.kernel.plant import AVERAGED, BASE, FINE_TUNED
from vpp_fmu.kernel.schedule import run_sampled
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.native.compiler import compiled

APART = [1e-3, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12]
TAUS = [(0.172, 0.053), (0.053, 0.172), (0.207, 0.374), (0.1, 0.1), (3.0, 0.001), (0.001, 3.0), (3.0, 3.0), (0.001, 0.001)]
TAUS += [(0.1, 0.1 * (1.0 + apart)) for apart in APART] + [(0.1 * (1.0 + apart), 0.1) for apart in APART]
DTS = [1e-6, 1e-4, 0.004, 0.0301, 0.5, 3.0, 100.0]


def precise(function, *args: float) -> float:
    """`function` of Decimals that hold the floats exactly, with 80 digits."""
    with localcontext() as context:
        context.prec = 80
        return float(function(*map(Decimal, args)))


def decimal_two_lag_step(tau_1, tau_2, dt):
    if tau_1 == tau_2:
        return 1 - (-dt / tau_1).exp() * (1 + dt / tau_1)
    return 1 - (tau_1 * (-dt / tau_1).exp() - tau_2 * (-dt / tau_2).exp()) / (tau_1 - tau_2)


def decimal_lag_ramp(x, before, after, tau, dt):
    slope, left = (after - before) / dt, (-dt / tau).exp()
    return after - slope * tau + (x - before + slope * tau) * left


@pytest.mark.parametrize("dt", DTS)
@pytest.mark.parametrize(("tau_1", "tau_2"), TAUS)
def test_two_lag_step_is_the_closed_form(tau_1, tau_2, dt):
    x = dt / max(tau_1, tau_2)
    rounding = 4e-16 * min(1.0, x) + 1.2e-16 * min(40.0, x)  # x times the rounding of 1 - gain, which is 0 beyond
    exact = precise(decimal_two_lag_step, tau_1, tau_2, dt)
    assert NUMBERS.two_lag_step(tau_1, tau_2, dt) == pytest.approx(exact, rel=0.0, abs=rounding)


_dice = np.random.default_rng(7)
EXPONENTS = [0.0, 1e-300, -5e-324, 700.0, -700.0, 0.5 * math.log(2.0), -0.5 * math.log(2.0)]
EXPONENTS += [*_dice.uniform(-1.0, 1.0, 1000), *_dice.uniform(-700.0, 700.0, 500), *-(10.0 ** _dice.uniform(-20.0, 2.0, 500))]


def test_exponentials_are_right_to_the_last_digits():
    for x in EXPONENTS:
        exact, less_1 = precise(lambda x: x.exp(), x), precise(lambda x: x.exp() - 1, x) if abs(x) > 1e-30 else x
        assert abs(exp(x) - exact) <= math.ulp(exact)
        assert abs(expm1(x) - less_1) <= 2.0 * math.ulp(less_1)
    assert (exp(-700.1), expm1(-700.1), exp(-math.inf), exp(math.inf)) == (0.0, -1.0, 0.0, math.inf)
    assert math.isnan(exp(math.nan))
    assert math.isnan(expm1(math.nan))


def test_exponentials_in_c_are_those_in_python():
    text = (files("vpp_fmu.kernel") / "exponential.c").read_text()
    calls = "double e(double x) { return EXP(x); }\ndouble less_1(double x) { return EXPM1(x); }\n"
    library = compiled(f"#include <math.h>\n#define APART\n{text}\n{calls}")
    for in_c, function in ((library.e, exp), (library.less_1, expm1)):
        in_c.argtypes, in_c.restype = [ctypes.c_double], ctypes.c_double
        assert [in_c(x) for x in EXPONENTS] == [function(x) for x in EXPONENTS]
        assert [in_c(x) for x in (-701.0, -math.inf, math.inf)] == [function(x) for x in (-701.0, -math.inf, math.inf)]
        assert in_c(701.0) == math.inf
        assert math.isnan(in_c(math.nan))
        with pytest.raises(OverflowError):
            function(701.0)


@pytest.mark.parametrize("x", [0.0, 5e-324, 1e-300, 1e-8, 0.1, math.nextafter(0.3, 0.0), 0.3, 0.31, 1.0, 10.0, 700.0, 1e5])
def test_relaxation_is_the_closed_form(x):
    exact = 1.0 if x == 0.0 else precise(lambda x: (1 - (-x).exp()) / x, x) if x > 1e-9 else 1.0 - x / 2.0
    assert NUMBERS.relaxation(x) == pytest.approx(exact, rel=4e-16, abs=0.0)


@pytest.mark.parametrize("dt", DTS)
@pytest.mark.parametrize("tau", [0.001, 0.053, 0.374, 3.0, 1000.0])
def test_lag_and_its_gain_are_the_closed_form(tau, dt):
    assert NUMBERS.gain(tau, dt) == pytest.approx(precise(lambda tau, dt: 1 - (-dt / tau).exp(), tau, dt), rel=4e-16, abs=0.0)
    exact = precise(lambda x, u, tau, dt: u + (x - u) * (-dt / tau).exp(), 2.5, -7.0, tau, dt)
    assert NUMBERS.lag(2.5, -7.0, tau, dt) == pytest.approx(exact, rel=0.0, abs=4e-15)
    assert NUMBERS.lag(0.1, 0.1, tau, dt) == 0.1


@pytest.mark.parametrize("dt", DTS)
@pytest.mark.parametrize("tau", [0.001, 0.053, 0.374, 3.0])
def test_lag_ramp_is_the_closed_form(tau, dt):
    exact = precise(decimal_lag_ramp, 2.5, -7.0, 4.0, tau, dt)
    assert NUMBERS.lag_ramp(2.5, -7.0, 4.0, tau, dt) == pytest.approx(exact, rel=0.0, abs=1e-14)
    assert NUMBERS.lag_ramp(2.5, -7.0, -7.0, tau, dt) == pytest.approx(NUMBERS.lag(2.5, -7.0, tau, dt), rel=0.0, abs=1e-14)


def paper_lags(inputs, time):
    """Eq. 16 by scipy: speed and pitch under held commands, at rest on the first. Absolute values: the DC gain is 1."""
    t1, t2, t3, t4 = 0.172, 0.053, 0.207, 0.374
    a = [[-1 / t1, 0, 1 / t1, 0], [0, -1 / t3, 0, 1 / t3], [0, 0, -1 / t2, 0], [0, 0, 0, -1 / t4]]
    b, c = [[0, 0], [0, 0], [1 / t2, 0], [0, 1 / t4]], [[1, 0, 0, 0], [0, 1, 0, 0]]
    u = np.column_stack([inputs[name] for name in ("omega_ref", "beta_ref")])
    return lsim((np.array(a), np.array(b), np.array(c), np.zeros((2, 2))), u, time, X0=[*u[0], *u[0]], interp=False)[1]


def test_plant_is_the_papers_equations_under_scipy():
    inputs, time = random_steps(2001, 200), np.arange(2001) * 0.004
    omega, beta = paper_lags(inputs, time).T
    shown = reference(BASE, {}, inputs, np.full(2000, 0.004))
    np.testing.assert_allclose(shown[:, 1], omega, rtol=0, atol=1e-8)
    np.testing.assert_allclose(shown[:, 2], beta, rtol=0, atol=1e-11)
    np.testing.assert_allclose(shown[:, 0], paper_map(omega, beta), rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    "taus", [{}, {"tau_beta_2": 0.207}, {"tau_omega_2": 0.172 + 1e-9}, {"tau_omega_1": 3, "tau_omega_2": 0.001}]
)
@pytest.mark.parametrize("seed", range(4))
def test_splitting_a_step_gives_the_same_state(taus, seed):
    rng = np.random.default_rng(seed)
    rest, held = {"omega_ref": 2000.0, "beta_ref": 10.0}, {"omega_ref": 5900.0, "beta_ref": -4.0}
    whole, split = Simulation(BASE, taus), Simulation(BASE, taus)
    cuts = np.sort(np.r_[0.0, 1e-6, rng.uniform(0, 0.3, 20), 0.3])
    for simulation, pieces in ((whole, [0.3]), (split, np.diff(cuts))):
        simulation.start(rest)
        for dt in pieces:
            simulation.advance(held, float(dt))
    for name, value in whole.states.items():
        assert split.states[name] == pytest.approx(value, rel=1e-12), name


def test_sets_are_the_papers_numbers():
    assert FINE_TUNED == {
        **{"tau_omega_1": 0.172, "tau_omega_2": 0.053, "tau_beta_1": 0.207, "tau_beta_2": 0.374},
        **{"c20": 0.355, "c11": 0.064, "c21": 0.8, "c12": -0.16, "c30": -0.081},
    }
    assert {p.name: p.default for p in BASE.parameters} | FINE_TUNED == BASE.values()
    taus = {"tau_omega_1": 0.15, "tau_omega_2": 0.04, "tau_beta_1": 0.11, "tau_beta_2": 0.28}
    assert {name: AVERAGED[name] for name in taus} == taus


GRIDS = {
    "1 ms": np.full(1200, 0.001),
    "4 ms": np.full(300, 0.004),
    "37 ms": np.full(33, 0.037),
    "uneven": np.random.default_rng(2).choice([1e-4, 0.0013, 0.004, 0.011, 0.05], 400),
}


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("hold", [1, 30])
@pytest.mark.parametrize(
    ("pitch", "speed"), [(0.0, 0.0), (0.004, 0.0), (0.04, 0.04), (0.0137, 0.0021), (1e-4, 0.3), (0.3, 0.29999), (1e-7, 0.111)]
)
def test_delay_shifts_the_response_exactly(pitch, speed, hold, grid):
    steps, delays = GRIDS[grid], {"pitch_delay.delay": pitch, "test_speed_delay.delay": speed}
    t, inputs = np.r_[0.0, np.cumsum(steps)], random_steps(len(steps) + 1, hold)
    beta = steps_through(t, t + pitch, inputs["beta_ref"], lambda t: two_lags(t, 0.207, 0.374))
    omega = steps_through(t, t + speed, inputs["omega_ref"], lambda t: two_lags(t, 0.172, 0.053))
    exact = np.column_stack([paper_map(omega, beta), omega, beta])
    shown = simulator(TWO_DELAYS).simulate(delays, inputs, steps)
    np.testing.assert_allclose(shown / [15.0, 6000.0, 15.0], exact / [15.0, 6000.0, 15.0], rtol=0, atol=1e-10)
    np.testing.assert_array_equal(shown, reference(TWO_DELAYS, delays, inputs, steps))


@pytest.mark.parametrize("period", ["0.004", "0.01", "0.007", "0.0003"])
@pytest.mark.parametrize("span", ["0.001", "0.003", "0.004", "0.007", "0.011"])
def test_every_sample_falls_into_its_communication_step(period, span):
    """Sample n is due at n period: it belongs to the step that begins then or before, whatever the accumulated rounding."""
    wait, taken = 0.0, []
    for k in range(3000):
        wait = run_sampled(wait, float(period), float(span), lambda _, k=k: taken.append(k))
    exact = (n * Fraction(period) // Fraction(span) for n in range(len(taken) + 1))
    assert [k for k in exact if k < 3000] == taken
