"""The models of the tutorial in every flavour, and what the kernel offers them: derivatives, tables, vectors, instances."""

import contextlib
import importlib
import re
import sys
from dataclasses import replace

import fmpy
import numpy as np
import pytest
from builders import NO_COMPILER, Slave, needs_compiler, refusal
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator
from scipy.linalg import expm
from six_models import CASES, FOLDER

import vpp_fmu as vpp
from vpp_fmu.export import native_fmu, python_fmu
from vpp_fmu.export.checks import check_model
from vpp_fmu.export.description import Experiment
from vpp_fmu.export.trial import try_fmu
from vpp_fmu.fmu import Fmu
from vpp_fmu.kernel.ops import NUMBERS
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.tracer import c_source, emit, trace

MAKERS = (python_fmu,) if NO_COMPILER else (python_fmu, native_fmu)


def run(case, step, stop=3.0):
    """(times, outputs by name, each (n,)) of the functions."""
    simulation, times, rows = Simulation(case.model()), [0.0], []
    rows.append(simulation.start(case.inputs(0.0)))
    for k in range(round(stop / step)):
        rows.append(simulation.advance(case.inputs(k * step), step))
        times.append((k + 1) * step)
    return np.array(times), {name: np.array([row[name] for row in rows]) for name in rows[0]}


@pytest.mark.parametrize("step", [0.02, 0.25, 1.0])
@pytest.mark.parametrize("name", CASES)
def test_the_models_have_their_solutions_at_any_communication_step(name, step):
    case = CASES[name]
    times, shown = run(case, step)
    for output, right in case.solution(times[1:]).items():
        error = np.abs(shown[output][1:] - right).max() / np.abs(right).max()
        assert error < case.bound, f"{output} at {step} s: {error:.1e}"


@pytest.mark.parametrize("name", CASES)
def test_the_flavours_are_the_functions_to_the_bit(name, tmp_path):
    case = CASES[name]
    model, slaves = case.model(), []
    for make in MAKERS:
        path = tmp_path / f"{make.__name__}.fmu"
        path.write_bytes(make(case.model()))
        slaves.append(Slave(Fmu(path), initialised=False).initialise(**case.inputs(0.0)))
    kernel, names = Simulation(model), [y.name for y in model.outputs]
    start = list(kernel.start(case.inputs(0.0)).values())
    assert all(slave.get(*names) == start for slave in slaves)
    for k, dt in enumerate(np.random.default_rng(3).choice([0.001, 0.0137, 0.3], 60).tolist()):
        inputs = case.inputs(0.1 * k)
        exact = list(kernel.advance(inputs, dt).values())
        assert [slave.step(inputs, dt, *names) for slave in slaves] == [exact] * len(slaves)


def test_a_run_of_each_method_has_its_order():
    """Half the step: 2 times smaller errors by Euler, 16 times by Runge-Kutta."""
    base = CASES["ODE"].model()
    errors = {}
    for method in ("euler", "rk4"):
        for h in (0.02, 0.01):
            model = replace(base, effects=(replace(base.effects[0], method=method, largest_step=h),))
            simulation = Simulation(model)
            simulation.start({"force": 0.5})
            found = simulation.advance({"force": 0.5}, 2.0)["x"]
            errors[method, h] = abs(found - CASES["ODE"].solution(np.array([2.0]))["x"][0])
    assert errors["euler", 0.02] / errors["euler", 0.01] == pytest.approx(2.0, rel=0.1)
    assert errors["rk4", 0.02] / errors["rk4", 0.01] == pytest.approx(16.0, rel=0.1)


@pytest.mark.parametrize("scale", [1e-9, 0.1, 3.0, 1e4])
def test_the_exact_method_is_the_matrix_exponential(scale):
    """Also of a singular matrix, and of a stiff one."""
    A = scale * np.array([[-3.0, 1.0, 0.0], [0.5, -40.0, 2.0], [0.0, 0.0, 0.0]])
    b = scale * np.array([1.0, -2.0, 0.3])

    def derivative(ops, s, x, p):
        return {"z": [sum(A[i, j] * x.z[j] for j in range(3)) + b[i] * s.u for i in range(3)]}

    start = (1.0, 0.5, -1.0)
    effect = vpp.Effect("e", "e", derivative=derivative, method="exact", states=(vpp.State("z", "1", "z", start, size=3),))
    model = vpp.Model("M", "m", (vpp.Signal("u", "1", "u"),), (vpp.Signal("z", "1", "z", size=3),), (effect,))
    found = list(Simulation(model).advance({"u": 2.0}, 1.0).values())
    whole = np.zeros((4, 4))
    whole[:3, :3], whole[:3, 3] = A, 2.0 * b
    np.testing.assert_allclose(found, (expm(whole) @ np.r_[start, 1.0])[:3], rtol=1e-10)


