"""python -m tests.interop exporter: the models of the tutorial as FMUs, in every host, beside pythonfmu.

Prints tables: hosts and checkers; errors and bits; lines and speed beside the pythonfmu twin. A host that is not
installed is listed as such (`make interop` installs them).
"""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import fmpy
import numpy as np
from fmpy.validation import validate_fmu

from tests.interop import hosts
from vpp_fmu.errors import CompilerMissing
from vpp_fmu.export import native_fmu, python_fmu
from vpp_fmu.fmu import Fmu, FmuInstance, steps_in_fmi_3
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.kernel.types import Model

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
    print(f"\nfmpy {fmpy.__version__}; the Python flavour has no FMI 3.0: pythonfmu's binary has none")


if __name__ == "__main__":
    host, path, given, shown = json.loads(sys.argv[1])
    print(json.dumps(HOSTS[host][1](path, dict(map(tuple, given)), shown)))
