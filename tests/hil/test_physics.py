"""The rig's physics against closed forms, the paper's numbers, and its equations 1 to 6 under scipy's integrator."""

from itertools import pairwise

import numpy as np
import pytest
from builders import reference, simulator
from rig_commands import commands
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from hil.physics import propeller
from hil.physics.rig_model import FULL_RIG, POWERTRAIN
from vpp_fmu.kernel.ops import NUMBERS

RPM, DEG = np.pi / 30.0, np.pi / 180.0
P = POWERTRAIN.values()
OUT = {s.name: k for k, s in enumerate(POWERTRAIN.outputs)}
K = 30.0 / (np.pi * 550.0)


class Named:
    """Parameters as attributes."""

    def __init__(self, **changes):
        self.__dict__.update(P | changes)


def held(throttle, beta, seconds, dt=0.001, volts=24.0, **parameters):
    """Outputs of the powertrain under steps: `throttle` and `beta` are values or [(from second, value), ...]."""
    time = np.arange(round(seconds / dt) + 1) * dt

    def column(levels):
        levels = levels if isinstance(levels, list) else [(0.0, levels)]
        at = np.searchsorted([t for t, _ in levels], time + 1e-9, side="right") - 1
        return np.array([float(v) for _, v in levels])[at]

    inputs = {"throttle": column(throttle), "beta_ref": column(beta), "supply": np.full(len(time), volts)}
    return time, simulator(POWERTRAIN).simulate(parameters, inputs, np.full(len(time) - 1, dt)), inputs


def test_the_static_map_is_the_papers_within_a_quarter_of_a_newton():
    """Section 4.1: settled thrust on the paper's 10 x 10 grid, pitch from -5 deg as its fit."""
    w, b = (x.ravel() for x in np.meshgrid(np.linspace(2000.0, 6000.0, 10), np.linspace(-5.0, 10.0, 10)))
    points = [{"omega_ref": np.full(2, x), "beta_ref": np.full(2, y)} for x, y in zip(w, b, strict=True)]
    thrust = np.array([simulator(FULL_RIG).simulate({}, point, [0.004])[0, 0] for point in points])
    error = thrust - (0.21 * w**2 - 5.7 * w * b + 0.023 * w**2 * b - 1.25 * w * b**2 - 2.15e-6 * w**3) * 1e-6
    assert np.abs(error).max() < 0.26
    assert np.sqrt(np.mean(error**2)) < 0.085
    assert 14.0 < thrust[-1] < 15.0


def equations(throttle, goal, p):
    """The paper's equations 1 to 6 as they are printed, with the maps written out, for constant throttle and pitch command:
    (rates of the state, thrust of the state); the state is omega, I, beta, rate, I_a, inflow in SI units."""
    disk = 0.5 * p["density"] * np.pi * p["radius"] ** 4

    def lift_of(alpha):
        return p["lift"] * alpha * (1.0 - p["bend"] * abs(alpha))

    def attack(beta, inflow):
        return p["incidence"] * DEG + beta - 1.5 * inflow

    def rates(t, y):
        omega, i, beta, rate, i_a, inflow = y
        ct = lift_of(attack(beta, inflow))
        cq = p["induced"] * abs(inflow * ct) + p["profile"] + p["profile_rise"] * attack(beta, inflow) ** 2
        torque = disk * p["radius"] * omega**2 * cq
        settled = brentq(lambda x: 4.0 * x * abs(x) - lift_of(attack(beta, x)), -0.3, 0.3, xtol=1e-13)
        travel = (p["beta_high"] - p["beta_low"]) * DEG
        wanted = (p["kp_lac"] * (goal * DEG - beta) - p["kd_lac"] * p["lac_period"] * rate) / travel
        drive = np.clip(wanted, -1.0, 1.0)
        return [
            (K * i - p["drag"] * omega - p["dry_friction"] - torque) / p["inertia"],
            (throttle * 24.0 - (p["resistance"] + p["lead_resistance"]) * i - K * omega) / p["inductance"],
            rate,
            (p["k_a"] * i_a - p["d_a"] * rate) / p["j_a"],
            (drive * p["v_a"] - p["r_a"] * i_a - p["k_ia"] * rate) / p["l_a"],
            (settled - inflow) * 4.0 * max(abs(settled), p["least"]) * omega / p["apparent_mass"],
        ]

    return rates, lambda y: disk * y[0] ** 2 * lift_of(attack(y[2], y[5]))


