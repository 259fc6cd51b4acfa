"""Compiled and generated code over whole records: the bits of the functions, derivatives, and operation without a compiler."""

import subprocess
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np
import pytest
from builders import ALL_ON, OPTIONAL, PROBES, TWO_DELAYS, random_steps, reference, simulator, slope_errors

from identification.diagnose.initial_model import always_on
from vpp_fmu.errors import SimulationFailed
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import BASE, LIBRARY, plant
from vpp_fmu.kernel.signals import OMEGA_REF
from vpp_fmu.kernel.types import Effect, Model, Parameter, Signal, State
from vpp_fmu.native import Simulator, compiler
from vpp_fmu.native import simulator as simulators
from vpp_fmu.native.adjoint import Adjoint
from vpp_fmu.record import Record
from vpp_fmu.tracer import LANES

PITCH, SPEED = "pitch_delay.delay", "test_speed_delay.delay"
UNEVEN = np.random.default_rng(4).choice([1e-4, 0.0013, 0.004, 0.0047, 0.031], 1000)
MODELS = {"plain": (BASE, {}), "all on": (ALL_ON, PROBES), "two delays": (TWO_DELAYS, {PITCH: 0.0413, SPEED: 0.0087})}
LATE = {"reading_delay": "delay", "speed_reading_delay": "delay", "row_clock": "age"}


def test_compiled_steps_are_the_functions_to_the_bit(long_run):
    commands, steps, exact = long_run
    np.testing.assert_array_equal(simulator(ALL_ON).simulate(PROBES, commands, steps), exact)
    assert np.isfinite(exact).all()
    assert np.ptp(exact, axis=0).min() > 3.0


@pytest.mark.parametrize("model", MODELS)
def test_uneven_steps_are_the_functions_to_the_bit(model, request, recwarn):
    model, values = MODELS[model]
    inputs, steps = random_steps(201, 30, model=model), UNEVEN[:200]
    exact = reference(model, values, inputs, steps)
    np.testing.assert_array_equal(Simulator(model).simulate(values, inputs, steps), exact)
    request.getfixturevalue("no_compiler")
    np.testing.assert_array_equal(Simulator(model).simulate(values, inputs, steps), exact)


def test_each_model_has_its_own_inputs_of_a_record():
    """A record keeps the inputs of a model that ran on it: they are those of this model, and of these steps, only."""
    inputs, steps = random_steps(401, 30), UNEVEN[:400]
    record = Record({"time": np.append(0.0, np.cumsum(steps)), **inputs}, "a test")
    for effects in ((), ("supply_voltage",), ("row_clock",), ("row_clock", "supply_voltage")):
        made, on = Simulator(plant(effects)), {n: v for n, v in PROBES.items() if n.split(".")[0] in effects}
        for given in (record.run, (record.run[0], 2.0 * steps, 0.0)):
            fresh = made.simulate(on, dict(record.columns), *given[1:])
            for _ in range(2):
                np.testing.assert_array_equal(made.simulate(on, *given), fresh)


@pytest.mark.sampled("effect")
@pytest.mark.parametrize("effect", OPTIONAL)
def test_parallel_runs_equal_single_runs_to_the_bit(effect):
    """More runs than one bundle, with different longest steps, delayed inputs, and late commands."""
    model = plant([effect.name])
    inputs, made = random_steps(301, 60, model=model), Simulator(model)
    probes = {effect.full(n): v for n, v in effect.probe.items()}
    off = {effect.full(n): v for n, v in effect.off.items()}
    points = [{**probes, "tau_omega_1": 0.2 + 0.01 * k} for k in range(LANES + 1)] + [off]
    for steps, late in ((UNEVEN[:300], 0.0), (UNEVEN[:300], 0.3), (np.full(300, 0.004), 0.3)):
        found = made.simulate_all(points, inputs, steps, late)
        assert found.shape == (301, len(made.outputs), len(points))
        for k, point in enumerate(points):
            np.testing.assert_array_equal(found[:, :, k], made.simulate(point, inputs, steps, late))