def test_tables_are_scipys():
    rng = np.random.default_rng(5)
    xs, ys = np.cumsum(rng.uniform(0.1, 2.0, 40)), rng.normal(size=40)
    grid, inside = rng.normal(size=(40, 12)), rng.uniform(xs[0], xs[-1], 500)
    across, columns = rng.uniform(0.0, 11.0, 500), np.arange(12.0)
    cubic, plane = PchipInterpolator(xs, ys), RegularGridInterpolator((xs, columns), grid)
    for x, y in zip(inside.tolist(), across.tolist(), strict=True):
        assert NUMBERS.table(x, xs, ys) == pytest.approx(np.interp(x, xs, ys), abs=1e-12)
        assert NUMBERS.table(x, xs, ys, "cubic") == pytest.approx(float(cubic(x)), abs=1e-12)
        assert NUMBERS.table_2(x, y, xs, columns, grid) == pytest.approx(float(plane((x, y))), abs=1e-12)
        rows = PchipInterpolator(columns, PchipInterpolator(xs, grid)(x))  # both orders of cubic pieces share the grid's lines
        if y == round(y):
            assert NUMBERS.table_2(x, y, xs, columns, grid, "cubic") == pytest.approx(float(rows(y)), abs=1e-12)
    for x in xs.tolist():
        assert NUMBERS.table_2(x, 3.0, xs, columns, grid, "cubic") == pytest.approx(grid[list(xs).index(x), 3], abs=1e-12)
    assert NUMBERS.table(xs[0] - 1.0, xs, ys) == ys[0]
    assert NUMBERS.table(xs[-1] + 1.0, xs, ys, "cubic") == ys[-1]


def modes() -> vpp.Model:
    """A vector gain, an enumeration and a string: the output's text says which mode is on."""
    texts = ("off", "low", "high")

    def step(ops, s, x, p, dt):
        gain = ops.where(s.mode == 1.0, 0.0, ops.where(s.mode == 2.0, 1.0, p.gain[1]))
        return {"y": [gain * s.u[0], gain * s.u[1] + p.gain[0]], "shown": s.mode, "side": p.label}, {}

    effect = vpp.Effect(
        "modes",
        "gains",
        step,
        (
            vpp.Parameter("gain", "1", (3.0, 5.0), -10.0, 10.0, "gains", size=2),
            vpp.Parameter("label", "1", "left", 1.0, 2.0, "side", kind="String", items=("left", "right")),
        ),
    )
    inputs = (
        vpp.Signal("u", "V", "in", size=2),
        vpp.Signal("mode", "1", "mode", start="low", kind="Enumeration", items=texts),
        vpp.Signal("on", "1", "unused", 0.0, 1.0, kind="Boolean"),
        vpp.Signal("count", "1", "unused", kind="Integer"),
    )
    outputs = (
        vpp.Signal("y", "V", "out", size=2),
        vpp.Signal("shown", "1", "mode", kind="String", items=texts),
        vpp.Signal("side", "1", "side", kind="Enumeration", items=("left", "right")),
    )
    return vpp.Model("Modes", "gains by mode", inputs, outputs, (effect,))


