"""python -m tests.interop exporter: the models of the tutorial as FMUs, in every host, beside pythonfmu.

Prints tables: hosts and checkers; errors and bits; lines and speed beside the pythonfmu twin; seconds of export against size;
memory of instances; each fault that it had, before and now. A host that is not installed is listed as such
(`make interop` installs them).
"""

import contextlib
import io
import json
import os
import re
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import fmpy
import numpy as np
from fmpy.validation import validate_fmu

from tests.interop import hosts
from vpp_fmu import export_fmu
from vpp_fmu.errors import CompilerMissing, VppError
from vpp_fmu.export import native_fmu, python_fmu
from vpp_fmu.export.checks import check_model
from vpp_fmu.export.description import Experiment
from vpp_fmu.export.own_model import find_model
from vpp_fmu.export.trial import try_fmu
from vpp_fmu.fmu import Fmu, FmuInstance, steps_in_fmi_3
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.kernel.types import Effect, Model, Parameter, Signal, State

sys.path.append(str(Path(__file__).parents[1]))
from six_models import CASES, Case

STEP, STEPS = 0.01, 300  # s; of the comparisons between hosts: the models need no more than 3 s to show themselves
SPEEDS = {0.001: 4000, 0.01: 4000, 1.0: 400}
"""Communication steps, s, with the number of steps that are timed."""
REPEATS = 3


def loaded_by_libcosim(path: str, given: Mapping[int, float], shown: Sequence[int]) -> list[float]:
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimManipulator import CosimManipulator
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.ERROR)
    execution = CosimExecution.from_step_size(int(STEP * 1e9))
    index = execution.add_local_slave(CosimLocalSlave(path, "model"))
    observer, manipulator = CosimObserver.create_last_value(), CosimManipulator.create_override()
    execution.add_observer(observer)
    execution.add_manipulator(manipulator)
    if given:
        manipulator.slave_real_values(index, list(given), list(given.values()))
    execution.step(STEPS)
    return observer.last_real_values(index, list(shown))


def loaded_by_ecos(path: str, given: Mapping[str, float], shown: Sequence[str]) -> list[float]:
    from ecospy import EcosSimulation, EcosSimulationStructure

    structure = EcosSimulationStructure()
    structure.add_model("model", path)
    with EcosSimulation(structure=structure, step_size=STEP) as simulation:
        simulation.init()
        for name, value in given.items():
            simulation.set_real(f"model::{name}", value)
        simulation.step(STEPS)
        found = [simulation.get_real(f"model::{name}") for name in shown]
        simulation.terminate()
    return found


HOSTS = {"libcosim": ("libcosimpy", loaded_by_libcosim), "Ecos": ("ecospy", loaded_by_ecos)}


def hosted(name: str, path: Path, case: Case, model: Model, right: Sequence[float]) -> str:
    """A host of another process against the functions; the inputs are those at the start."""
    package, _ = HOSTS[name]
    if find_spec(package) is None:
        return f"not run: {package} is not installed"
    real = [y.name for y in model.outputs if y.kind == "Real"]
    names = [*(u.name for u in model.inputs), *(y.name for y in model.outputs)]
    key = (lambda n: n) if name == "Ecos" else names.index
    given = [(key(n), x) for n, x in case.inputs(0.0).items()]
    words = json.dumps([name, str(path), given, [key(n) for n in real]])
    libraries = os.pathsep.join([str(Path(sys.prefix, "lib")), os.environ.get("LD_LIBRARY_PATH", "")])
    command = [sys.executable, "-m", "tests.interop.exporter", words]
    done = subprocess.run(
        command, check=False, capture_output=True, text=True, timeout=120, env=os.environ | {"LD_LIBRARY_PATH": libraries}
    )
    if done.returncode:
        return f"fails: {(done.stderr.strip() or f'signal {-done.returncode}').splitlines()[-1][:80]}"
    shown = np.array(json.loads(done.stdout.splitlines()[-1]))
    off = np.max(np.abs(shown - right) / np.maximum(np.abs(right), 1e-3))
    return "same bits" if off == 0.0 else f"off by {off:.0e}"


