"""The dual PID against an independent implementation of the paper's formulas, and its behaviour at limits."""

import numpy as np
import pytest
from builders import reference, simulator
from scipy.optimize import brentq

from vpp_fmu.kernel.controller import CONTROLLER, DUAL, SPEED_ONLY
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.native.closed_loop import ClosedLoop, Course
from vpp_fmu.record import Record

WIDE = {"omega_min": 0.0, "omega_max": 30000.0, "beta_min": -45.0, "beta_max": 45.0}
SOFT = {"kp_omega": 0.4, "ki_omega": 0.9, "kd_omega": 0.011, "kp_beta": 0.3, "ki_beta": 1.3, "kd_beta": 0.007}
ONLY_I = dict.fromkeys(("kp_omega", "kd_omega", "kp_beta", "kd_beta"), 0.0)


def papers_pid(e, dt, t_filter, kp, ki, kd):
    """Section 3.3, normalised: trapezoidal sum and filtered difference, both zero at the first sample."""
    commands, integral, derivative = [], 0.0, 0.0
    for k in range(len(e)):
        if k > 0:
            integral += 0.5 * (e[k - 1] + e[k]) * dt
            delta = dt / t_filter
            derivative = (1.0 - delta) * derivative + delta * (e[k] - e[k - 1]) / dt
        commands.append(kp * e[k] + ki * integral + kd * derivative)
    return np.array(commands)


