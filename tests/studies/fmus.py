"""python -m tests.studies fmus [--steps N] [--calls N]: the exported FMUs over long runs, and under misuse.

Every effect of the library is on. The model's functions are the reference for the Python FMU, the native FMU and, where
qemu-aarch64 and ziglang are installed, the native FMU built for 64-bit ARM. Then follow the table of calls out of order and
with bad arguments (`tests/misuse.py`) on both flavours, the native FMU as FMI 3.0 against the one as FMI 2.0 in fmpy, and
random calls on both under the sanitizers of addresses and of undefined behaviour.
"""

import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

import numpy as np
from fmpy.validation import validate_fmu

from fmu_src.two_masses import MODEL
from vpp_fmu.export import native_fmu, python_fmu
from vpp_fmu.fmu import Fmu, FmuInstance, steps_in_fmi_3
from vpp_fmu.invariants import random_steps, reference
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import BASE

sys.path.append(str(Path(__file__).parents[1]))
import misuse
from arm import missing, outputs_on_arm
from builders import ALL_ON, MODELS, PROBES
from fuzz import fuzz, fuzzer

STEP, MEMORY_STEPS, LIVES = 0.004, 1_000_000, 1000
OUTPUTS = tuple(s.name for s in ALL_ON.outputs)


def main(parser, arguments):
    parser.add_argument("--steps", type=int, default=60_000, metavar="N", help="communication steps (default: %(default)s)")
    parser.add_argument("--calls", type=int, default=1_000_000, metavar="N", help="random calls (default: %(default)s)")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        paths = written(Path(folder))
        for path in paths.values():
            problems = validate_fmu(str(path))
            print(f"{path.name}: fmpy validate: {len(problems)} problems", flush=True)
        bits(paths, options.steps)
        versions(Path(folder), options.steps)
        memory(paths["native"])
        misused(Path(folder))
        fuzzed(Path(folder), options.calls)


def written(folder: Path) -> dict[str, Path]:
    """Write the FMUs, by name, and check that a second export has the same bytes."""
    models = {"python": (python_fmu, ALL_ON, PROBES), "native": (native_fmu, ALL_ON, PROBES)}
    models |= {"plain": (native_fmu, BASE, {}), "controller": (native_fmu, CONTROLLER, {})}
    paths = {}
    for name, (make, model, values) in models.items():
        paths[name] = folder / f"{name}.fmu"
        paths[name].write_bytes(make(model, values))
        again = make(model, values) == paths[name].read_bytes()
        size = paths[name].stat().st_size
        print(f"{name}.fmu: {size} bytes, a second export has {'the same' if again else 'OTHER'} bytes")
    return paths


def bits(paths: dict[str, Path], steps: int) -> None:
    """Whether each flavour gives the functions' numbers to the bit over `steps` communication steps."""
    commands = random_steps(steps + 1, 100, seed=1, model=ALL_ON)
    rows = np.column_stack(list(commands.values()))
    exact = reference(ALL_ON, PROBES, commands, np.full(steps, STEP))
    shown = {name: stepped(paths[name], list(commands), rows) for name in ("python", "native")}
    if reason := missing():
        print(f"64-bit ARM: not run: {reason}")
    else:
        shown["64-bit ARM under qemu"] = np.vstack([exact[:1], outputs_on_arm(ALL_ON, PROBES, rows, STEP)])
    for name, outputs in shown.items():
        equal = int(np.sum(np.all(outputs == exact, axis=1)))
        print(f"{name}: {equal - 1} of {steps} steps are the functions' to the bit", flush=True)


def stepped(path: Path, names: list[str], rows: np.ndarray) -> np.ndarray:
    """Outputs (rows, outputs) of an FMU under inputs (rows, inputs)."""
    fmu = Fmu(path)
    instance = FmuInstance(fmu, names, OUTPUTS)
    held = rows.tolist()
    shown = [instance.start(held[0])]
    step = instance.stepper(STEP)
    shown += [step(row) for row in held[:-1]]
    instance.close()
    fmu.close()
    return np.array(shown)


