"""Properties of every optional effect in the library, in each of its forms; a new effect is tested here without an edit."""

from dataclasses import replace
from functools import reduce
from itertools import product

import numpy as np
import pytest
from builders import ALL_ON, OPTIONAL, PROBES, named, random_steps, reference, simulator, stepped
from scipy.signal import lsim

from vpp_fmu.export import python_fmu
from vpp_fmu.fmu import Fmu
from vpp_fmu.invariants import INVARIANTS, Trial
from vpp_fmu.kernel.plant import BASE, LIBRARY, plant
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.kernel.types import Effect, Parameter, Signal, State

STEP = 0.004
FORMS = [
    pytest.param(
        replace(e, probe={**e.probe, **dict(zip(names, values, strict=True))}), id="-".join([e.name, *map(str, values)])
    )
    for e in OPTIONAL
    for names in [[p.name for p in e.parameters if p.choices]]
    for values in product(*(p.choices for p in e.parameters if p.choices))
]


@pytest.mark.sampled("effect")
@pytest.mark.parametrize("effect", FORMS)
@pytest.mark.parametrize("name", INVARIANTS)
def test_every_form_of_an_effect_keeps_every_invariant(effect, name):
    INVARIANTS[name](Trial(effect, LIBRARY))


WARMING = {"thrust_gain_drift", "sensor_drift", "rotor_vibration"}


@pytest.mark.sampled("effect")
@pytest.mark.parametrize("effect", [p for p in FORMS if p.values[0].name not in WARMING])
def test_from_a_settled_start_nothing_moves(effect):
    model, values = plant([effect.name]), named(effect, effect.probe)
    for omega, beta in ((5900.0, 9.5), (2500.0, -4.5), (4000.0, 3.3)):
        still = {"omega_ref": omega, "beta_ref": beta} | {u.name: 22.0 for u in effect.inputs}
        inputs = {name: np.full(6, value) for name, value in still.items()}
        shown = simulator(model).simulate(values, inputs, np.array([1e-6, 0.001, STEP, 0.05, 2.0]))
        np.testing.assert_allclose(shown, np.tile(shown[0], (6, 1)), rtol=1e-13, atol=1e-12)


@pytest.mark.parametrize("effect", [e for e in OPTIONAL if e.contains], ids=lambda e: e.name)
def test_a_contained_effect_is_a_special_case(effect):
    for name, shared in effect.contains.items():
        (special,) = (e for e in OPTIONAL if e.name == name)
        values = named(special, special.probe)
        same = {effect.full(own): values[special.full(its)] for own, its in shared.items()}
        inputs, steps = random_steps(3000, 200), np.full(2999, STEP)
        shown, without = (simulator(plant(e)).simulate(v, inputs, steps) for e, v in (([name], values), ([], {})))
        wider = simulator(plant([effect.name])).simulate(named(effect, effect.off) | same, inputs, steps)
        assert np.abs(wider - shown)[:, 0].max() < 0.02 * np.abs(shown - without)[:, 0].max()


def test_with_all_effects_the_communication_step_does_not_matter():
    """Commands over the whole range on a grid of 8 ms, some in every row, stepped by 1, 2, 4 and 8 ms."""
    slow, fast = random_steps(2000, 150, model=ALL_ON), random_steps(200, 1, model=ALL_ON)
    coarse = {name: np.r_[slow[name], fast[name]] for name in slow}
    at_8_ms = simulator(ALL_ON).simulate(PROBES, coarse, np.full(2199, 0.008))
    for split in (2, 4, 8):
        fine = {name: np.repeat(column, split)[: 2199 * split + 1] for name, column in coarse.items()}
        shown = simulator(ALL_ON).simulate(PROBES, fine, np.full(2199 * split, 0.008 / split))[::split]
        np.testing.assert_allclose(shown[:, 0], at_8_ms[:, 0], rtol=0, atol=1e-3)