@pytest.mark.parametrize("compiler", [True, False])
def test_a_late_command_is_a_row_split_by_hand(compiler, request, recwarn):
    """With a measured input, which acts from the beginning of its row, and a delay; in the simulation and the adjoint."""
    model, late = plant(["supply_voltage", "pitch_delay", "pitch_backlash"]), 0.3
    values = {PITCH: 0.0413, "pitch_backlash.half_gap": 0.3}
    inputs = random_steps(301, 7, model=model) | {"voltage": np.random.default_rng(3).uniform(20.0, 25.0, 301)}
    split, steps, first = {name: [] for name in inputs}, [], []
    for row, step in enumerate([*UNEVEN[:300], None]):
        first.append(len(steps))
        moved = step is not None and row and any(inputs[n][row] != inputs[n][row - 1] for n in ("omega_ref", "beta_ref"))
        for name, column in inputs.items():
            before = column[row] if name == "voltage" else column[row - 1]
            split[name] += [before, column[row]] if moved else [column[row]]
        steps += [late * step, (1.0 - late) * step] if moved else [step]
    assert len(steps) > 340
    split = {name: np.array(column) for name, column in split.items()}
    if not compiler:
        request.getfixturevalue("no_compiler")
    made = Simulator(model, ("tau_beta_1", PITCH))
    outputs, tangents = made.sensitivities(values, split, np.array(steps[:-1]))
    for one, other in zip(made.sensitivities(values, inputs, UNEVEN[:300], late), (outputs, tangents), strict=True):
        np.testing.assert_array_equal(one, other[first])
    if compiler:
        tape, weights = Adjoint(model, made.wrt).record(values, inputs, UNEVEN[:300], late), np.ones(outputs[first].shape)
        np.testing.assert_array_equal(tape.outputs, outputs[first])
        np.testing.assert_allclose(tape.pull_back(weights), tangents[first].sum(axis=(0, 1)), rtol=1e-9)


@pytest.mark.parametrize("compiler", [True, False])
def test_simulation_in_pieces_equals_the_whole_run(compiler, request, recwarn):
    """Outputs and derivatives, in pieces of any length."""
    if not compiler:
        request.getfixturevalue("no_compiler")
    model, wrt = plant(["pitch_delay", "pitch_backlash"]), ("tau_beta_1", "pitch_delay.delay")
    inputs, values = random_steps(1001, 60, model=model), {"pitch_delay.delay": 0.0413, "pitch_backlash.half_gap": 0.3}
    simulator = Simulator(model, wrt)
    whole = simulator.sensitivities(values, inputs, UNEVEN)
    for rows in (1, 7, 250, 1000, 1001, 5000):
        parts = [(y.copy(), d.copy()) for _, y, d in simulator.pieces(values, inputs, UNEVEN, rows=rows)]
        for one, together in zip(whole, zip(*parts, strict=True), strict=True):
            np.testing.assert_array_equal(np.concatenate(together), one)


def off_by(model, values, inputs, steps, wrt):
    """For each parameter the largest distance from the numeric derivative, as a share of its size."""
    values = model.values(values)
    shown, _ = simulator(model, tuple(wrt)).sensitivities(values, inputs, steps)
    for plain in (simulator(model), simulator(model, tuple(wrt))):
        np.testing.assert_array_equal(shown, plain.simulate(values, inputs, steps))
    return slope_errors(model, values, wrt, inputs, steps)


@pytest.mark.parametrize(("model", "even"), [("plain", True), ("plain", False), ("two delays", False)])
def test_sensitivities_are_central_differences(model, even):
    """In every base parameter and every delay; test_effects covers the parameters of each effect."""
    model, values = MODELS[model]
    uneven = np.random.default_rng(5).uniform(5e-4, 0.03, 2000)
    inputs, steps = random_steps(2001, 150, model=model), np.full(2000, 0.004) if even else uneven
    wrt = [p.name for p in BASE.parameters] + [name for _, name in model.delays]
    shares = off_by(model, values, inputs, steps, wrt)
    assert max(shares.values()) < 3e-3, shares