@pytest.mark.parametrize("make", MAKERS)
def test_vectors_enumerations_and_strings_in_fmi_2(make, tmp_path):
    model, path = modes(), tmp_path / "Modes.fmu"
    check_model("modes", model)
    path.write_bytes(make(model))
    try_fmu("modes", model, model.values(), Experiment(), path.read_bytes(), "2.0")
    slave = Slave(Fmu(path), initialised=False)
    r = slave.references
    slave.fmi.enterInitializationMode()
    slave.fmi.setString([r["label"]], ["right"])
    slave.fmi.setReal([r["gain[2]"]], [7.0])
    slave.fmi.exitInitializationMode()
    assert slave.fmi.getString([r["shown"], r["label"]]) == [b"low", b"right"]
    assert list(slave.fmi.getInteger([r["side"]])) == [2]
    slave.fmi.setReal([r["u[1]"], r["u[2]"]], [1.0, 2.0])
    slave.fmi.setInteger([r["mode"]], [3])
    slave.fmi.doStep(0.0, 0.1)
    assert list(slave.fmi.getReal([r["y[1]"], r["y[2]"]])) == [7.0, 17.0]
    assert slave.fmi.getString([r["shown"]]) == [b"high"]
    with pytest.raises(Exception, match="fmi2SetInteger"):
        slave.fmi.setInteger([r["mode"]], [4])
    assert slave.messages[-1].endswith("mode: found item 4.0, expected 1 to 3")


@needs_compiler
def test_vectors_enumerations_and_strings_in_fmi_3(tmp_path):
    model, path = modes(), tmp_path / "Modes.fmu"
    path.write_bytes(native_fmu(model, version="3.0"))
    try_fmu("modes", model, model.values(), Experiment(), path.read_bytes(), "3.0")
    description = fmpy.read_model_description(str(path))
    sizes = {v.name: [int(d.start) for d in v.dimensions] for v in description.modelVariables}
    assert sizes["u"] == sizes["y"] == sizes["gain"] == [2]
    assert sizes["mode"] == []
    shown = fmpy.simulate_fmu(str(path), stop_time=0.1, output_interval=0.1, start_values={"gain": [1.0, 7.0], "u": [1.0, 2.0]})
    assert shown["y"][-1].tolist() == [1.0, 3.0]


def test_sampled_effects_run_at_their_own_times():
    """Two counters of different periods in one model, at any communication step."""

    def counter(name, period):
        return vpp.Effect(
            name,
            "counts",
            lambda ops, s, x, p, dt: {name: getattr(x, name) + 1.0},
            (vpp.Parameter(f"{name}_period", "s", period, 1e-3, 10.0, "period"),),
            (vpp.State(name, "1", "samples so far", 0.0),),
            sample_time=f"{name}_period",
        )

    outputs = tuple(vpp.Signal(name, "1", name) for name in ("fast", "slow"))
    model = vpp.Model("Rates", "two rates", (), outputs, (counter("fast", 0.03), counter("slow", 0.5)))
    check_model("rates", model)
    for step in (0.007, 0.1, 0.35, 2.1):
        simulation = Simulation(model)
        assert simulation.outputs == {"fast": 0.0, "slow": 0.0}
        for k in range(1, 13):
            shown = simulation.advance({}, step)
            passed = k * step - 1e-6  # the sample at the end of a step runs in the next one
            assert shown == {"fast": np.floor(passed / 0.03) + 1.0, "slow": np.floor(passed / 0.5) + 1.0}


ABOUT = {"author": "A. Body", "license": "BSD-3-Clause", "copyright": "(c) A. Body", "stop_time": 3.0}


