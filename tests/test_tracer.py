"""Tracing: which operations are recorded or refused, their derivatives, and expressions prepared outside the step."""

import math

import numpy as np
import pytest
from builders import ALL_ON, reference

from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.kernel.types import Effect, Model, Parameter, Signal, State
from vpp_fmu.native import Simulator
from vpp_fmu.tracer import trace
from vpp_fmu.tracer.graph import CALLS, COMPARE, TABLES, Graph, Node

FINITE = (-1e3, 1e3)


def toy(formula) -> Model:
    """A model with one state: y[k+1] = formula(ops, parameter a, parameter b, input u, state y)."""

    def step(ops, s, x, p, dt):
        y = formula(ops, p.a, p.b, s.u, x.y)
        return {"y": y}, {"y": y}

    parameters = tuple(Parameter(name, "1", 0.5, *FINITE, name) for name in "ab")
    state = State("y", "1", "y", lambda ops, s, p: s.u * 0.0)
    effect = Effect("toy", "toy", step, parameters, (state,))
    return Model("Toy", "toy", (Signal("u", "1", "u", *FINITE),), (Signal("y", "1", "y", *FINITE),), (effect,))


XS, YS, YS_RISING = (-0.9, -0.2, 0.15, 0.75), (0.3, 0.1, 0.6, 0.2), (-0.8, 0.05, 0.7, 1.0)
ZS = ((0.1, 0.5, 0.2, 0.3), (0.4, 0.6, 0.1, 0.7), (0.9, 0.3, 0.2, 0.2), (0.5, 0.8, 0.6, 0.1))
FORMULAS = {
    "add": lambda ops, a, b, u, y: a + 0.1 * y + (2.0 + b) + u,
    "subtract": lambda ops, a, b, u, y: a - y - (2.0 - b) - u,
    "multiply": lambda ops, a, b, u, y: a * y + 3.0 * b * u + a * b,
    "divide": lambda ops, a, b, u, y: a / b + y / (2.0 + a) + u / b + 1.0 / a,
    "negate": lambda ops, a, b, u, y: -(a * u) + -b,
    "exp": lambda ops, a, b, u, y: ops.exp(a * u + 0.1 * y),
    "expm1": lambda ops, a, b, u, y: ops.expm1(a * b * u),
    "sqrt": lambda ops, a, b, u, y: ops.sqrt(a * a + b + u * u),
    "sin": lambda ops, a, b, u, y: ops.sin(a * u + y),
    "cos": lambda ops, a, b, u, y: ops.cos(a * u + b),
    "tanh": lambda ops, a, b, u, y: ops.tanh(a * u + b * y),
    "whole": lambda ops, a, b, u, y: a * ops.whole(2.2 * b * u) + ops.whole(3.0 * u) * b,
    "where": lambda ops, a, b, u, y: ops.where(u < 0.1, a * u, ops.where(u > 0.6, b * u * u, a * b)),
    "log": lambda ops, a, b, u, y: ops.log(2.0 + a * u) + ops.log10(b + u * u),
    "pow": lambda ops, a, b, u, y: ops.pow(2.0 + a * u, b) + (a * u) ** 3 + 2.0 ** (b * u) + (b + u) ** 2,
    "atan2": lambda ops, a, b, u, y: ops.atan2(a * u, b) + ops.atan2(1.0, b * u) * u,
    "table": lambda ops, a, b, u, y: ops.table(a * u, XS, YS) + ops.table(b * u, XS, YS, "cubic"),
    "table_2": lambda ops, a, b, u, y: (
        ops.table_2(a * u, b + 0.05 * u, XS, YS_RISING, ZS) + ops.table_2(a, b * u, XS, YS_RISING, ZS, "cubic")
    ),
    "logic": lambda ops, a, b, u, y: ops.where((u >= 0.1) & (a * u <= 0.5) | (u == -1.003), a * u, b * (u != 0.3)),
    "logical_not": lambda ops, a, b, u, y: a * u * ops.logical_not((u > 0.2) | (u < -0.6)),
    "floor": lambda ops, a, b, u, y: a * ops.floor(2.1 * b * u) + ops.ceil(3.0 * u) * b + ops.mod(a * u, 0.65),
    "minimum of three": lambda ops, a, b, u, y: ops.minimum(a * u, b, 0.4 - u) + ops.maximum(a * u, b * u, -0.2, a),
    "abs": lambda ops, a, b, u, y: ops.abs(a * u - 0.3),
    "minimum": lambda ops, a, b, u, y: ops.minimum(a * u, b),
    "maximum": lambda ops, a, b, u, y: ops.maximum(a * u, b * 0.3),
    "clip": lambda ops, a, b, u, y: ops.clip(u, -a, b * 0.5),
    "gain": lambda ops, a, b, u, y: ops.gain(a, b) * u,
    "lag": lambda ops, a, b, u, y: ops.lag(y, u, a, b),
    "lag_ramp": lambda ops, a, b, u, y: ops.lag_ramp(y, u, u + a, a, b),
    "relaxation": lambda ops, a, b, u, y: ops.relaxation(a * u * u) + ops.relaxation(b),
    "two_lag_step": lambda ops, a, b, u, y: ops.two_lag_step(a, b, 0.3) * u,
}
VALUES = {"a": 0.73, "b": 0.9}
INPUT = {"u": np.r_[np.linspace(-1.003, 1.007, 41), 0.0]}
STEPS = np.ones(41)


