"""vpp export --model: the worked example in both flavours, and the refusals of models that can't become an FMU."""

import sys
from pathlib import Path

import numpy as np
import pytest
from builders import Slave, needs_compiler

import fmu_src
from vpp_fmu.app.cli import main
from vpp_fmu.fmu import Fmu

EXAMPLE = (Path(fmu_src.__file__).parent / "two_masses.py").read_text()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty current folder from which modules are imported, as for the command."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    return tmp_path


BROKEN = {
    "unknown signal": ("s.force + f", "s.forse + f", ["effect masses, step", "line 23", "no signal forse", "force, brake"]),
    "unknown state": ("x.x2 - x.x1)", "x.y2 - x.x1)", ["effect masses, step", "no state y2", "x1, x2, v1, v2"]),
    "unknown parameter": ("p.k *", "p.c *", ["effect masses, step", "no parameter c", "m1, m2, k, d, sample_time"]),
    "state never returned": ('"v1": v1, "v2": v2}', '"v1": v1}', ["state v2", "never returned by its step"]),
    "undeclared": ('"v1": v1,', '"v1": v1, "w": v1,', ["a state w returned", "its declared states: x1, x2, v1, v2"]),
    "unit unknown": ('"N.s/m"', '"N.sec/m."', ["parameter d, unit", "N.sec/m.", "N.m/rad"]),
    "unit FMI can't say": ('"kg", 1.0', '"bit", 1.0', ["parameter m1, unit", "is in bit", "kg, m, s, A, K, mol, cd, rad"]),
    "unit with half a power": ('"m/s", "speed of mass 1"', '"m/s0.5", "speed of mass 1"', ["state v1, unit"]),
    "default": ('"m", 0.1, -10.0', '"m", 11.0, -10.0', ["parameter gate, default", "found 11.0", "-10.0 to 10.0"]),
    "range upside down": ("50.0, 0.0, 1e4", "50.0, 1e4, 0.0", ["parameter k, range", "10000.0 to 0.0", "below"]),
    "effects, comma": ("effects=(MASSES, GATE)", "effects=(MASSES)", ["effects", "found one Effect", "ends in a comma"]),
    "inputs, comma": ("inputs=(FORCE, BRAKE)", "inputs=(FORCE)", ["inputs", "found one Signal", "ends in a comma"]),
    "comma": ("tunable=True),),", "tunable=True)),", ["effect gate, parameters", "found one Parameter", "ends in a comma"]),
    "numpy": ("f = p.k", "import numpy\n    f = numpy.exp(x.v1) * p.k", ["effect masses, step", "can't be traced", "numpy"]),
    "name with a space": ('"TwoMasses"', '"Two Masses"', ["name: found 'Two Masses'", "letters, digits and _"]),
    "variable no identifier": ('"m1", "kg"', '"m-1", "kg"', ["parameter of effect masses 'm-1'", "letters, digits and _"]),
    "off of another's parameter": (
        '"where the gate is", tunable=True),)',
        '"where the gate is", tunable=True),), off={"m1": 0.0}',
        ["effect gate, off", "found a parameter m1", "expected one of gate"],
    ),
    "declared twice": ('"m2", "kg"', '"m1", "kg"', ["variable m1", "declared twice"]),
    "unset output": (
        '("beyond", "1", "whether the second',
        '("above", "1", "whether the second',
        ["output above", "set by no effect"],
    ),
    "sample time": ('sample_time="sample_time"', 'sample_time="period"', ["sample_time", "a parameter period", "sample_time"]),
    "sample time tunable": ("nominal=0.001)", "nominal=0.001, tunable=True)", ["parameter sample_time", "tunable", "fixed"]),
    "Boolean": ("0.0, 1.0, kind=BOOLEAN)\nF", "0.0, 2.0, kind=BOOLEAN)\nF", ["signal brake, range", "0.0 to 2.0", "0 to 1"]),
    "step": ("def _watch(ops, s, x, p, dt)", "def _watch(ops, s, x, p)", ["effect gate, step", "(ops, s, x, p, dt)"]),
    "step that returns no pair": ("return seen, seen", "return seen, 1.0", ["effect gate, step", "a tuple returned", "a pair"]),
    "division by zero": ("dt * f / p.m2", "dt * f / (x.x1 - x.x2)", ["effect masses, step", "ZeroDivisionError", "line 24"]),
    "a Boolean that is no truth value": (
        "ops.where(s.x2 > p.gate, 1.0, 0.0)",
        "ops.where(s.x2 > p.gate, 2.0, 0.5)",
        ["output beyond", "found 0.5 after step", "0 or 1, since it is a Boolean"],
    ),
    "an Integer that is not whole": ("x.passes + ops", "0.3 + x.passes + ops", ["output passes", "found 1.2", "whole numbers"]),
    "no numbers later on": ("x.passes + ops", "2e200 + x.passes * 1e200 + ops", ["the first 100 steps", "passes = inf"]),
    "start of other arguments": ("def _rest(ops, s, p)", "def _rest(ops, s)", ["state x1, start", "(ops, s, p)"]),
    "no Python": ("def _rest(ops, s, p):", "def _rest(ops, s, p)", ["--model", "package.module:NAME"]),
    "not there": ("MODEL = Model(", "MODELL = Model(", ["--model", "MODEL", "package.module:NAME"]),
}

