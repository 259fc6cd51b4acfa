"""A learned term is an effect like any other: off, C equals Python, tangents, both FMUs; and the closed form of each shape."""

import numpy as np
import pytest
from builders import named, random_steps, reference, simulator, slope_errors, stepped

from vpp_fmu.export import native_fmu, python_fmu
from vpp_fmu.fmu import Fmu
from vpp_fmu.invariants import INVARIANTS, Trial
from vpp_fmu.kernel.learned import DRIVERS, PORTS, learned, placed
from vpp_fmu.kernel.plant import BASE, LIBRARY, plant
from vpp_fmu.units import base_unit

STEP = 0.004
SPANS = {"rpm": (2000.0, 6000.0), "deg": (-5.0, 10.0), "N": (0.0, 15.0), "rpm/s": (-4000.0, 4000.0), "deg/s": (-20.0, 20.0)}
TO_GO = {"rpm": (-2000.0, 2000.0), "deg": (-10.0, 10.0)}


def span(driver):
    """The range of a driver."""
    d = DRIVERS[driver]
    return (0.0, 8.0) if d.unit == "s" else (TO_GO if d.name.endswith("to_go") else SPANS)[d.unit]


def curve(port, driver, lag=None, times="", size=0.1):
    """A curve over a driver's range, with values up to a share of the port's limit."""
    low, high = span(driver)
    at, top = np.linspace(low, high, 4), size * PORTS[port].limit
    top *= {"": 1.0, "pitch": 15.0, "speed": 6000.0, "thrust": 15.0, "pitch/time": 30.0, "speed/time": 12000.0}[
        PORTS[port].scale
    ]
    values = dict(zip((f"at_{k}" for k in range(1, 5)), at.tolist(), strict=True))
    values |= dict(zip((f"value_{k}" for k in range(1, 5)), (top * np.array([0.6, 0.0, 0.3, -1.0])).tolist(), strict=True))
    return port, learned(f"curve_{port}", port, driver, "curve", values, span(driver), lag, times)


def shaped(port, driver, shape, lag=None, **values):
    """A term of another shape."""
    return port, learned(f"{shape}_{port}", port, driver, shape, values, span(driver), lag)


TERMS = {
    "pitch_command": curve("pitch_command", "thrust", lag=0.3),
    "pitch_rate": curve("pitch_rate", "pitch_to_go"),
    "pitch_rate_share": curve("pitch_rate_share", "thrust", size=0.05),
    "speed_command": curve("speed_command", "pitch", lag=1.0),
    "speed_command_share": curve("speed_command_share", "thrust", lag=3.0),
    "motor_acceleration": curve("motor_acceleration", "speed_to_go"),
    "motor_acceleration_share": curve("motor_acceleration_share", "thrust", size=0.05),
    "rotor_speed": curve("rotor_speed", "pitch_rate", lag=0.1),
    "effective_pitch": curve("effective_pitch", "speed", lag=1.0),
    "thrust": curve("thrust", "speed_rate", times="speed_squared"),
    "thrust_share": curve("thrust_share", "time"),
    "reading": curve("reading", "thrust"),
    "line": shaped("thrust", "pitch_rate", "line", gain=0.02),
    "square": shaped("thrust", "pitch_rate", "square", gain=0.002),
    "hinge": shaped("reading", "thrust", "hinge", gain=-0.2, knee=5.0, side=1.0),
    "threshold": shaped("thrust_share", "thrust", "threshold", gain=-0.1, level=5.0),
    "saturation": shaped("pitch_rate", "pitch_to_go", "saturation", gain=-1.5, limit=0.5),
    "sign": shaped("pitch_rate", "pitch_to_go", "sign", gain=-1.5, width=0.5),
    "play": shaped("reading", "thrust", "play", gain=1.0, half_gap=0.2),
    "hold": shaped("speed_command", "speed_command", "hold", gain=1.0, half_width=200.0),
    "relay": shaped("thrust_share", "thrust", "relay", lag=0.1, gain=-0.1, upper=7.0, lower=4.0),
    "sine": shaped("thrust", "time", "sine", in_phase=0.3, quadrature=0.1, frequency=1.3),
}
each_term = pytest.mark.parametrize("term", TERMS)
sampled = pytest.mark.sampled("term")
JUMPS = ("threshold", "relay", "hold")
"""Discontinuous in their driver: at a crossing the result depends on the step."""