@pytest.mark.parametrize("formula", FORMULAS)
def test_generated_code_is_the_function_to_the_bit(formula, no_compiler, recwarn):
    model = toy(FORMULAS[formula])
    np.testing.assert_array_equal(Simulator(model).simulate(VALUES, INPUT, STEPS), reference(model, VALUES, INPUT, STEPS))


@pytest.mark.parametrize("formula", FORMULAS)
def test_compiled_code_and_derivatives(formula):
    model = toy(FORMULAS[formula])
    exact = reference(model, VALUES, INPUT, STEPS)
    shown, tangents = Simulator(model, ("a", "b")).sensitivities(VALUES, INPUT, STEPS)
    np.testing.assert_array_equal(shown, exact)
    for j, name in enumerate("ab"):  # fourth-order differences: of a step of 1e-3, nothing above 1e-9 is left
        ahead = {k: reference(model, VALUES | {name: VALUES[name] + k * 1e-3}, INPUT, STEPS) for k in (-2, -1, 1, 2)}
        numeric = (8.0 * (ahead[1] - ahead[-1]) - (ahead[2] - ahead[-2])) / 12e-3
        np.testing.assert_allclose(tangents[:, :, j], numeric, rtol=0, atol=1e-8)


def test_every_operation_has_a_formula_above():
    graph, seen = Graph(), set()
    a, b, u, y = (graph.node("v", i) for i in range(4))
    for formula in FORMULAS.values():
        formula(graph, a, b, u, y)
    seen = {n.op for n in graph._known.values()}
    assert seen == {"v", "+", "-", "*", "/", "neg", "whole", "where", *CALLS, *COMPARE, *TABLES}


@pytest.mark.parametrize(("x", "slope"), [(0.0, -0.5), (1e-9, -0.5), (0.2999999, None), (0.3000001, None), (5.0, None)])
def test_slope_of_relaxation_is_right_down_to_zero(x, slope):
    model = toy(lambda ops, a, b, u, y: ops.relaxation(a))
    tangents = Simulator(model, ("a",)).sensitivities({"a": x}, {"u": [0.0, 0.0]}, [1.0])[1]
    exact = (math.exp(-x) * (x + 1.0) - 1.0) / x**2 if slope is None else slope
    assert tangents[-1, 0, 0] == pytest.approx(exact, rel=1e-8)


UNSEEN = {  # one use of each of Python's special methods: and, not, max and sorted call __bool__, as if does
    "if": lambda x: 1.0 if x > 0.0 else 2.0,
    "or": lambda x: x or 1.0,
    "in": lambda x: x in (1.0, 2.0),
    "sum of an iterable": sum,
    "//": lambda x: x // 2.0,
    "%": lambda x: x % 2.0,
    "2 %": lambda x: 2.0 % x,
    "divmod": lambda x: divmod(x, 2.0),
    "abs": abs,
    "float": float,
    "int": int,
    "complex": complex,
    "bool": bool,
    "round": round,
    "index": lambda x: [1.0, 2.0][x],
    "+x": lambda x: +x,
    "math.exp": math.exp,
    "math.floor": math.floor,
    "math.ceil": math.ceil,
    "math.trunc": math.trunc,
    "format": lambda x: f"{x:.3f}",
}


@pytest.mark.parametrize("what", UNSEEN)
def test_python_that_cannot_be_traced_is_a_type_error(what):
    with pytest.raises(TypeError):
        trace(toy(lambda ops, a, b, u, y: UNSEEN[what](a * u)))


def test_only_states_that_depend_on_a_parameter_have_a_tangent_in_it():
    """The outer lag of the speed affects speed and thrust, the inner one also its own state, a coefficient only the thrust."""
    program = trace(BASE, ("tau_omega_1", "tau_omega_2", "c20"))
    names, found = [*program.layout.outputs, *program.layout.states], {}
    for kind, *at in (target for target, _ in program.step):
        if kind == "d":
            found.setdefault(program.wrt[at[1]], set()).add(names[at[0]])
    outer = {"thrust", "omega", "omega_outer"}
    assert found == {"tau_omega_1": outer, "tau_omega_2": outer | {"omega_inner"}, "c20": {"thrust"}}


@pytest.mark.parametrize("model", [BASE, ALL_ON, CONTROLLER], ids=["plain", "all on", "controller"])
@pytest.mark.parametrize("wrt", [False, True])
def test_expressions_of_parameters_and_the_step_are_prepared(model, wrt):
    program = trace(model, [p.name for p in model.parameters] if wrt else ())
    fixed_values = set(program.layout.positions("parameter"))
    moving: dict[Node, bool] = {}

    def moves(n) -> bool:
        if not isinstance(n, Node):
            return False
        if n not in moving:
            assert n.op not in ("dt", "dt_tangent"), "the step's length is read at every step"
            leaf = (n.op == "v" and n.args[0] not in fixed_values) or n.op == "d"
            below = [moves(a) for a in n.nodes]
            moving[n] = leaf or any(below)
            # what tells a prepared condition's outcome is left: a comparison of a prepared constant
            assert moving[n] or not n.nodes or (n.op in COMPARE and n.args[0].op == "c"), n.op
        return moving[n]

    for _, value in program.step:
        moves(value)
    assert any(moving.values())