def errors(rows, seed=0):
    """Wanted and measured thrust with steps and noise [N], biased so that unlimited commands stay within the wide limits."""
    rng = np.random.default_rng(seed)
    wanted = np.repeat(rng.uniform(4.0, 8.0, rows // 50 + 1), 50)[:rows]
    return {"thrust_set": wanted, "thrust": rng.normal(2.0, 0.3, rows)}


def commands(parameters, inputs, steps):
    """Commands after each step of the controller: (rows, 2) rpm, deg."""
    return reference(CONTROLLER, parameters, inputs, steps)[1:]


@pytest.mark.parametrize("sample_time", [0.004, 0.01])
@pytest.mark.parametrize("t_filter", [0.02, 0.0101, 0.3])
def test_without_saturation_it_is_the_papers_law(t_filter, sample_time):
    inputs = errors(301)
    shown = commands({**WIDE, **SOFT, "t_filter": t_filter, "sample_time": sample_time}, inputs, np.full(300, sample_time))
    e = (inputs["thrust_set"] - inputs["thrust"])[:-1] / 15.0
    w = papers_pid(e, sample_time, t_filter, 0.4, 0.9, 0.011)
    b = papers_pid(e, sample_time, t_filter, 0.3, 1.3, 0.007)
    np.testing.assert_allclose(shown, np.column_stack([6000.0 * w, 15.0 * b - 5.0]), rtol=1e-12, atol=1e-10)
    assert shown.max(axis=0) == pytest.approx(shown.max(axis=0).clip([0.0, -45.0], [29999.0, 44.9]))


@pytest.mark.parametrize("t_filter", [0.0, 1e-6, 0.001, 0.004])
def test_a_filter_faster_than_the_sample_is_no_filter(t_filter):
    inputs = errors(201)
    shown = commands({**WIDE, **SOFT, "t_filter": t_filter}, inputs, np.full(200, 0.004))
    w = papers_pid((inputs["thrust_set"] - inputs["thrust"])[:-1] / 15.0, 0.004, 0.004, 0.4, 0.9, 0.011)
    np.testing.assert_allclose(shown[:, 0], (6000.0 * w).clip(0.0, 30000.0), rtol=1e-11)


def test_published_gains_are_the_papers():
    assert DUAL == {"kp_omega": 9.82, "ki_omega": 115.3, "kd_omega": 0.318, "kp_beta": 9.0, "ki_beta": 70.44, "kd_beta": 0.25}
    assert {k: v for k, v in SPEED_ONLY.items() if k[0] == "k"} == {"kp_omega": 7.47, "ki_omega": 67.7, "kd_omega": 0.15}
    assert CONTROLLER.values() == {**CONTROLLER.values(), **DUAL, "t_filter": 0.02, "sample_time": 0.004}


def held_within(moves, low, high):
    """An integral that is clamped at its limits."""
    held = [0.0]
    for move in moves:
        held.append(min(max(held[-1] + move, low), high))
    return np.array(held[1:])


@pytest.mark.parametrize(("ki_omega", "ki_beta", "free"), [(5.0, 50.0, 0), (50.0, 0.5, 1)])
def test_one_channel_saturates_and_the_other_goes_on(ki_omega, ki_beta, free):
    """4 s of positive error, 3 s of negative: the free channel is the plain integral, the other one reaches both limits."""
    limits = {**WIDE, "omega_min": 2000.0, "omega_max": 6000.0} if free == 1 else WIDE
    e = np.r_[np.full(1000, 0.1), np.full(750, -0.1)]
    inputs = {"thrust_set": 15.0 * np.r_[e, 0.0], "thrust": np.zeros(1751)}
    shown = commands({**limits, **ONLY_I, "ki_omega": ki_omega, "ki_beta": ki_beta}, inputs, np.full(1750, 0.004))
    moves = np.r_[0.0, 0.5 * (e[1:] + e[:-1]) * 0.004]
    w, b = ki_omega * np.cumsum(moves), ki_beta * np.cumsum(moves)
    if free == 0:
        b = held_within(ki_beta * moves, -40.0 / 15.0, 50.0 / 15.0)
    else:
        w = held_within(ki_omega * moves, 2000.0 / 6000.0, 1.0)
    exact = np.column_stack([6000.0 * w, 15.0 * b - 5.0])
    np.testing.assert_allclose(shown[:, free], exact[:, free], rtol=1e-10, atol=1e-9)
    other = 1 - free
    a_sample = [6000.0 * ki_omega, 15.0 * ki_beta][other] * 0.1 * 0.004  # a clamped integral stops up to that much early
    top = np.flatnonzero(shown[:, other] >= [6000.0, 45.0][other] - a_sample)[0]
    np.testing.assert_allclose(shown[top:, other], exact[top:, other], rtol=0, atol=2.0 * a_sample)
    assert exact[-1, other] == [2000.0, -45.0][other]


@pytest.mark.parametrize("gains", [DUAL, SPEED_ONLY])
def test_the_duration_of_an_unreachable_set_point_does_not_affect_the_recovery(gains):
    """With the plant in the loop: 20 N, which is out of reach, for 6 s or for 30 s, then 6 N."""

    def released_after(seconds):
        plant, controller = Simulation(BASE, {"tau_beta_2": 0.05}), Simulation(CONTROLLER, gains)
        thrust, after = plant.start({"omega_ref": 4000.0, "beta_ref": 5.0})["thrust"], []
        for k in range(round((seconds + 2.0) / 0.004)):
            wanted = 20.0 if k * 0.004 < seconds else 6.0
            thrust = plant.advance(controller.advance({"thrust_set": wanted, "thrust": thrust}, 0.004), 0.004)["thrust"]
            after += [thrust] if wanted == 6.0 else []
        return np.array(after)

    np.testing.assert_allclose(released_after(6.0), released_after(30.0), rtol=0, atol=1e-6)


def test_commands_never_leave_their_limits():
    rng = np.random.default_rng(0)
    for _ in range(20):
        low, high = np.sort(rng.uniform([0.0, -20.0], [8000.0, 20.0], (2, 2)), axis=0)
        limits = dict(zip(("omega_min", "beta_min", "omega_max", "beta_max"), [*low, *high], strict=True))
        inputs = {name: 15.0 * rng.normal(size=101) for name in ("thrust_set", "thrust")}
        shown = commands(limits, inputs, np.full(100, 0.004))
        assert max((low - shown).max(), (shown - high).max()) <= 0.0, limits


@pytest.mark.parametrize("parameter", CONTROLLER.parameters, ids=lambda p: p.name)
def test_at_every_bound_the_numbers_are_finite_and_c_is_python(parameter):
    inputs = {"thrust_set": np.repeat([5.0, 12.0], 15), "thrust": np.linspace(0.0, 10.0, 30)}
    for value in (parameter.minimum, parameter.maximum):
        shown = reference(CONTROLLER, {parameter.name: value}, inputs, np.full(29, 0.004))
        assert np.isfinite(shown).all()
        np.testing.assert_array_equal(
            simulator(CONTROLLER).simulate({parameter.name: value}, inputs, np.full(29, 0.004)), shown
        )


def test_speed_only_keeps_the_pitch_and_is_the_papers_law_for_speed():
    inputs = errors(301)
    shown = commands({**WIDE, **SOFT, "speed_only": 1.0, "beta_fixed": 7.5}, inputs, np.full(300, 0.004))
    w = papers_pid((inputs["thrust_set"] - inputs["thrust"])[:-1] / 15.0, 0.004, 0.02, 0.4, 0.9, 0.011)
    np.testing.assert_allclose(shown[:, 0], 6000.0 * w, rtol=1e-12)
    assert (shown[:, 1] == 7.5).all()


@pytest.mark.parametrize("milliseconds", [1, 2, 3, 4, 8, 12, 24])
def test_it_samples_at_its_own_period_whatever_the_communication_step(milliseconds):
    """Inputs change every 24 ms; at these times the commands are those of samples 4 ms apart."""
    coarse = errors(251)
    every_sample = {name: np.repeat(column, 6) for name, column in coarse.items()}
    expected = commands(DUAL, every_sample, np.full(1505, 0.004))[5::6]
    split = 24 // milliseconds
    inputs = {name: np.repeat(column, split) for name, column in coarse.items()}
    steps = np.full(251 * split - 1, milliseconds / 1000.0)
    for shown in (commands(DUAL, inputs, steps), simulator(CONTROLLER).simulate(DUAL, inputs, steps)[1:]):
        np.testing.assert_array_equal(shown[split - 1 :: split], expected[: len(shown[split - 1 :: split])])


PAIRS = {f"pair_omega_{k}": 2000.0 + 450.0 * k for k in range(9)} | {f"pair_beta_{k}": 9.0 - k for k in range(9)}
TABLE = {**PAIRS, "pairs_thrust_min": 1.0, "pairs_thrust_max": 9.0, "k_mid": 0.7, "mode": 2.0}
"""Knots every newton: (2000 + 450 k) rpm, (9 - k) deg at 1 + k N."""


def test_the_allocated_law_is_that_of_its_equations():
    inputs = errors(301)
    inputs["thrust"] = inputs["thrust_set"] - 0.4 * np.random.default_rng(3).standard_normal(301)
    shown = commands({**WIDE, **SOFT, **TABLE}, inputs, np.full(300, 0.004))
    wanted = inputs["thrust_set"][:-1]
    e = (wanted - inputs["thrust"][:-1]) / 15.0
    best_w, best_b = (2000.0 + 450.0 * (wanted - 1.0)) / 6000.0, (9.0 - (wanted - 1.0) + 5.0) / 15.0
    away = papers_pid(e, 0.004, 0.02, 0.3, 1.3, 0.007)
    taken = np.cumsum(np.append(0.0, away[1:])) * 0.004
    w = best_w + papers_pid(e, 0.004, 0.02, 0.4, 0.0, 0.011) + 0.7 * taken
    np.testing.assert_allclose(shown, np.column_stack([6000.0 * w, 15.0 * (best_b + away) - 5.0]), rtol=1e-12, atol=1e-10)


@pytest.mark.parametrize("modes", [(0.0, 2.0), (2.0, 0.0), (1.0, 2.0), (1.0, 0.0)])
def test_commands_are_continuous_when_the_mode_changes(modes):
    """The error is the same at the switch; pitch also continues from a fixed pitch."""
    law = Simulation(CONTROLLER, {**WIDE, **SOFT, **TABLE, "mode": modes[0], "t_filter": 0.004})
    law.start({"thrust_set": 5.0, "thrust": 4.6})
    for _ in range(50):
        before = law.advance({"thrust_set": 5.0, "thrust": 4.6}, 0.004)
    law.parameters["mode"] = modes[1]
    after = law.advance({"thrust_set": 5.0, "thrust": 4.6}, 0.004)
    moves = {n: abs(after[n] - before[n]) for n in ("omega_ref", "beta_ref")}
    assert moves["omega_ref"] < 0.7 * 0.004 * 6000.0  # rpm, k_mid dt for 15 deg; the table is some 1000 rpm away
    assert moves["beta_ref"] < 0.01


@pytest.mark.parametrize("error", [0.95, 1.05])
@pytest.mark.parametrize("pitch", [4.0, 10.0])
def test_on_the_best_pairs_thrust_has_no_error_at_rest_though_the_table_has(error, pitch):
    """Also where the best pitch is the greatest, so that only speed can add thrust. The table's speeds are wrong by 5 %."""
    plant = Simulation(BASE)

    def speed_of(thrust):
        return brentq(lambda w: plant.start({"omega_ref": w, "beta_ref": pitch})["thrust"] - thrust, 500.0, 9000.0)

    table = {f"pair_omega_{k}": error * speed_of(2.0 + k) for k in range(9)} | {f"pair_beta_{k}": pitch for k in range(9)}
    settings = {**table, "mode": 2.0, "pairs_thrust_min": 2.0, "pairs_thrust_max": 10.0}
    profile = Record({"time": np.array([0.0, 30.0, 60.0]), "thrust_set": np.array([7.0, 3.0, 3.0])}, "steps")
    loop, course = ClosedLoop(BASE), Course.of(profile, 0.004, 15.0, rest=(4000.0, pitch))
    run = loop.run(loop.vectors({}, {}, settings), course)
    for end, thrust in ((len(run) // 2 - 2, 7.0), (-1, 3.0)):
        assert run["thrust"][end] == pytest.approx(thrust, abs=0.02)
        assert run["beta_ref"][end] == pytest.approx(pitch, abs=0.1)
