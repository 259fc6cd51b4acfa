"""Hidden effects: the common properties of all, and the response of each against closed forms."""

import numpy as np
import pytest
from builders import named, reference, simulator
from rig_commands import commands
from scipy.signal import lsim

from hil.physics import rig_model
from hil.physics.rig_model import FULL_RIG, POWERTRAIN, powertrain
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.kernel.types import no_step
from vpp_fmu.units import base_unit

HIDDEN = tuple(e for e in rig_model.library(commanded=True) if e.off is not None)
OUT = {s.name: k for k, s in enumerate(POWERTRAIN.outputs)}
each_effect = pytest.mark.parametrize("effect", HIDDEN, ids=lambda e: e.name)
sampled = pytest.mark.sampled("effect")
MODELS = {"throttle": (powertrain, POWERTRAIN), "speed": (rig_model.rig_model, FULL_RIG)}


def test_they_are_the_rigs_own():
    assert {e.name for e in HIDDEN} == {e.name for e in rig_model.library(commanded=False) if e.off is not None}
    assert not {e.step for e in HIDDEN if e.step is not no_step} & {e.step for e in LIBRARY}
    for build, _ in MODELS.values():
        with pytest.raises(KeyError, match="gremlins"):
            build(["gremlins"])


@each_effect
def test_it_declares_itself(effect):
    declared = {p.name: p for p in effect.parameters}
    assert set(effect.off) | set(effect.probe) <= set(declared)
    for p in declared.values():
        assert base_unit(p.unit) is not None
        assert p.minimum < p.maximum
        for value in (p.default, effect.off.get(p.name, p.default), effect.probe.get(p.name, p.default)):
            assert p.minimum <= value <= p.maximum, p.name
    for x in effect.states:
        assert base_unit(x.unit) is not None
    assert all(p.default == effect.off[p.name] for p in declared.values() if p.name in effect.off)


@sampled
@each_effect
def test_off_is_the_rig_without_it_to_the_bit(effect):
    inputs, steps = commands(POWERTRAIN, 300), np.full(299, 0.004)
    without = simulator(POWERTRAIN).simulate({}, inputs, steps)
    model = powertrain([effect.name])
    for values in ({}, named(effect, {**effect.probe, **effect.off})):
        np.testing.assert_array_equal(simulator(model).simulate(values, inputs, steps), without)


@sampled
@each_effect
def test_c_is_python_to_the_bit_and_the_probe_is_visible(effect):
    model, values = powertrain([effect.name]), named(effect, effect.probe)
    inputs, steps = commands(model, 700), np.random.default_rng(3).choice([0.004, 0.0013, 0.011], 699)
    shown = simulator(model).simulate(values, inputs, steps)
    np.testing.assert_array_equal(reference(model, values, inputs, steps), shown)
    moved = np.abs(shown - simulator(POWERTRAIN).simulate({}, inputs, steps))[:, :3].max(axis=0)
    assert (moved > [0.03, 3.0, 0.03]).any(), f"thrust, omega, beta differ by no more than {moved} N, rpm, deg"


def test_all_of_them_at_once_run_from_any_communication_step():
    model = rig_model.rig_model(e.name for e in HIDDEN)
    values = {k: v for e in HIDDEN for k, v in named(e, e.probe).items()} | {"rod_stuck.after": 1.5}
    inputs = commands(model, 200, seed=4)
    shown = simulator(model).simulate(values, inputs, np.full(199, 0.008))
    np.testing.assert_array_equal(reference(model, values, inputs, np.full(199, 0.008)), shown)
    fine = {n: np.repeat(c, 8)[: 199 * 8 + 1] for n, c in inputs.items()}
    finer = simulator(model).simulate(values, fine, np.full(199 * 8, 0.001))[::8]
    np.testing.assert_allclose(finer[:, 0], shown[:, 0], rtol=0, atol=1e-6)


def run(effects, values, throttle=0.45, beta=5.0, seconds=1.0, dt=0.001, kind="throttle"):
    """Outputs under held commands, or commands given as arrays of the record's length."""
    build, base = MODELS[kind]
    rows = round(seconds / dt) + 1
    first = "throttle" if kind == "throttle" else "omega_ref"
    inputs = {first: np.broadcast_to(float(throttle) if np.isscalar(throttle) else throttle, rows)}
    inputs["beta_ref"] = np.broadcast_to(float(beta) if np.isscalar(beta) else beta, rows)
    return simulator(build(effects) if effects else base).simulate(values, inputs, np.full(rows - 1, dt))