def test_the_class_form_and_the_api(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    class Heater(vpp.Slave):
        """A body that is heated."""

        inputs = (vpp.Signal("power", "W", "of the heater"),)
        outputs = (vpp.Signal("T", "degC", "temperature", start=20.0),)
        parameters = (vpp.Parameter("C", "J/K", 500.0, 1.0, 1e6, "heat capacity"),)
        largest_step = 1.0
        about = ABOUT

        def do_step(self, ops, dt):
            self.T = self.T + dt / self.C * self.power

    files = vpp.export_fmu(Heater, "fmus", values={"C": 250.0}, version="1.2", tolerance=1e-3)
    with contextlib.closing(Fmu(files["Heater.fmu"])) as fmu:
        said = fmu.description
        assert (said.author, said.license, said.copyright, said.version) == ("A. Body", "BSD-3-Clause", "(c) A. Body", "1.2")
        experiment = said.defaultExperiment  # text or numbers, by the version of fmpy
        assert (float(experiment.stopTime), float(experiment.tolerance)) == (3.0, 0.001)
        slave = Slave(fmu)
        assert slave.get("T") == [20.0]
        assert slave.step({"power": 500.0}, 2.0, "T") == [24.0]
        slave.free()

    class Wrong(Heater):
        def do_step(self, ops, dt):
            self.kept = self.T

    assert "self.kept set by do_step" in refusal(vpp.export_fmu, Wrong, "fmus")
    assert "found a int, expected a kernel Model or Slave" in refusal(vpp.export_fmu, int, "fmus").replace("a type", "a int")
    assert "one of author, version" in refusal(lambda: vpp.export_fmu(Heater, "fmus", colour="red"))


def gain_model(step=None, unit="V", **more) -> vpp.Model:
    step = step or (lambda ops, s, x, p, dt: ({"y": 2.0 * s.u}, {}))
    effect = vpp.Effect("gain", "doubles", step, **more)
    return vpp.Model("Gain", "g", (vpp.Signal("u", unit, "in"),), (vpp.Signal("y", "V", "out", 1.0, 1e9),), (effect,))


def counting(ops, s, x, p, dt):
    return {"y": x.n + 1.0}, {"n": x.n + 1.0}


REFUSED = {
    "a text as a number": (
        gain_model(parameters=(vpp.Parameter("a", "1", "left", 0.0, 1.0, "a"),)),
        "parameter a, default: found 'left'",
    ),
    "a unit that is none": (gain_model(unit="-"), "signal u, unit: found '-' is no unit"),
    "an operation that is none": (
        gain_model(lambda ops, s, x, p, dt: ({"y": ops.cosh(s.u)}, {})),
        "found no ops.cosh, expected one of abs, atan2",
    ),
    "signals of a step at the start": (
        gain_model(counting, states=(vpp.State("n", "1", "n", 0.0),)),
        "while n moves by 1 at the start",
    ),
    "a stop time below 0": (replace(gain_model(), stop_time=-1.0), "stop_time: found -1.0, expected a number above 0"),
    "an icon that is not there": (replace(gain_model(), icon="none.png"), "icon: found none.png"),
    "no largest step": (
        gain_model(
            vpp.Effect("a", "a").step, derivative=lambda ops, s, x, p: {"y": s.u}, states=(vpp.State("y", "V", "y", 0.0),)
        ),
        "largest_step: found None, expected the longest step [s] of rk4",
    ),
    "too few elements": (
        gain_model(lambda ops, s, x, p, dt: {"y": [1.0, 2.0]}, states=(vpp.State("y", "V", "y", 0.0, size=3),)),
        "2 elements of y, expected 3, as declared",
    ),
    "points that fall": (
        gain_model(lambda ops, s, x, p, dt: ({"y": ops.table(s.u, (1.0, 0.0), (1.0, 2.0))}, {})),
        "found 0.0 after 1.0, expected points that rise",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_fault_of_a_model_is_one_line(what):
    model, words = REFUSED[what]
    assert words in refusal(check_model, "here", model)


@needs_compiler
def test_a_model_without_seconds_is_fmi_3(tmp_path):
    model = gain_model()
    check_model("gain", model)  # the unused start of y need not lie in its range
    try_fmu("gain", model, {}, Experiment(), native_fmu(model, version="3.0"), "3.0")


@needs_compiler
def test_a_long_function_is_cut_into_parts_with_the_same_bits(monkeypatch):
    """With choices whose conditions and values stand in other parts than their users."""
    monkeypatch.setattr(emit, "LONG", 500)  # 3000 statements compile for ten seconds
    n = 60

    def step(ops, s, x, p, dt):
        mean = sum(x.T) / n
        warm = [mean < T for T in x.T]
        moved = [
            ops.where(warm[k - 1] & (s.u > T), ops.exp(-0.01 * (T - s.u)), T + dt * (x.T[k - 1] - 2.0 * T + x.T[(k + 1) % n]))
            for k, T in enumerate(x.T)
        ]
        return {"T": [ops.where(warm[-1 - k], T, 0.5 * (T + moved[-1 - k])) for k, T in enumerate(moved)]}

    states = (vpp.State("T", "V", "T", tuple(float(k % 7) for k in range(n)), size=n),)
    effect = vpp.Effect("long", "long", step, states=states, largest_step=0.01)
    model = vpp.Model(
        "Long", "long", (vpp.Signal("u", "V", "u", nominal=9.0),), (vpp.Signal("T", "V", "T", size=n),), (effect,)
    )
    text = c_source(trace(model))
    assert "step_500(" in text
    try_fmu("long", model, {}, Experiment(), native_fmu(model, version="3.0"), "3.0")  # FMI 2 has the same body


@needs_compiler
@pytest.mark.parametrize("name", ["ODE", "PI", "table"])
def test_derivatives_in_inputs_over_a_step_are_central_differences(name, tmp_path):
    case = CASES[name]
    model, path = case.model(), tmp_path / "model.fmu"
    path.write_bytes(native_fmu(model))
    slave = Slave(Fmu(path), initialised=False)
    names, r = [y.name for y in model.outputs], slave.references
    known = [r[u.name] for u in model.inputs]
    slave.fmi.enterInitializationMode()
    slave.fmi.setReal(known, list(case.inputs(0.0).values()))
    slave.fmi.getDirectionalDerivative([r[names[0]]], [r[model.parameters[0].name]], [1.0])  # carries them from now on
    slave.fmi.exitInitializationMode()
    for dt in (0.3, 0.05, 0.3):
        before = {x.name: slave.get(f"state.{x.name}")[0] for x in model.states}
        slave.step(case.inputs(0.0), dt)
        for u in model.inputs:
            ends, change = [], 1e-4 * u.nominal
            for sign in (-1.0, 1.0):
                kernel = Simulation(model)
                kernel.start(case.inputs(0.0), before)
                moved = case.inputs(0.0)[u.name] + sign * change
                ends.append(kernel.advance(case.inputs(0.0) | {u.name: moved}, dt))
            exact = [(ends[1][y] - ends[0][y]) / (2.0 * change) for y in names]
            found = slave.fmi.getDirectionalDerivative([r[y] for y in names], [r[u.name]], [1.0])
            assert list(found) == pytest.approx(exact, rel=1e-5, abs=1e-9)
    plain = Slave(Fmu(path))  # without the query at the start: as the standard has it, none depends on an input here
    plain.step(case.inputs(0.0), 0.3)
    assert list(plain.fmi.getDirectionalDerivative([r[names[0]]], known, [1.0] * len(known))) == [0.0]


def test_the_readme_lists_every_operation():
    page = (FOLDER.parents[2] / "fmu_src" / "README.md").read_text()
    table = page.split("| operation | what it is |")[1].split("\n\n")[0]
    public = {name for name in dir(NUMBERS) if not name.startswith(("_", "look_up"))}
    assert public == public & set(re.findall(r"[a-z_0-9]+", " ".join(re.findall(r"`([^`]*)`", table))))


BOX = """
import numpy as np


def step(state, inputs, dt):
    "A running mean by numpy."
    kept = np.append(state.get("kept", []), inputs["gain"] * inputs["u"])[-3:]
    state["kept"] = kept
    return {"mean": np.mean(kept)}
"""


def test_a_black_box_is_packed_in_the_python_flavour_only(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "running_mean.py").write_text(BOX)
    (tmp_path / "with_ours.py").write_text("import vpp_fmu\n" + BOX)
    gain = vpp.Parameter("gain", "1", 2.0, 0.0, 10.0, "gain")

    def model(module):
        box = importlib.import_module(module).step
        effects = (vpp.Effect("box", "parameters", parameters=(gain,)),)
        shown = (vpp.Signal("mean", "V", "mean"),)
        return vpp.Model("Mean", "a mean", (vpp.Signal("u", "V", "in"),), shown, effects, black_box=box)

    path = vpp.export_fmu(model("running_mean"), tmp_path / "fmus", values={"gain": 3.0})["Mean.fmu"]
    monkeypatch.delitem(sys.modules, "running_mean")
    slave = Slave(Fmu(path))
    shown = [slave.step({"u": u}, 0.1, "mean")[0] for u in (1.0, 2.0, 6.0)]
    kept = slave.kept()
    shown += slave.step({"u": 7.0}, 0.1, "mean")
    slave.restore(kept)
    assert slave.step({"u": 7.0}, 0.1, "mean") == shown[-1:]
    assert shown == [3.0, 4.5, 9.0, 15.0]
    assert "python, which alone can pack it" in refusal(native_fmu, model("running_mean"))
    assert "which imports vpp_fmu" in refusal(check_model, "here", model("with_ours"))