def test_deadband_ignores_changes_up_to_its_half_width():
    simulation = Simulation(plant(["pitch_command_deadband"]), {"pitch_command_deadband.half_width": 1.5})
    simulation.start({"omega_ref": 4000.0, "beta_ref": 2.0})
    reached = []
    for command in (3.5, 0.5, 3.500001, 2.25, 5.0, 5.001, 3.75, 3.5, 5.0):
        reached.append(simulation.advance({"omega_ref": 4000.0, "beta_ref": command}, 100.0)["beta"])
    assert reached == pytest.approx([2.0, 2.0, 3.500001, 3.500001, 3.500001, 5.001, 5.001, 3.5, 3.5], abs=1e-12)


@pytest.mark.parametrize(
    ("name", "step", "output", "commands", "executed"),
    [
        ("pitch_command_resolution", 0.4, "beta", (1.0, 1.19, 1.21, -0.21, -0.19, 5.9), (0.8, 1.2, 1.2, -0.4, 0.0, 6.0)),
        ("speed_command_resolution", 50.0, "omega", (2024.0, 2026.0, 4975.0, 4976.0), (2000.0, 2050.0, 5000.0, 5000.0)),
    ],
)
def test_a_command_is_executed_as_the_nearest_multiple_of_the_step_from_0_on(name, step, output, commands, executed):
    """Ties go to the even multiple: 1.0 / 0.4 is 2.5, 4975 / 50 is 99.5."""
    simulation, reached = Simulation(plant([name]), {f"{name}.step": step}), []
    held = {"omega_ref": 4000.0, "beta_ref": 2.0}
    simulation.start(held)
    for command in commands:
        reached.append(simulation.advance(held | {f"{output}_ref": command}, 100.0)[output])
    assert reached == pytest.approx(executed, abs=1e-9)


@pytest.mark.parametrize("gain", [25.0, -80.0])
def test_coupling_is_the_transfer_function_under_scipy(gain):
    """From pitch command to speed: -gain s / ((0.207 s + 1)(0.374 s + 1)(0.172 s + 1)(0.053 s + 1))."""
    inputs, time = random_steps(1000, 200), np.arange(1000) * 0.004
    model, steps = plant(["pitch_speed_coupling"]), np.full(999, 0.004)
    shown = reference(model, {"pitch_speed_coupling.gain": gain}, inputs, steps) - reference(BASE, {}, inputs, steps)
    lags = reduce(np.polymul, ([tau, 1.0] for tau in (0.207, 0.374, 0.172, 0.053)))
    moved = lsim(([-gain, 0.0], lags), inputs["beta_ref"] - inputs["beta_ref"][0], time, interp=False)[1]
    assert np.abs(moved).max() > 200.0
    np.testing.assert_allclose(shown[:, 1], moved, rtol=0, atol=4e-4 * abs(gain))
    np.testing.assert_allclose(shown[:, 2], 0.0, atol=1e-12)


@pytest.mark.parametrize("inertia", [0.05, 0.25, 3.0])
@pytest.mark.parametrize(
    ("name", "u", "lags"), [("pitch_overshoot", 2, (0.207, 0.374)), ("speed_overshoot", 1, (0.172, 0.053))]
)
def test_overshoot_is_the_transfer_function_under_scipy(name, u, lags, inertia):
    """From command to channel: 1 / ((tau_2 s + 1)(inertia tau_1^2 s^2 + tau_1 s + 1))."""
    (outer, inner), command = lags, ("omega_ref", "beta_ref")[u - 1]
    inputs, time = random_steps(1000, 200), np.arange(1000) * 0.004
    shown = reference(plant([name]), {f"{name}.inertia": inertia}, inputs, np.full(999, 0.004))[:, u]
    poles = np.polymul([inner, 1.0], [inertia * outer**2, outer, 1.0])
    moved = lsim(([1.0], poles), inputs[command] - inputs[command][0], time, interp=False)[1]
    np.testing.assert_allclose(shown - inputs[command][0], moved, rtol=0, atol=2e-4 * np.ptp(inputs[command]))


