"""Hosts and checkers without Python: a small host in C (`host.c`), and others if they are installed.

A Python FMU needs an interpreter in its host's process: the three lines of fmu_src/README.md load it there.
"""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import fmu_src
from vpp_fmu.fmu import Fmu
from vpp_fmu.native.compiler import compiler

STEPS, STEP, SHARE = 250, 0.004, 0.6
"""Communication steps, s; the first input as a share of its nominal value."""


def three_lines() -> str:
    """The README's shell lines for a host without Python."""
    page = (Path(fmu_src.__file__).parent / "README.md").read_text()
    lines = re.findall(r"^    (export (?:LD_PRELOAD|PYTHONHOME|PYTHONPATH)=.*)$", page, re.MULTILINE)
    return "\n".join(lines)


def no_libpython() -> str:
    """Why this Python cannot be loaded into another process; empty if it can."""
    shared = Path(sysconfig.get_config_var("LIBDIR") or "", sysconfig.get_config_var("INSTSONAME") or "none")
    if sys.platform != "linux":
        return "LD_PRELOAD is Linux's"
    return "" if shared.suffix != ".a" and shared.is_file() else "this Python has no shared library (libpython)"


def built(folder: Path) -> Path:
    """Compile `host.c`. Raises CompilerMissing."""
    source = Path(__file__).with_name("host.c")
    subprocess.run([compiler(), "-std=gnu99", "-O1", "-w", str(source), "-o", "host", "-ldl"], cwd=folder, check=True)
    return folder / "host"


def started(command: Sequence[str | Path], lines: str = "", folder: Path | None = None) -> subprocess.CompletedProcess:
    """Run a command after these lines of shell, with this Python as `python3`."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    clean = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
    shell = ["sh", "-c", f'{lines}\nexec "$@"', "sh", *map(str, command)]
    return subprocess.run(
        shell, cwd=folder, env=clean | {"PATH": path}, check=False, capture_output=True, text=True, timeout=300
    )


def in_c(host: Path, fmu: Fmu, lines: str = "", steps: int = STEPS, step: float = STEP) -> subprocess.CompletedProcess:
    """Run an FMU in the C host; it prints the Real outputs, one a line."""
    given = next((v for v in fmu.variables.values() if v.causality == "input"), None)
    shown = [v.valueReference for v in fmu.variables.values() if v.causality == "output" and v.type == "Real"]
    value = SHARE * float(given.nominal or 1.0) if given else "nan"
    resources = Path(fmu.folder, "resources").as_uri()
    return started([host, fmu.library, fmu.description.guid, resources, value, steps, step, *shown], lines)


@dataclass(frozen=True)
class Checker:
    """An optional program: `variable` of the environment names it, else it is found by one of `names` beside this Python or on
    PATH.

    `versions`: FMI versions that it knows. `options`: words before the FMU's name. `verdict`: pattern of the lines that have
    its result (default: the last line).
    """

    name: str
    variable: str
    names: tuple[str, ...]
    versions: tuple[str, ...]
    options: tuple[str, ...] = ()
    verdict: str = ""

    def program(self) -> list[str]:
        """The words that start it; none if it is not installed. A .jar needs java."""
        places = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
        there = filter(None, map(partial(shutil.which, path=places), self.names))
        found = os.environ.get(self.variable) or next(there, None)
        if found and found.endswith(".jar"):
            java = shutil.which("java")
            return [java, "-jar", found] if java else []
        return [found] if found else []

    def said(self, done: subprocess.CompletedProcess) -> str:
        """Its result for an FMU."""
        lines = (done.stdout.strip() or done.stderr.strip()).splitlines()
        return " ".join([line for line in lines if re.search(self.verdict, line)] if self.verdict else lines[-1:])


STOP = str(STEPS * STEP)
CHECKERS = (
    Checker("VDMCheck2", "VDMCHECK2", ("VDMCheck2.sh",), ("2.0",)),
    Checker("VDMCheck3", "VDMCHECK3", ("VDMCheck3.sh",), ("3.0",)),
    Checker("fmusim", "FMUSIM", ("fmusim",), ("2.0", "3.0"), ("--interface-type", "cs", "--stop-time", STOP)),
    Checker("fmutool", "FMUTOOL", ("fmutool",), ("2.0", "3.0"), ("-check", "-input"), r"compliant|semantic error|ERROR"),
    Checker("fmuCheck", "FMUCHECK", ("fmuCheck", "fmuCheck.linux64"), ("2.0",), ("-h", str(STEP), "-s", STOP, "-l", "3")),
)


def checked(fmus: Mapping[tuple[str, str, str], Path]) -> list[str]:
    """A table row for each checker and FMU, by (model, flavour, version of FMI): exit code and result; one row for a checker
    that is not installed. Python FMUs run after the README's three lines."""
    rows = []
    for checker in CHECKERS:
        program = checker.program()
        if not program:
            rows.append(f"| {checker.name} | | not run here: neither {checker.variable} nor {checker.names[0]} is there |")
            continue
        for (model, flavour, version), path in fmus.items():
            if version not in checker.versions:
                continue
            with tempfile.TemporaryDirectory() as work:
                lines = three_lines() if flavour == "Python" else ""
                done = started([*program, *checker.options, path.resolve()], lines, Path(work))
            said = " ".join(checker.said(done).replace("|", " ").split())
            rows.append(f"| {checker.name} | {model}, {flavour}, FMI {version} | {done.returncode}: {said} |")
    return rows