SPELLED = {
    "if": ("v2 = 0.0 if f > 0.0 else 1.0", "ops.where(condition, yes, no)"),
    "and": ("v2 = ops.where(f > 0.0 and x.v1 > 0.0, 1.0, 0.0)", "ops.where(condition, yes, no)"),
    "or": ("v2 = 1.0 if (f > 0.0 or x.v1 > 0.0) else 0.0", "ops.where(condition, yes, no)"),
    "not": ("v2 = ops.where(not f > 0.0, 1.0, 0.0)", "ops.where(condition, yes, no)"),
    "while": ("\n    while f > 0.0:\n        f = f - 1.0\n    v2 = f", "ops.where(condition, yes, no)"),
    "a chain of comparisons": ("v2 = ops.where(0.0 < f < 1.0, 1.0, 0.0)", "ops.where(condition, yes, no)"),
    "max()": ("v2 = max(f, 0.0)", "ops.maximum(x, y)"),
    "float()": ("v2 = float(f)", "the value as it is"),
    "math.exp()": ("import math; v2 = math.exp(-f * f)", "ops.exp"),
    "int()": ("v2 = int(f)", "ops.whole(x)"),
    "abs()": ("v2 = abs(f)", "ops.abs(x)"),
    "%": ("v2 = f % 2.0", "ops.mod(x, y)"),
    "//": ("v2 = f // 2.0", "ops.floor(x / y)"),
}


@pytest.mark.parametrize("name", SPELLED)
def test_python_that_cannot_be_traced_is_named_with_its_replacement(folder, refused, name):
    line, instead = SPELLED[name]
    module = f"spelled_{list(SPELLED).index(name)}"
    (folder / f"{module}.py").write_text(EXAMPLE.replace("v2 = x.v2 - dt * f / p.m2", line))
    said = refused("export", "--model", f"{module}:MODEL", "-o", "out")
    assert f"{module}.py line" in said
    assert f"found {name}, which can't be traced, expected " in said
    assert instead in said.split("expected ")[1]


@pytest.mark.parametrize("wrong", ["two_masses:FORCE", "two_masses:NONE", "no_such_module:MODEL", "two_masses", ":"])
def test_a_name_of_no_model_is_refused_in_one_line(folder, refused, wrong):
    (folder / "two_masses.py").write_text(EXAMPLE)
    assert wrong in refused("export", "--model", wrong, "-o", "out")


COOLING = """
from vpp_fmu.kernel.types import Effect, Model, Parameter, Signal, State


def step(ops, s, x, p, dt):
    temperature = {step}
    return {{"temperature": temperature}}, {{"temperature": temperature}}


COOLING = Effect(
    "cooling",
    "loses heat",
    step,
    parameters=(Parameter("tau", "s", 30.0, 0.1, 1e4, "time constant", nominal=30.0),),
    states=(State("temperature", "degC", "temperature of the body", lambda ops, s, p: 80.0),),
    {more}
)
AMBIENT = Signal("ambient", "degC", "around it", -50.0, 50.0, nominal=20.0, start=20.0)
BODY = Signal("temperature", "degC", "of the body", -1e9, 1e9, nominal=100.0)
MODEL = Model("Cooling", "A body that cools", (AMBIENT,), (BODY,), (COOLING,))
"""
EULER = "x.temperature + dt / p.tau * (s.ambient - x.temperature)"
STEPS = {
    "exact": ("ops.lag(x.temperature, s.ambient, p.tau, dt)", "", False),
    "Euler": (EULER, "", True),
    "Euler that says its step": (EULER, "largest_step=0.01,", False),
}


@pytest.mark.parametrize("kind", STEPS)
def test_a_model_that_depends_on_the_communication_step_gets_a_note(folder, printed, kind):
    step, more, warned = STEPS[kind]
    module = f"steps_{list(STEPS).index(kind)}"
    (folder / f"{module}.py").write_text(COOLING.format(step=step, more=more))
    said = printed("export", "--model", f"{module}:MODEL", "-o", "out")
    assert (f"note: {module}:MODEL depends on the communication step: temperature is " in said) == warned
    if warned:  # 80 to 20 degC by Euler: 60 (1 - h / tau) a step
        whole, half = (20.0 + 60.0 * share for share in (1.0 - 0.004 / 30.0, (1.0 - 0.002 / 30.0) ** 2))
        assert abs(whole - half) < 1e-6 * 100.0  # of this step's size it does not show
        assert "by one step of 0.4 s" in said
        assert "largest_step" in said


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_model_is_refused_by_its_declaration_and_nothing_is_written(folder, refused, what):
    good, bad, words = BROKEN[what]
    assert EXAMPLE.count(good) == 1, what
    module = f"broken_{list(BROKEN).index(what)}"
    (folder / f"{module}.py").write_text(EXAMPLE.replace(good, bad))
    said = refused("export", "--model", f"{module}:MODEL", "-o", "out")
    assert f"{module}:MODEL" in said
    for word in words:
        assert word in said, said
    assert not (folder / "out").exists()


@pytest.mark.parametrize(
    ("flavour", "file"), [("python", "Cooling.fmu"), pytest.param("native", "Cooling.native.fmu", marks=needs_compiler)]
)
def test_the_readmes_example_runs(folder, flavour, file):
    """The code block of the README is a whole module."""
    page = (Path(fmu_src.__file__).parent / "README.md").read_text()
    text = page.split("```python\n# cooling.py\n")[1].split("```")[0]
    (folder / "cooling.py").write_text(text)
    assert main(["export", "--model", "cooling:MODEL", "--flavour", flavour, "-o", "out"]) == 0
    slave = Slave(Fmu(folder / "out" / file))
    shown = [slave.step({"ambient": 20.0}, 1.0, "temperature")[0] for _ in range(50)]
    np.testing.assert_allclose(shown, 20.0 + 60.0 * np.exp(-np.arange(1.0, 51.0) / 30.0), rtol=1e-12)