def step(before, after, at, rows):
    return np.where(np.arange(rows) < at, float(before), float(after))


def test_a_stuck_rod_stays_where_it_was():
    beta = step(0.0, 8.0, 100, 1001)
    y = run(["rod_stuck"], {"rod_stuck.after": 0.3}, beta=beta)[:, OUT["beta"]]
    free = run([], {}, beta=beta)[:, OUT["beta"]]
    np.testing.assert_array_equal(y[:300], free[:300])
    assert np.ptp(y[301:]) == 0.0
    assert 1.0 < y[-1] < 7.0
    assert free[-1] > 7.9


def test_the_dead_band_and_the_stop_band_leave_the_command_unreached():
    beta = step(0.0, 0.9, 100, 3001)
    y = run(["lac_command_deadband"], {"lac_command_deadband.half_width": 1.0}, beta=beta, seconds=3.0)
    assert np.ptp(y[:, OUT["beta"]]) == 0.0
    y = run(["lac_command_deadband"], {"lac_command_deadband.half_width": 1.0}, beta=step(0.0, 5.0, 100, 3001), seconds=3.0)
    assert y[-1, OUT["beta"]] == pytest.approx(171 * 30.0 / 1024, abs=1e-3)  # the LAC's count nearest to 5 deg
    y = run(["lac_stop_band"], {"lac_stop_band.half_width": 0.5}, beta=step(0.0, 5.0, 100, 3001), seconds=3.0)
    assert 4.5 <= y[-1, OUT["beta"]] < 5.0
    assert np.ptp(y[-500:, OUT["beta"]]) < 1e-6


def test_the_speed_limit_is_the_rods_greatest_rate():
    y = run(["rod_speed_limit"], {"rod_speed_limit.rate": 6.0}, beta=step(-5.0, 10.0, 100, 3001), seconds=3.0)
    assert np.diff(y[:, OUT["beta"]]).max() / 0.001 == pytest.approx(6.0, rel=1e-4)


def test_play_is_lost_when_the_rod_turns_round():
    beta = np.r_[step(0.0, 6.0, 100, 2000), np.full(2001, 0.0)]
    y = run(["linkage_play"], {"linkage_play.half_gap": 0.7}, beta=beta, seconds=4.0)
    assert y[1999, OUT["beta"]] == pytest.approx(6.0 - 0.7, abs=1e-3)
    assert y[-1, OUT["beta"]] == pytest.approx(0.7, abs=1e-3)
    assert y[-1, OUT["rod_ahead"]] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("effect", "column", "drives"), [("linkage_resonance", "beta", "rod_ahead"), ("stand_swing", "thrust", "thrust")]
)
def test_a_resonance_is_scipys_oscillator(effect, column, drives):
    values, beta = {f"{effect}.frequency": 5.0, f"{effect}.damping": 0.08}, step(0.0, 6.0, 100, 2001)
    y = run([effect], values, beta=beta, seconds=2.0)
    rigid = run([], {}, beta=beta, seconds=2.0)[:, OUT[drives]]
    w = 2.0 * np.pi * 5.0
    swung = lsim(([w * w], [1.0, 2.0 * 0.08 * w, w * w]), rigid - rigid[0], np.arange(2001) * 0.001)[1]
    assert np.abs(swung + rigid[0] - rigid).max() > 0.1
    np.testing.assert_allclose(y[:, OUT[column]], rigid[0] + swung, rtol=0, atol=2e-3)


def test_the_delay_moves_the_command():
    beta = step(0.0, 6.0, 100, 1001)
    late = run(["lac_command_delay"], {"lac_command_delay.delay": 0.08}, beta=beta)
    free = run([], {}, beta=beta)
    np.testing.assert_allclose(late[80:, OUT["beta"]], free[:-80, OUT["beta"]], rtol=0, atol=1e-12)