def versions(folder: Path, steps: int) -> None:
    """Whether FMI 3.0's FMU is valid, and gives FMI 2.0's outputs to the bit in fmpy over `steps` communication steps."""
    for name, (model, values) in MODELS.items():
        inputs = random_steps(steps + 1, 100, seed=2, model=model)
        held = [dict(zip(inputs, row, strict=True)) for row in zip(*(c.tolist() for c in inputs.values()), strict=True)]
        shown = []
        for version in ("2.0", "3.0"):
            path = folder / f"{name}.fmi{version[0]}.fmu"
            path.write_bytes(native_fmu(model, values, version=version))
            outputs = [s.name for s in model.outputs]
            shown.append(
                steps_in_fmi_3(path, held, STEP, outputs) if version == "3.0" else np.array(in_fmi_2(path, held, outputs))
            )
        equal = int(np.sum(np.all(shown[0] == shown[1], axis=1)))
        moved = ", ".join(
            f"{s.name} over {np.ptp(column):.4g} {s.unit}" for s, column in zip(model.outputs, shown[1].T, strict=True)
        )
        print(f"{path.name}: fmpy validate: {len(validate_fmu(str(path)))} problems")
        print(f"{path.name}: {equal - 1} of {steps} steps in fmpy are FMI 2.0's to the bit; {moved}", flush=True)


def in_fmi_2(path: Path, held: list, outputs: list[str]) -> list[list[float]]:
    """The same of an FMI 2.0 FMU."""
    with closing(Fmu(path)) as fmu:
        instance = FmuInstance(fmu, list(held[0]), outputs)
        rows, step = [instance.start(list(held[0].values()))], instance.stepper(STEP)
        rows += [step(list(inputs.values())) for inputs in held[:-1]]
        instance.close()
    return rows


def memory(path: Path) -> None:
    """Growth of the process over many steps and over many lives of an instance."""
    fmu = Fmu(path)
    names = [u.name for u in ALL_ON.inputs]
    rows = np.column_stack(list(random_steps(1000, 20, model=ALL_ON).values())).tolist()
    instance = FmuInstance(fmu, names, OUTPUTS)
    instance.start(rows[0])
    step = instance.stepper(STEP)
    for row in rows:
        step(row)
    before, began = resident(), time.perf_counter()
    for k in range(MEMORY_STEPS):
        step(rows[k % 1000])
    seconds = time.perf_counter() - began
    print(f"{MEMORY_STEPS} steps: memory grew by {resident() - before} kB, {1e6 * seconds / MEMORY_STEPS:.2f} us a step")
    instance.close()
    for lives in (LIVES // 10, LIVES):
        before = resident()
        for _ in range(lives):
            one = FmuInstance(fmu, names, OUTPUTS)
            one.start(rows[0])
            one.stepper(STEP)(rows[1])
            one.close()
    print(f"{LIVES} instances made, stepped and freed: memory grew by {resident() - before} kB")
    fmu.close()


def misused(folder: Path) -> None:
    """Print the table of misuse, a line for each case."""
    outcomes = {}
    for flavour, make in (("native", native_fmu), ("python", python_fmu)):
        paths = {name: folder / f"{name}.{flavour}.fmu" for name in MODELS}
        for name, path in paths.items():
            path.write_bytes(make(*MODELS[name]))
        outcomes[flavour] = misuse.outcomes(paths)
    print("\n| call | both flavours | what is said |\n|---|---|---|")
    wrong = 0
    for case, native, python in zip(misuse.CASES, outcomes["native"], outcomes["python"], strict=False):
        problem = misuse.verdict(case, native, python)
        wrong += bool(problem)
        print(f"| {case.name} | {'DIFFER: ' + problem if problem else case.outcome} | {native['said']} |")
    died = [flavour for flavour, cases in outcomes.items() if len(cases) < len(misuse.CASES)]
    print(f"{len(misuse.CASES)} calls: {wrong} differ from what they must be; processes that died: {', '.join(died) or 'none'}")


def fuzzed(folder: Path, calls: int) -> None:
    """Random calls on each model's source in each version of FMI."""
    for name, (model, values) in (MODELS | {"two masses": (MODEL, {})}).items():
        for version in ("2.0", "3.0"):
            program, watched = fuzzer(folder, model, values, version)
            done = fuzz(program, 1, calls)
            said = (done.stdout or done.stderr).strip().splitlines()[-1:]
            under = "under ASan and UBSan" if watched else "WITHOUT sanitizers, which this compiler lacks"
            print(
                f"{name}, FMI {version}: {calls} random calls {under}: exit code {done.returncode}; {''.join(said)}", flush=True
            )


def resident() -> int:
    """Resident memory of this process, kB."""
    return 4 * int(Path("/proc/self/statm").read_text().split()[1])
