"""Dual numbers against the tangents of the tracer: each operation, and a plant with effects."""

from dataclasses import replace

import numpy as np
import pytest
from builders import PROBES, random_steps
from test_tracer import FORMULAS, INPUT, STEPS, VALUES, toy

from vpp_fmu.kernel.duals import Dual, Duals
from vpp_fmu.kernel.ops import NUMBERS
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.types import start, step
from vpp_fmu.native import Simulator

STEP, ROWS = 0.002, 400


def run(model, values, names, inputs, dt=STEP):
    """Thrust (rows,) and its tangents (rows, names) on dual numbers; no input is held back."""
    duals = Duals(NUMBERS, len(names))
    known = {name: duals.constant(value) for name, value in values.items()}
    for i, name in enumerate(names):
        known[name] = Dual(values[name], tuple(1.0 if k == i else None for k in range(len(names))))
    rows = [{u.name: duals.constant(float(inputs[u.name][k])) for u in model.inputs} for k in range(ROWS)]
    signals, states = start(model, duals, rows[0], known)
    thrust, slopes = [], []
    for row in rows:
        y = duals.constant(signals["thrust"])
        thrust.append(y.value)
        slopes.append([0.0 if d is None else d for d in y.tangents])
        signals, states = step(model, duals, row, states, known, duals.constant(dt))
        states = {name: duals.constant(x) for name, x in states.items()}
    return np.array(thrust), np.array(slopes)


def test_a_plant_with_effects_has_the_tracers_tangents():
    """In the twin a plant with effects runs on dual numbers."""
    model = plant(["pitch_command_deadband", "supply_sag", "inflow_lag"])
    names = [p.name for p in model.parameters]
    values = model.values({name: value for name, value in PROBES.items() if name in names})
    inputs = random_steps(ROWS, 50, model=model)
    expected = Simulator(model, names).sensitivities(values, inputs, np.full(ROWS - 1, STEP))
    thrust, slopes = run(model, values, names, inputs)
    np.testing.assert_array_equal(thrust, expected[0][:, 0])
    np.testing.assert_allclose(slopes, expected[1][:, 0], rtol=1e-9, atol=1e-9)


def test_structural_zeros_are_not_computed():
    x, y = Dual(2.0, (1.0, None)), Dual(3.0, (None, None))
    assert (x * y + 1.0).tangents == (3.0, None)
    assert (1.0 / x - y).tangents == (-0.25, None)
    assert Duals(NUMBERS, 2).exp(y).tangents == (None, None)


def test_every_operation_has_the_tracers_tangents():
    """Each operation is an output of one model, from rest in each row: a dual state would need its tangents carried."""
    duals, base = Duals(NUMBERS, 2), toy(None)

    def every(ops, s, x, p, dt):
        return {name: formula(ops, p.a, p.b, s.u, 0.3) for name, formula in FORMULAS.items()}, {}

    outputs = tuple(replace(base.outputs[0], name=name) for name in FORMULAS)
    model = replace(base, outputs=outputs, effects=(replace(base.effects[0], step=every, states=()),))
    shown, tangents = Simulator(model, ("a", "b")).sensitivities(VALUES, INPUT, STEPS)
    a, b = duals.seeded(VALUES["a"], 0), duals.seeded(VALUES["b"], 1)
    for j, (name, formula) in enumerate(FORMULAS.items()):
        for k, value in enumerate(INPUT["u"][:-1]):
            found = duals.constant(formula(duals, a, b, duals.constant(float(value)), duals.constant(0.3)))
            assert found.value == shown[k + 1, j], name
            wanted = tangents[k + 1, j].tolist()
            assert [d or 0.0 for d in found.tangents] == pytest.approx(wanted, rel=1e-9, abs=1e-12), name