def test_the_supply_droops_with_its_current_and_with_the_charge_drawn():
    settled = run(["supply_droop"], {"supply_droop.resistance": 0.2}, throttle=0.5, beta=10.0)[-1]
    current, speed = settled[OUT["current"]], settled[OUT["omega"]] * np.pi / 30.0
    k = 30.0 / (np.pi * 550.0)
    assert 0.5 * (24.0 - 0.2 * 0.5 * current) == pytest.approx(0.07 * current + k * speed, rel=1e-9)
    y = run(["supply_droop"], {"supply_droop.discharge": 0.004}, throttle=0.5, beta=10.0, seconds=30.0, dt=0.01)
    lost = 0.004 * np.sum(0.5 * y[:-1, OUT["current"]]) * 0.01
    current, speed = y[-1, OUT["current"]], y[-1, OUT["omega"]] * np.pi / 30.0
    assert lost > 0.8
    assert 0.5 * (24.0 - lost) == pytest.approx(0.07 * current + k * speed, rel=2e-3)


def test_a_warm_motor_needs_more_throttle_for_its_speed():
    values = {"motor_heating.flux_loss": 0.1, "motor_heating.time_constant": 5.0}
    cold = run(["motor_heating"], {}, throttle=5000.0, beta=5.0, kind="speed", seconds=0.1)[-1]
    warm = run(["motor_heating"], values, throttle=5000.0, beta=5.0, kind="speed", seconds=40.0, dt=0.01)[-1]
    assert warm[1] == pytest.approx(cold[1], abs=0.5)  # the speed loop compensates it: thrust and speed are the same
    simulation = Simulation(powertrain(["motor_heating"]), values | {"motor_heating.time_constant": 1.0})
    simulation.start({"throttle": 0.4, "beta_ref": 5.0})
    simulation.advance({"throttle": 0.4, "beta_ref": 5.0}, 5.0)
    current, speed, heat = (simulation.states[n] for n in ("motor_current", "shaft_speed", "motor_heating.heat"))
    assert heat == pytest.approx((current / 20.0) ** 2, rel=0.02)
    k = 30.0 / (np.pi * 550.0) * (1.0 - 0.1 * heat)
    assert pytest.approx(0.07 * current + k * speed, rel=1e-6) == 0.4 * 24.0


def test_hunting_has_its_frequency_and_is_attenuated_by_the_motor():
    y = run(["speed_hunting"], {"speed_hunting.amplitude": 0.01, "speed_hunting.frequency": 2.0}, seconds=4.0)
    speed = y[1000:4000, OUT["omega"]] - y[1000:4000, OUT["omega"]].mean()
    spectrum = np.abs(np.fft.rfft(speed)) / 1500.0
    assert np.argmax(spectrum) == 6  # 2 Hz in 3 s
    pole = 0.08  # s: J R / k^2 with the load, see test_reduction
    assert spectrum[6] == pytest.approx(0.01 * 13_200.0 * 0.9 / np.hypot(1.0, 2.0 * np.pi * 2.0 * pole), rel=0.2)


def test_the_load_cell_scales_drifts_and_smooths():
    free = run([], {}, beta=step(0.0, 6.0, 100, 2001), seconds=2.0)[:, 0]
    beta, time = step(0.0, 6.0, 100, 2001), np.arange(2001) * 0.001
    scaled = run(["load_cell_gain"], {"load_cell_gain.gain": 1.07}, beta=beta, seconds=2.0)[:, 0]
    np.testing.assert_allclose(scaled, 1.07 * free, rtol=1e-12)
    values = {"load_cell_drift.final": 0.8, "load_cell_drift.time_constant": 1.5}
    drifted = run(["load_cell_drift"], values, beta=beta, seconds=2.0)[:, 0]
    np.testing.assert_allclose(drifted - free, 0.8 * (1.0 - np.exp(-time / 1.5)), rtol=0, atol=1e-9)
    smooth = run(["amplifier_low_pass"], {"amplifier_low_pass.time_constant": 0.05}, beta=beta, seconds=2.0)[:, 0]
    exact = lsim(([1.0], [0.05, 1.0]), free - free[0], time)[1] + free[0]
    np.testing.assert_allclose(smooth, exact, rtol=0, atol=2e-4)


def test_an_unbalanced_rotor_shakes_once_a_turn():
    y = run(["rotor_imbalance"], {"rotor_imbalance.amplitude": 0.2}, seconds=1.0)
    free = run([], {}, seconds=1.0)
    share = (free[:, OUT["omega"]] / 6000.0) ** 2
    np.testing.assert_allclose(y[:, 0] - free[:, 0], 0.2 * share * np.sin(2.0 * np.pi * free[:, OUT["angle"]]), atol=1e-9)