def model_of(term):
    """(the plant with a term, the term's effect)."""
    port, effect = TERMS[term]
    return plant([effect.name], placed(LIBRARY, effect, PORTS[port])), effect


@sampled
@each_term
@pytest.mark.parametrize("name", ["declares itself", "C is Python", "the probe shows", "finite at every bound"])
def test_every_term_keeps_the_invariants_of_effects(term, name):
    port, effect = TERMS[term]
    INVARIANTS[name](Trial(effect, placed(LIBRARY, effect, PORTS[port])))
    assert all(base_unit(p.unit) is not None for p in effect.parameters)


@sampled
@each_term
@pytest.mark.parametrize("dt", [STEP, 0.0073])
def test_off_is_the_model_without_it_to_the_bit(term, dt):
    model, effect = model_of(term)
    inputs, steps = random_steps(300, 20), np.full(299, dt)
    without = simulator(BASE).simulate({}, inputs, steps)
    if effect.largest_step < dt:  # split into the steps that the effect needs; the plant alone is exact at any step
        wanted = int(np.ceil(dt / effect.largest_step - 1e-9))
        fine = {n: np.repeat(c, wanted)[: 299 * wanted + 1] for n, c in inputs.items()}
        without = simulator(BASE).simulate({}, fine, np.full(299 * wanted, dt / wanted))[::wanted]
    for values in (named(effect, effect.off), named(effect, {**effect.probe, **effect.off})):
        np.testing.assert_allclose(simulator(model).simulate(values, inputs, steps), without, rtol=1e-12, atol=1e-9)
        np.testing.assert_array_equal(reference(model, values, inputs, steps), simulator(model).simulate(values, inputs, steps))


@pytest.mark.parametrize(("port", "u", "output"), [("pitch_rate_share", "beta", 2), ("motor_acceleration_share", "omega", 1)])
def test_a_lag_whose_rate_is_scaled_stays_within_its_commands(port, u, output):
    """A first-order lag moves towards its target. With a factor of its rate below zero it would grow without limit."""
    _, effect = curve(port, "time", size=0.9)  # the factor falls to 1 - 0.9 * 3 = -1.7
    model = plant([effect.name], placed(LIBRARY, effect, PORTS[port]))
    inputs = random_steps(5000, 150)
    shown = simulator(model).simulate(named(effect, effect.probe), inputs, np.full(4999, STEP))[:, output]
    commands = inputs[f"{u}_ref"]
    span = np.ptp(commands)
    assert commands.min() - 0.01 * span <= shown.min() <= shown.max() <= commands.max() + 0.01 * span


@sampled
@pytest.mark.parametrize("term", [t for t in TERMS if t not in JUMPS])
def test_the_communication_step_does_not_matter(term):
    model, effect = model_of(term)
    inputs, values = random_steps(2000, 150), named(effect, effect.probe)
    at_8_ms = simulator(model).simulate(values, inputs, np.full(1999, 0.008))
    for split in (2, 8):
        fine = {name: np.repeat(column, split)[: 1999 * split + 1] for name, column in inputs.items()}
        shown = simulator(model).simulate(values, fine, np.full(1999 * split, 0.008 / split))[::split]
        change = np.abs(at_8_ms - simulator(BASE).simulate({}, inputs, np.full(1999, 0.008))).max(axis=0)
        error = np.abs(shown - at_8_ms).max(axis=0)
        assert error[0] < 2e-3 + 0.005 * change[0], (error, change)


@sampled
@each_term
def test_tangents_are_central_differences_away_from_kinks(term):
    model, effect = model_of(term)
    wrt = (*(effect.full(p.name) for p in effect.parameters if not p.choices), "tau_beta_1", "c21")
    errors = slope_errors(model, named(effect, effect.probe), wrt, random_steps(2000, 150), np.full(1999, STEP), smooth=-1.0)
    assert max(errors.values()) < 3e-3, errors


