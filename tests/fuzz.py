"""Random calls, legal or not, on a native FMU's source (`interop/fuzz.c`)."""

import subprocess
from collections.abc import Mapping
from pathlib import Path

from vpp_fmu.export.c_text import c_text
from vpp_fmu.kernel.types import Model
from vpp_fmu.native.compiler import compiler

SOURCE = Path(__file__).parent / "interop" / "fuzz.c"
FLAGS = ("-std=c99", "-w", "-O1", "-ffp-contract=off")
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
CPU_SECONDS = 60.0, 0.01
"""Limits of CPU time of a run, and of each of its calls in addition: a run that exceeds them hangs."""


def fuzzer(folder: Path, model: Model, values: Mapping[str, float], version: str) -> tuple[Path, bool]:
    """(program for a model's FMU of this version of FMI, whether sanitizers are compiled in: not every compiler has them)."""
    name = f"{model.name}{len(model.effects)}_{version[0]}"
    (folder / f"{name}.c").write_text(c_text(model, model.values(values), "{}", version) + SOURCE.read_text())
    build = [compiler(), *FLAGS, f"-DVERSION={version[0]}", f"{name}.c", "-o", name, "-lm"]
    watched = not subprocess.run([*build, *SANITIZERS], cwd=folder, check=False, capture_output=True).returncode
    if not watched:
        subprocess.run(build, cwd=folder, check=True)
    return folder / name, watched


def fuzz(program: Path, seed: int, calls: int) -> subprocess.CompletedProcess:
    """Run `calls` random calls: exit code 0 and a summary of the calls, or the reason of the failure."""
    once, each = CPU_SECONDS
    limited = ["sh", "-c", 'ulimit -t "$0"; exec "$@"', f"{once + each * calls:.0f}"]
    return subprocess.run([*limited, str(program), str(seed), str(calls)], check=False, capture_output=True, text=True)