def in_functions(case: Case, model: Model, inputs=None) -> list[list[float]]:
    """Outputs at each of the STEPS points, from the kernel's functions."""
    simulation = Simulation(model)
    rows = [list(simulation.start(case.inputs(0.0)).values())]
    for k in range(STEPS):
        rows.append(list(simulation.advance((inputs or case.inputs)(k * STEP), STEP).values()))
    return rows


def in_fmi_2(path: Path, case: Case, model: Model) -> list[list[float]]:
    """The same from an FMU in this process."""
    with contextlib.closing(Fmu(path)) as fmu:
        instance = FmuInstance(fmu, [u.name for u in model.inputs], [y.name for y in model.outputs])
        rows, step = [instance.start(list(case.inputs(0.0).values()))], instance.stepper(STEP)
        rows += [step(list(case.inputs(k * STEP).values())) for k in range(STEPS)]
        instance.close()
    return rows


def in_fmi_3(path: Path, case: Case, model: Model) -> list[list[float]]:
    held = [dict(case.inputs(k * STEP)) for k in range(STEPS + 1)]
    outputs = [y.name.removesuffix("[1]") if y.place else y.name for y in model.outputs if y.place < 2]
    return steps_in_fmi_3(path, held, STEP, outputs).tolist()


def checked_and_hosted(folder: Path, host: Path | None, fmus: Mapping[tuple[str, str, str], Path]) -> None:
    """Every FMU in validators and hosts."""
    fmutool = next(checker for checker in hosts.CHECKERS if checker.name == "fmutool")
    print("| model | FMU | fmpy validate | fmutool | Ecos | libcosim | host in C | bits |\n|---|---|---|---|---|---|---|---|")
    in_c: dict[str, str] = {}
    for (name, flavour, version), path in fmus.items():
        case = CASES[name]
        model = case.model()
        exact = in_functions(case, model)
        real = [k for k, y in enumerate(model.outputs) if y.kind == "Real"]
        held = np.array(in_functions(case, model, lambda _, case=case: case.inputs(0.0))[-1])[real]
        cells = [f"{len(validate_fmu(str(path)))} problems"]
        if program := fmutool.program():
            lines = hosts.three_lines() if flavour == "Python" else ""
            done = hosts.started([*program, *fmutool.options, path.resolve()], lines, folder)
            cells.append(fmutool.said(done)[:60])
        else:
            cells.append("not installed")
        if version == "3.0":
            shown = in_fmi_3(path, case, model)
            cells += ["FMI 2.0 only"] * 3
        else:
            shown = in_fmi_2(path, case, model)
            cells += [hosted(other, path, case, model, held) for other in ("Ecos", "libcosim")]
            with contextlib.closing(Fmu(path)) as fmu:
                if host is None or (flavour == "Python" and hosts.no_libpython()):
                    cells.append("not run: no compiler, or no libpython")
                else:
                    done = hosts.in_c(host, fmu, hosts.three_lines() if flavour == "Python" else "")
                    same = in_c.setdefault(name, done.stdout) == done.stdout
                    cells.append(f"exit {done.returncode}" if done.returncode else "same bits" if same else "OTHER BITS")
        cells.append("the functions'" if shown == exact else "OTHER")
        print(f"| {name} | {flavour}, FMI {version} | {' | '.join(cells)} |", flush=True)