@pytest.mark.parametrize(("frequency", "damping"), [(3.0, 0.05), (10.0, 0.3), (1.0, 0.005)])
def test_stand_resonance_is_the_oscillator_of_scipy(frequency, damping):
    inputs, steps = random_steps(1000, 200), np.full(999, 0.004)
    values = {"stand_resonance.frequency": frequency, "stand_resonance.damping": damping}
    shown = reference(plant(["stand_resonance"]), values, inputs, steps)[:, 0]
    fine = {name: np.repeat(column, 16)[:15985] for name, column in inputs.items()}
    thrust, w0 = simulator(BASE).simulate({}, fine, np.full(15984, 0.00025))[:, 0], 2.0 * np.pi * frequency
    swung = lsim(([w0**2], [1.0, 2.0 * damping * w0, w0**2]), thrust - thrust[0], np.arange(15985) * 0.00025)[1]
    np.testing.assert_allclose(shown, thrust[0] + swung[::16], rtol=0, atol=1e-3)


@pytest.mark.parametrize(("offset", "rate", "time_constant"), [(0.1, 0.003, 1000.0), (-1.0, -0.03, 10.0), (0.5, 0.0, 30.0)])
def test_drift_is_the_closed_form(offset, rate, time_constant):
    steps = np.random.default_rng(5).uniform(0.001, 1.0, 200)
    inputs, t = random_steps(201, 20), np.r_[0.0, np.cumsum(steps)]
    values = {"sensor_drift.offset": offset, "sensor_drift.rate": rate, "sensor_drift.time_constant": time_constant}
    drifted = reference(plant(["sensor_drift"]), values, inputs, steps) - reference(BASE, {}, inputs, steps)
    exact = offset + rate * time_constant * (1.0 - np.exp(-t / time_constant))
    np.testing.assert_allclose(drifted[:, 0], exact, rtol=0, atol=1e-10)
    assert not drifted[:, 1:].any()


def _gust(ops, s, x, p, dt):
    wake = ops.lag(x.wake, s.thrust * ops.tanh(s.crosswind / 10.0), p.time_constant, dt)
    return {"thrust": s.thrust - p.share * wake}, {"wake": wake}


GUST = Effect(
    "gust",
    "an effect that the package has never heard of, with an input of its own",
    _gust,
    parameters=(
        Parameter("share", "1", 0.0, 0.0, 1.0, "share of the thrust that a strong crosswind takes"),
        Parameter("time_constant", "s", 0.4, 0.01, 10.0, "time constant of the wake"),
    ),
    states=(State("wake", "N", "what the wake takes", lambda ops, s, p: s.thrust * ops.tanh(s.crosswind / 10.0)),),
    off={"share": 0.0},
    probe={"share": 0.2},
    inputs=(Signal("crosswind", "1", "strength of the wind", 0.0, 100.0, 8.0, start=2.0),),
)


def test_a_new_effect_runs_everywhere_without_an_edit(tmp_path):
    model = plant(["gust", "pitch_delay"], (*LIBRARY, GUST))
    values = {"gust.share": 0.3, "pitch_delay.delay": 0.0237}
    inputs, steps = random_steps(500, 40, model=model), np.full(499, STEP)
    shown = reference(model, values, inputs, steps)
    np.testing.assert_array_equal(simulator(model).simulate(values, inputs, steps), shown)
    tangents = simulator(model, ("gust.share",)).sensitivities(values, inputs, steps)[1][:, 0, 0]
    rest = reference(model, {**values, "gust.share": 0.0}, inputs, steps)
    np.testing.assert_allclose(tangents, (shown - rest)[:, 0] / 0.3, rtol=0, atol=1e-12)

    path = tmp_path / "gust.fmu"
    path.write_bytes(python_fmu(model, values))
    fmu = Fmu(path)
    assert float(fmu.variables["crosswind"].start) == 2.0
    np.testing.assert_array_equal(stepped(fmu, inputs, STEP), shown)
    fmu.close()