@pytest.mark.parametrize(
    "parameters", [{}, {"inductance": 4e-4, "resistance": 0.01, "lead_resistance": 0.0}], ids=["rig", "ringing"]
)
def test_steps_of_a_millisecond_are_the_papers_equations_under_scipy(parameters):
    """Throttle up and down, pitch by a small and a large step; also with a circuit and shaft that ring."""
    throttles, goals = [(0.0, 0.25), (0.05, 0.5), (0.7, 0.3)], [(0.0, 2.0), (0.2, 3.0), (0.5, -5.0)]
    time, y, _ = held(throttles, goals, 1.2, **parameters)
    p, rows = P | parameters, []
    first = y[0]
    inflow = propeller.settled_inflow(NUMBERS, Named(**parameters), 2.0)
    state = [first[OUT["omega"]] * RPM, first[OUT["current"]], 2.0 * DEG, 0.0, 0.0, inflow]
    edges = sorted({0.0, 1.2, *(t for t, _ in throttles + goals)})
    for begin, end in pairwise(edges):
        rates, thrust = equations(level_at(throttles, begin), level_at(goals, begin), p)
        at = time[(time > begin + 1e-9) & (time < end + 1e-9)]
        solved = solve_ivp(rates, (begin, end + 1e-9), state, "LSODA", at, rtol=1e-8, atol=1e-10, max_step=0.01)
        state = solved.y[:, -1]
        rows += [(thrust(x), x[0] / RPM, x[2] / DEG, x[1]) for x in solved.y.T]
    exact = np.array(rows)
    shown = y[1:, [OUT["thrust"], OUT["omega"], OUT["beta"], OUT["current"]]]
    assert np.ptp(exact[:, 1]) > 2000.0
    assert (np.abs(shown - exact).max(axis=0) < [5e-4, 0.02, 1e-4, 2e-3]).all()  # N, rpm, deg, A


def level_at(levels, t):
    """The level that acts from second t on."""
    return [v for begin, v in levels if begin <= t + 1e-12][-1]


@pytest.mark.parametrize("model", [POWERTRAIN, FULL_RIG], ids=lambda m: m.name)
def test_c_is_python_to_the_bit_and_the_communication_step_does_not_matter(model):
    inputs = commands(model, 300)
    steps = np.full(299, 0.008)
    shown = simulator(model).simulate({}, inputs, steps)
    np.testing.assert_array_equal(reference(model, {}, inputs, steps), shown)
    assert np.isfinite(shown).all()
    for split, close in ((2, 1e-9), (8, 1e-9), (32, 5e-4)):
        fine = {n: np.repeat(c, split)[: 299 * split + 1] for n, c in inputs.items()}
        finer = simulator(model).simulate({}, fine, np.full(299 * split, 0.008 / split))[::split]
        np.testing.assert_allclose(finer[:, 0], shown[:, 0], rtol=0, atol=close)
        np.testing.assert_allclose(finer[:, 1], shown[:, 1], rtol=0, atol=100.0 * close)


SOURCES = ("paper", "data sheet", "chosen", "fitted", "standard", "Pitt and Peters")


@pytest.mark.parametrize("model", [POWERTRAIN, FULL_RIG], ids=lambda m: m.name)
def test_every_parameter_names_its_source_and_is_finite_at_its_bounds(model):
    inputs, steps = commands(model, 12), np.full(11, 0.01)
    for p in model.parameters:
        assert any(source in p.description for source in SOURCES), p.name
        assert p.minimum <= p.default <= p.maximum, p.name
        for value in (p.minimum, p.maximum):
            shown = reference(model, {p.name: value}, inputs, steps)
            assert np.isfinite(shown).all(), (p.name, value)
            np.testing.assert_array_equal(simulator(model).simulate({p.name: value}, inputs, steps), shown)