def test_both_fmus_give_the_same_numbers(tmp_path):
    model, effect = model_of("relay")
    values, inputs = named(effect, effect.probe), random_steps(300, 40)
    shown = simulator(model).simulate(values, inputs, np.full(299, STEP))
    for make, name in ((python_fmu, "a.fmu"), (native_fmu, "b.fmu")):
        (tmp_path / name).write_bytes(make(model, values))
        fmu = Fmu(tmp_path / name)
        np.testing.assert_array_equal(stepped(fmu, inputs, STEP), shown)
        fmu.close()


def settled(term, omega=4000.0, beta=4.0, **changes):
    """(thrust, speed, pitch) with the term and without it, after a minute on one command."""
    model, effect = model_of(term)
    inputs, steps = {"omega_ref": np.full(61, omega), "beta_ref": np.full(61, beta)}, np.ones(60)
    values = named(effect, effect.probe) | {effect.full(n): v for n, v in changes.items()}
    shown = simulator(model).simulate(values, inputs, steps)
    return shown, simulator(BASE).simulate({}, inputs, steps)[-1]


def test_a_curve_is_straight_between_its_knots_and_flat_beyond():
    """On the reading over thrust: the knots are 0, 5, 10, 15 N, the values 0.45, 0, 0.225, -0.75 N."""
    for omega, beta in ((2000.0, -5.0), (4000.0, 4.0), (6000.0, 8.0), (6000.0, 20.0)):
        shown, base = settled("reading", omega, beta)
        expected = np.interp(base[0], [0.0, 5.0, 10.0, 15.0], [0.45, 0.0, 0.225, -0.75])
        assert shown[-1, 0] - base[0] == pytest.approx(expected, abs=1e-9)


def test_a_term_in_a_feedback_loop_starts_settled():
    """A term whose driver depends on the term itself, through a lag of seconds: no transient at the start."""
    shown, base = settled("speed_command_share", 5500.0)
    assert np.abs(shown[:, 0] - shown[-1, 0]).max() < 1e-4
    assert abs(shown[-1, 0] - base[0]) > 0.01


def test_hinge_threshold_and_saturation_at_rest():
    thrust = settled("hinge")[1][0]
    assert settled("hinge")[0][-1, 0] == pytest.approx(thrust - 0.2 * max(thrust - 5.0, 0.0), abs=1e-9)
    assert settled("threshold", 6000.0, 8.0)[0][-1, 0] == pytest.approx(0.9 * settled("threshold", 6000.0, 8.0)[1][0], rel=1e-9)
    assert settled("threshold", 2000.0, 0.0)[0][-1, 0] == settled("threshold", 2000.0, 0.0)[1][0]
    np.testing.assert_allclose(settled("saturation")[0][-1], settled("saturation")[1], atol=1e-6)


def test_a_play_loses_its_gap_when_the_driver_turns():
    model, effect = model_of("play")
    t = np.arange(0.0, 40.0, STEP)
    inputs = {"omega_ref": np.full(len(t), 4500.0), "beta_ref": np.where(t < 10.0, 0.0, np.where(t < 25.0, 6.0, 2.0))}
    shown = simulator(model).simulate(named(effect, effect.probe), inputs, np.full(len(t) - 1, STEP))[:, 0]
    lost = shown - simulator(BASE).simulate({}, inputs, np.full(len(t) - 1, STEP))[:, 0]
    assert lost[t < 10.0].max() == lost[0] == 0.0
    assert lost[np.searchsorted(t, 24.0)] == pytest.approx(-0.2, abs=1e-9)
    assert lost[-1] == pytest.approx(0.2, abs=1e-9)


def test_a_sine_is_the_sine():
    model, effect = model_of("sine")
    inputs, steps = random_steps(3000, 100), np.full(2999, STEP)
    shown = simulator(model).simulate(named(effect, effect.probe), inputs, steps)
    added = (shown - simulator(BASE).simulate({}, inputs, steps))[:, 0]
    phase = 2.0 * np.pi * 1.3 * STEP * np.arange(3000)
    np.testing.assert_allclose(added[1:], (0.3 * np.sin(phase) + 0.1 * np.cos(phase))[1:], atol=1e-9)