@pytest.mark.parametrize("without", ["late readings", "delayed commands"])
def test_sensitivities_with_all_effects_on_are_central_differences(without):
    """At even steps: with long uneven ones thresholds switch so often that no difference quotient is valid.

    A late reading interpolates linearly over each piece of a step. A delayed command that begins to act cuts a step in two, and
    the place of the cut changes the interpolation error. A difference quotient in the delay includes the slope of that error,
    2 % of the whole; the tangent, that of the exact response, does not. So each kind is tested without the other.
    """
    cut = {*LATE, "pitch_overshoot", "speed_overshoot"}  # an overshoot's input is linear over a piece, too
    left = [e for e in OPTIONAL if not (e.name in cut if without == "late readings" else e.delays)]
    model = plant(e.name for e in left)
    values = {name: value for name, value in {**PROBES, PITCH: 0.0413}.items() if name in model.values()}
    inputs, steps = random_steps(2001, 150, model=model), np.full(2000, 0.004)
    own = [f"{e.name}.{LATE[e.name]}" for e in left if e.name in LATE]
    wrt = [p.name for p in BASE.parameters][::3] + own + [name for _, name in model.delays]  # all compile for long
    assert len(own) + len(model.delays) == (2 if without == "late readings" else 3)
    shares = off_by(model, values, inputs, steps, wrt)
    assert max(shares.values()) < 3e-3, shares


def test_without_a_compiler_the_numbers_are_the_same_and_one_warning_is_given(request):
    period, count = Parameter("period", "s", 0.031, 1e-3, 1.0, "sample time"), State("count", "1", "samples", 0.0)
    counter = Effect("counter", "counts samples", _counts, (period,), (count,), sample_time="period")
    counting = Model("Counting", "a sampled effect", (OMEGA_REF,), (Signal("count", "1", "samples", 0.0, 1e9),), (counter,))
    models = (ALL_ON, PROBES, ("tau_beta_1", PITCH)), (BASE, {}, ("c20",)), (CONTROLLER, {}, ("ki_omega",)), (counting, {}, ())
    noise = {"thrust_set": np.full(500, 9.0), "thrust": np.random.default_rng(0).normal(9.0, 1.0, 500)}
    inputs, steps = random_steps(500, 40, model=ALL_ON) | noise, np.full(499, 0.0043)
    compiled = [Simulator(model, wrt).sensitivities(values, inputs, steps) for model, values, wrt in models]
    request.getfixturevalue("no_compiler")
    with pytest.warns(RuntimeWarning, match="compiler") as said:
        generated = [Simulator(model, wrt).sensitivities(values, inputs, steps) for model, values, wrt in models]
    assert len(said) == 1
    for (shown, tangents), (shown_without, tangents_without) in zip(compiled, generated, strict=True):
        np.testing.assert_array_equal(shown_without, shown)
        np.testing.assert_array_equal(tangents_without, tangents)
        assert tangents.any() or not tangents.size
    assert generated[-1][0][-1, 0] == np.ceil(499 * 0.0043 / 0.031)


def _counts(ops, s, x, p, dt):
    return {"count": x.count + 1.0}


