"""Reverse mode: the gradient equals that of the forward tangents, at a cost independent of the number of parameters."""

import numpy as np
import pytest
from builders import OPTIONAL, named, random_steps, simulator

from identification.demo import example_folder
from identification.fit.adjoint import AdjointProblem
from identification.fit.problem import Prior, Problem
from identification.fit.refine import BASE_PARAMETERS, independent_readings
from identification.static.static_map import fit_static_map
from vpp_fmu.campaign import read_campaign
from vpp_fmu.errors import CompilerMissing
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import AVERAGED, BASE, plant
from vpp_fmu.kernel.types import Effect, Model, Parameter, Signal, State
from vpp_fmu.native import Adjoint
from vpp_fmu.tracer.graph import CALLS

ROWS = 3000
UNEVEN = np.random.default_rng(4).choice([1e-4, 0.0013, 0.004, 0.0047, 0.031], ROWS - 1)


def is_the_tangents(model, values, inputs, steps, every=1):
    """The gradient in every `every`-th parameter is the product of tangents and random cotangents, to rounding."""
    names = tuple(p.name for p in model.parameters)[::every]
    outputs, tangents = simulator(model, names).sensitivities(values, inputs, steps)
    cotangents = np.random.default_rng(7).normal(size=outputs.shape) / np.abs(outputs).max(axis=0)
    shown, gradient = Adjoint(model).gradient(values, inputs, steps, cotangents)
    np.testing.assert_array_equal(shown, outputs)
    assert np.count_nonzero(gradient) >= 4
    gradient = gradient[::every]
    wanted = np.einsum("rop,ro->p", tangents, cotangents)
    summed = np.einsum("rop,ro->p", np.abs(tangents), np.abs(cotangents))  # scale of the rounding error of the sum
    assert np.isfinite(gradient).all()
    off = np.abs(gradient - wanted) / np.where(summed > 0.0, summed, 1.0)
    assert off.max() < 1e-13, dict(zip(names, off, strict=True))


EACH = {"plain": (BASE, {})} | {e.name: (plant([e.name]), named(e, e.probe)) for e in OPTIONAL}


@pytest.mark.sampled("model")
@pytest.mark.parametrize("model", EACH)
def test_gradient_is_the_tangents_for_each_effect(model):
    model, values = EACH[model]
    is_the_tangents(model, values, random_steps(ROWS, 150, model=model), np.full(ROWS - 1, 0.0037), every=3)


@pytest.mark.parametrize("step", [0.0013, 0.004, 0.0091])
def test_gradient_of_a_sampled_law(step):
    """Rows without a sample and rows with several."""
    rng = np.random.default_rng(2)
    inputs = {"thrust_set": np.repeat(rng.uniform(2.0, 12.0, 30), 100), "thrust": rng.normal(7.0, 2.0, ROWS)}
    is_the_tangents(CONTROLLER, {}, inputs, np.full(ROWS - 1, step))


def every_operation():
    """A model whose step uses every operation, on prepared constants and on varying values."""

    def step(ops, s, x, p, dt):
        y = 0.3 * x.y + sum(
            getattr(ops, name)(*[0.4 + p.a * p.b, 0.5 + 0.1 * s.u * x.y][: 2 if name in ("pow", "atan2") else 1])
            + getattr(ops, name)(*[0.5 + 0.1 * s.u * x.y, p.a][: 2 if name in ("pow", "atan2") else 1])
            for name in CALLS
        )
        y = ops.where(s.u > 0.0, p.a * y, y / p.b) - ops.clip(y, -p.b, p.a) + ops.where(p.a < p.b, p.a, -p.b) * (2.0 - s.u)
        y = ops.tanh(0.1 * y) + dt * p.b
        return {"y": y * y}, {"y": y}

    parameters = tuple(Parameter(name, "1", value, -9.0, 9.0, name) for name, value in (("a", 0.7), ("b", 0.9)))
    states = (State("y", "1", "y", lambda ops, s, p: s.u * p.a),)
    effect = Effect("toy", "toy", step, parameters, states)
    return Model("Toy", "toy", (Signal("u", "1", "u", -9.0, 9.0),), (Signal("y", "1", "y", -9.0, 9.0),), (effect,))


def test_gradient_of_every_operation_is_the_central_difference():
    model, inputs, steps = every_operation(), {"u": np.linspace(-1.0, 1.03, 50)}, UNEVEN[:49]
    weights = np.random.default_rng(0).normal(size=(50, 1))
    _, gradient = Adjoint(model).gradient({}, inputs, steps, weights)
    for name, shown in zip("ab", gradient, strict=True):
        value = model.values()[name]
        ahead = [simulator(model).simulate({name: value + k * 1e-3}, inputs, steps) for k in (-2, -1, 1, 2)]
        numeric = (8.0 * (ahead[2] - ahead[1]) - (ahead[3] - ahead[0])) / 12e-3
        assert shown == pytest.approx(np.sum(weights * numeric), rel=1e-8)


def test_without_a_compiler_the_adjoint_is_refused(no_compiler):
    with pytest.raises(CompilerMissing, match="adjoint"):
        Adjoint(BASE)


@pytest.fixture(scope="module")
def campaign():
    """The example's open-loop record, a start, and the static map as prior."""
    campaign = read_campaign(example_folder())
    static = fit_static_map(campaign.static, BASE.values())
    prior = Prior(tuple(static.coefficients), np.array(list(static.coefficients.values())), static.covariance)
    return campaign.open_loop, BASE.values(AVERAGED | dict(static.coefficients)), prior


@pytest.mark.parametrize("channels", [("thrust",), ("thrust", "omega")])
def test_the_slope_of_the_cost_is_that_of_the_residual(channels, campaign):
    """Half a second of thrust is missing, as on a rig that loses readings."""
    record, values, prior = campaign
    thrust = record["thrust"].copy()
    thrust[1000:1125] = np.nan
    experiments = independent_readings([record.with_columns(thrust=thrust)], values, channels)
    problem = AdjointProblem(BASE, experiments, values, BASE_PARAMETERS, prior)
    problem.scale["thrust"] = 0.2
    at, rng = problem.coordinates.vector(values), np.random.default_rng(1)
    for moved in (at, at * rng.uniform(0.9, 1.1, len(at)), at * rng.uniform(0.9, 1.1, len(at))):
        x = np.clip(moved, problem.coordinates.lower, problem.coordinates.upper)
        cost, gradient = problem.slope(x)
        residual, jacobian = problem.evaluate(x)
        assert cost == pytest.approx(0.5 * np.sum(residual**2), rel=1e-13)
        np.testing.assert_allclose(gradient, jacobian.T @ residual, rtol=1e-10)


def test_the_adjoint_fit_has_the_minimum_of_levenberg_marquardt(campaign):
    record, values, prior = campaign
    experiments = independent_readings([record], values)
    problems = [kind(BASE, experiments, values, BASE_PARAMETERS, prior) for kind in (Problem, AdjointProblem)]
    wanted, found = (problem.solve(values) for problem in problems)
    assert found.converged
    assert found.cost == pytest.approx(wanted.cost, rel=1e-6)
    assert found.costs[0] == pytest.approx(wanted.costs[0], rel=1e-12)
    spread = np.sqrt(np.diag(np.linalg.inv(wanted.jacobian.T @ wanted.jacobian) * wanted.cost / len(record)))
    assert (np.abs(found.value - wanted.value) < 0.02 * spread).all()
    np.testing.assert_allclose(found.jacobian, wanted.jacobian, atol=1e-3 * np.abs(wanted.jacobian).max())