def errors() -> None:
    print("\n| model | error at steps of 1 ms | 10 ms | 1 s | against |\n|---|---|---|---|---|")
    for name, case in CASES.items():
        cells, model = [], case.model()
        for step in SPEEDS:
            simulation, n = Simulation(model), round(4.0 / step)
            simulation.start(case.inputs(0.0))
            rows = [simulation.advance(case.inputs(k * step), step) for k in range(n)]
            every = max(1, n // 40)
            times = (1.0 + np.arange(n)[every - 1 :: every]) * step
            right = case.solution(times)
            shown = {output: np.array([row[output] for row in rows[every - 1 :: every]]) for output in right}
            cells.append(f"{max(np.abs(shown[y] - right[y]).max() / np.abs(right[y]).max() for y in right):.0e}")
        how = case.solution.__doc__.splitlines()[0]
        print(f"| {name} | {' | '.join(cells)} | {how} |", flush=True)


def microseconds(host: Path, path: Path, step: float, steps: int, python: bool) -> float:
    """The least time of a step in the C host, of some repeats."""
    with contextlib.closing(Fmu(path)) as fmu:
        lines = (hosts.three_lines() if python else "") + "\nexport TIMED=1"
        done = [hosts.in_c(host, fmu, lines, steps, step) for _ in range(REPEATS)]
    return min(float(one.stderr.split(" us a step")[0].split()[-1]) for one in done)


def beside_pythonfmu(folder: Path, host: Path | None, fmus: Mapping[tuple[str, str, str], Path]) -> None:
    if host is None or hosts.no_libpython():
        print("\nspeed beside pythonfmu: not run here: no compiler, or no libpython")
        return
    heads = " | ".join(f"{1e3 * step:g} ms: us of the twin; times faster: Python, native" for step in SPEEDS)
    print(f"\n| model | lines, of the twin | fmpy validate of the twin | {heads} |\n|---|---|---|---|---|---|")
    for name, case in CASES.items():
        if not case.twin.is_file():
            continue
        build = [sys.executable, "-m", "pythonfmu", "build", "-f", str(case.twin), "-d", str(folder)]
        subprocess.run(build, check=True, capture_output=True, text=True)
        twin = next(path for path in folder.glob("*Twin.fmu") if path.stem.removesuffix("Twin") == case.model().name)
        lines = [len([x for x in file.read_text().splitlines() if x.strip()]) for file in (case.source, case.twin)]
        problems, cells = len(validate_fmu(str(twin))), []
        for step, steps in SPEEDS.items():
            slow = microseconds(host, twin, step, steps, True)
            fast = [microseconds(host, fmus[name, flavour, "2.0"], step, steps, flavour == "Python") for flavour in FLAVOURS]
            cells.append(f"{slow:.1f}; {', '.join(f'{slow / own:.1f}' for own in fast)}")
        print(f"| {name} | {lines[0]}, {lines[1]} | {problems} problems | {' | '.join(cells)} |", flush=True)


FLAVOURS = ("Python", "native")


def table_of(n: int) -> Model:
    """A table of n points."""
    xs = np.linspace(0.0, 100.0, n)
    ys = np.sin(xs)
    effect = Effect("table", "a sine", output=lambda ops, s, x, p: {"y": ops.table(s.u, xs, ys, "cubic")})
    return Model("Table", "a sine", (Signal("u", "1", "u", nominal=100.0),), (Signal("y", "1", "y"),), (effect,))


def network_of(n: int) -> Model:
    """A rod of n nodes."""

    def derivative(ops, s, x, p):
        T = [s.hot, *x.T, s.hot]
        return {"T": [p.g * (T[k - 1] - 2.0 * T[k] + T[k + 1]) for k in range(1, n + 1)]}

    rate, state = Parameter("g", "Hz", 0.2, 0.0, 1.0, "rate"), State("T", "degC", "temperatures", 20.0, size=n)
    effect = Effect("rod", "conducts", derivative=derivative, parameters=(rate,), states=(state,), largest_step=0.5)
    outputs = (Signal("T", "degC", "temperatures", nominal=100.0, size=n),)
    return Model("Rod", "a rod", (Signal("hot", "degC", "ends", nominal=100.0, start=20.0),), outputs, (effect,))


def seconds_of_export(host: Path | None) -> None:
    print("\n| model | size | export, s: Python | native | FMI 3.0 | native step, us |\n|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for make, sizes in ((table_of, (100, 1000, 10_000)), (network_of, (10, 50, 100, 200, 500))):
            for n in sizes:
                cells, model = [], make(n)
                for maker in (python_fmu, native_fmu, partial(native_fmu, version="3.0")):
                    began = time.perf_counter()
                    content = maker(model)
                    cells.append(f"{time.perf_counter() - began:.1f}")
                    if maker is native_fmu:
                        path = Path(folder, f"{model.name}{n}.fmu")
                        path.write_bytes(content)
                cells.append(f"{microseconds(host, path, 0.5, 2000, False):.2f}" if host else "")
                print(f"| {model.name} | {n} | {' | '.join(cells)} |", flush=True)


CYCLES = """
import sys
from contextlib import closing
from pathlib import Path
from vpp_fmu.fmu import Fmu
from fmpy.fmi2 import FMU2Slave
def kib():
    return int(next(x for x in Path("/proc/self/status").read_text().splitlines() if x.startswith("VmRSS")).split()[1])
with closing(Fmu(sys.argv[1])) as fmu:
    slave = fmu.slave()
    def cycle(n):
        for _ in range(n):
            slave.instantiate()
            slave.setupExperiment()
            slave.enterInitializationMode()
            slave.exitInitializationMode()
            slave.terminate()
            slave.fmi2FreeInstance(slave.component)
    cycle(200)
    before = kib()
    cycle(1000)
    print(kib() - before)
"""


def memory(fmus: Mapping[tuple[str, str, str], Path]) -> None:
    print("\n| FMU | growth over 1000 cycles of instantiate and free |\n|---|---|")
    for (name, flavour, version), path in fmus.items():
        if name == "ODE" and version == "2.0":
            done = subprocess.run([sys.executable, "-c", CYCLES, str(path)], check=False, capture_output=True, text=True)
            said = f"{done.stdout.strip()} KiB" if done.returncode == 0 else (done.stderr.strip() or "died").splitlines()[-1]
            print(f"| {name}, {flavour} | {said} |", flush=True)


def _model(step, unit="V", minimum=-1e9, **more) -> Model:
    effect = Effect("part", "a part", step, **more)
    return Model("Part", "a part", (Signal("u", unit, "in"),), (Signal("y", "V", "out", minimum, 1e9),), (effect,))


def _counted(ops, s, x, p, dt):
    return {"y": x.y + 1.0}


def _chained(n: int) -> Model:
    def step(ops, s, x, p, dt):
        y = 0.0
        for k in range(n):
            y = ops.where(s.u > float(k), 0.5 * k + 0.1 * s.u, y)
        return {"y": y}, {}

    return _model(step)


def _said(doing) -> str:
    """What a call returns, or its message."""
    try:
        return str(doing())
    except VppError as error:
        return f"refused: {error}"
    except Exception as error:
        return f"TRACEBACK: {type(error).__name__}: {error}"


def _tried(model: Model, make=python_fmu, fmi: str = "2.0") -> str:
    check_model("model", model)
    try_fmu("model", model, model.values(), Experiment(), make(model), fmi)
    return "exported, tried"


def _read(model: Model, pattern: str) -> str:
    """What of its description has this pattern."""
    with zipfile.ZipFile(io.BytesIO(python_fmu(model))) as packed:
        return " ".join(re.findall(pattern, packed.read("modelDescription.xml").decode()))


def faults() -> None:
    """Each fault that the exporter had, in commit ffeb0d7 and now."""
    double = _model(lambda ops, s, x, p, dt: ({"y": 2.0 * s.u}, {}))
    cell = _model(lambda ops, s, x, p, dt: {"y": x.y}, states=(State("y", "V", "y", 80.0),), minimum=1.0, largest_step=1.0)
    counter = _model(_counted, states=(State("y", "V", "y", 0.0),), largest_step=1.0)
    text = _model(lambda ops, s, x, p, dt: ({"y": s.u}, {}), parameters=(Parameter("a", "1", "left", 0.0, 1.0, "a"),))
    unknown = _model(lambda ops, s, x, p, dt: ({"y": ops.cosh(s.u)}, {}))
    rows = (
        (
            "1",
            'refused: The unit "s" of variable "time" is not defined',
            lambda: _tried(double, partial(native_fmu, version="3.0"), "3.0"),
        ),
        ("2, 200 choices", "SyntaxError: too many nested parentheses", lambda: _tried(_chained(200))),
        ("2, 1000 choices", "77 s", lambda: _timed(partial(_tried, _chained(1000)))),
        ("2, 500 nodes", "over 150 s", lambda: _timed(partial(native_fmu, network_of(500)))),
        ("3, a state", "min and max of a signal in its unit", lambda: _read(cell, '<.*start="80.0".*>')),
        ("3, an output", "refused: signal y, start: found 0.0, expected 1.0", lambda: _tried(cell)),
        ("4, a counter at 0, 1, 2 s", "1, 1, 2", lambda: [_run_to(counter, k) for k in range(3)]),
        (
            "5",
            'author="vpp-fmu" version="0.2.0" license="MIT"',
            lambda: _read(replace(double, license="0BSD", author="A. Body"), ' (?:author|version|license)="[^"]*"'),
        ),
        ("6, a text", "TypeError: must be real number, not str", lambda: _tried(text)),
        ("6, the unit -", "AssertionError", lambda: _tried(_model(lambda ops, s, x, p, dt: ({"y": s.u}, {}), unit="-"))),
        ("6, an operation", "AttributeError: 'Numbers' object has no attribute", lambda: _tried(unknown)),
        ("6, a file", "No module named", lambda: find_model(f"{CASES['event'].source}:MODEL").name),
        ("7", "refused: found a Model, expected a ParameterSet", lambda: list(_exported(double))),
    )
    print("\n| fault | before | now |\n|---|---|---|")
    for what, before, now in rows:
        print(f"| {what} | {before} | {_said(now).replace('|', ' ')[:220]} |", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for version in ("2.0", "3.0"):
            words = ["export", "--model", f"{CASES['event'].source}:MODEL", "--flavour", "native", "--fmi", version]
            command = [sys.executable, "-m", "vpp_fmu", *words, "-o", folder]
            subprocess.run(command, check=True, capture_output=True)
        there = ", ".join(sorted(path.name for path in Path(folder).glob("*.fmu")))
    print(f"| 6, FMI 2.0, then 3.0 in one folder | the second removes the first | {there} |")


def _timed(doing) -> str:
    began = time.perf_counter()
    doing()
    return f"{time.perf_counter() - began:.1f} s"


def _run_to(model: Model, steps: int) -> float:
    simulation = Simulation(model)
    shown = simulation.start({"u": 1.0})
    for _ in range(steps):
        shown = simulation.advance({"u": 1.0}, 1.0)
    return shown["y"]


def _exported(model: Model) -> list[str]:
    with tempfile.TemporaryDirectory() as folder:
        return list(export_fmu(model, folder))


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder, fmus = Path(name), {}
        for case_name, case in CASES.items():
            model = case.model()
            makers = {("Python", "2.0"): python_fmu, ("native", "2.0"): native_fmu}
            makers["native", "3.0"] = partial(native_fmu, version="3.0")
            for (flavour, version), make in makers.items():
                path = folder / f"{model.name}.{flavour}.{version}.fmu"
                path.write_bytes(make(model))
                fmus[case_name, flavour, version] = path
        try:
            host: Path | None = hosts.built(folder)
        except CompilerMissing:
            host = None
        checked_and_hosted(folder, host, fmus)
        errors()
        beside_pythonfmu(folder, host, fmus)
        memory(fmus)
        seconds_of_export(host)
    faults()
    print(f"\nfmpy {fmpy.__version__}; the Python flavour has no FMI 3.0: pythonfmu's binary has none")


if __name__ == "__main__":
    host, path, given, shown = json.loads(sys.argv[1])
    print(json.dumps(HOSTS[host][1](path, dict(map(tuple, given)), shown)))