@pytest.fixture
def own_cache(monkeypatch, tmp_path):
    """A compiler cache of this test alone."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(Model, "memo", property(lambda model: {}))  # a process's own memory must not serve
    monkeypatch.setattr(simulators, "_runner", simulators._runner.__wrapped__)
    monkeypatch.setattr(simulators, "_any_runner", WeakKeyDictionary())
    compiler.cache_folder.cache_clear()
    yield tmp_path / "cache" / "vpp-fmu"
    compiler.cache_folder.cache_clear()


def test_compiled_models_are_cached(own_cache, monkeypatch):
    inputs, steps = random_steps(50, 5), np.full(49, 0.004)
    first = Simulator(BASE).simulate({}, inputs, steps)
    kept = list(own_cache.iterdir())
    assert len(kept) == 1
    Simulator(plant(["pitch_delay"]))
    assert len(list(own_cache.iterdir())) == 2
    monkeypatch.setattr(subprocess, "run", None)  # compiling again would fail
    np.testing.assert_array_equal(Simulator(BASE).simulate({}, inputs, steps), first)


def test_a_model_with_sensitivities_serves_without_them(own_cache):
    """One compiled model serves both: the outputs are the same, and without parameters it writes no derivatives."""
    inputs, steps = random_steps(50, 5), np.full(49, 0.004)
    model, memory = plant(["pitch_delay"]), np.full(50, 7.0)
    both = Simulator(model, [PITCH]).simulate({PITCH: 0.01}, inputs, steps)
    none = np.ndarray((50, 0), buffer=memory)
    np.testing.assert_array_equal(Simulator(model).simulate({PITCH: 0.01}, inputs, steps, tangents={0: none}), both)
    assert (memory == 7.0).all()
    assert len(list(own_cache.iterdir())) == 1


def test_a_user_defined_effect_with_the_name_of_a_traced_one_is_traced_anew(own_cache, monkeypatch):
    inputs, steps, name = random_steps(50, 5), np.full(49, 0.004), "sensor_gain"
    values = {f"{name}.gain": 1.2}
    theirs = Simulator(plant([name])).simulate(values, inputs, steps)

    def squared(ops, s, x, p, dt):
        return {"thrust": s.thrust * p.gain * p.gain}, {}

    own = [replace(e, step=squared, declared=None) if e.name == name else e for e in LIBRARY]
    np.testing.assert_allclose(Simulator(plant([name], own)).simulate(values, inputs, steps)[:, 0], 1.2 * theirs[:, 0])
    monkeypatch.setattr(simulators, "trace", None)  # tracing again would fail
    np.testing.assert_array_equal(Simulator(plant([name])).simulate(values, inputs, steps), theirs)


def test_an_effect_that_is_always_on_is_not_taken_for_one_that_may_be_off():
    """It takes short steps at any size; the other one takes whole rows if it is off."""
    on = tuple(always_on(e) if e.name == "pitch_stall_latch" else e for e in LIBRARY)
    inputs, steps = random_steps(201, 20), np.full(200, 0.02)
    for model in (plant([], on), plant(["pitch_stall_latch"])):
        values = model.values({})
        assert np.array_equal(Simulator(model).simulate(values, inputs, steps), reference(model, values, inputs, steps))


@pytest.mark.parametrize(("rows", "steps"), [((10, 10), 10), ((10, 10), 8), ((1, 1), 1), ((0, 0), 0), ((10, 9), 9)])
def test_wrong_lengths_fail_by_name(rows, steps):
    inputs = {"omega_ref": np.full(rows[0], 4000.0), "beta_ref": np.full(rows[1], 5.0)}
    with pytest.raises(SimulationFailed, match="VppPlant"):
        simulator(BASE).simulate({}, inputs, np.full(steps, 0.004))


def test_more_step_lengths_than_are_kept_are_the_functions_to_the_bit():
    steps = np.tile(np.random.default_rng(61).uniform(0.017, 0.033, 1500), 2)
    inputs, points = random_steps(3001, 62, model=BASE), [{"tau_beta_1": 0.1 + 0.01 * k} for k in range(2 * LANES)]
    found = Simulator(BASE).simulate_all(points, inputs, steps)
    for k in (0, LANES):
        exact = reference(BASE, BASE.values(points[k]), inputs, steps)
        np.testing.assert_array_equal(Simulator(BASE).simulate(points[k], inputs, steps), exact)
        np.testing.assert_array_equal(found[:, :, k], exact)
