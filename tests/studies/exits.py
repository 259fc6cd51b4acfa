"""python -m tests.studies exits [--runs N] [--minutes M]: exit codes of plain scripts that run the Python plant FMU in fmpy.

Three kinds in turn: a plain script; one in which freed memory is used again at the end of the process (`fmu_src/upstream`), so
that a second release of the interpreter crashes at once; and, as the control, one run in twenty of the latter with the FMU's
fix disabled. Run it beside other work, because an idle machine hides failures.
"""

import os
import runpy
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import fmu_src
from vpp_fmu.export import python_fmu
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.native.compiler import compiler

PATCH = Path(fmu_src.__file__).parent / "upstream" / "pythonfmu-0.7.0-exit.patch"
PLAIN = "import sys, fmpy\nfmpy.simulate_fmu(sys.argv[1], stop_time=0.1, output_interval=0.01, validate=False)\n"
IDLE = "import os\ndel os.RTLD_NOLOAD\n"
"""Prefix of a script, by which the FMU's slave assumes a system without the fault."""
CONTROL = 20


def main(parser, arguments):
    parser.add_argument("--runs", type=int, default=3000, metavar="N", help="runs of each kind (default: %(default)s)")
    parser.add_argument("--minutes", type=float, default=60.0, metavar="M", help="end after this (default: %(default)s)")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        counts = ended(Path(folder), options.runs, 60.0 * options.minutes)
    for kind, codes in counts.items():
        ends = ((n, signal.Signals(-code).name if code < 0 else code) for code, n in sorted(codes.items(), reverse=True))
        print(f"{kind}: {codes.total()} runs: {', '.join(f'{n} ended with {end}' for n, end in ends)}")


def ended(folder: Path, runs: int, seconds: float) -> dict[str, Counter]:
    """Exit codes by kind, after `runs` rounds or `seconds`."""
    text = PATCH.read_text().split("+++ b/pythonfmu/tests/test_exit.py\n")[1]
    (folder / "offered.py").write_text("".join(f"{line[1:]}\n" for line in text.splitlines() if line.startswith("+")))
    offered = runpy.run_path(str(folder / "offered.py"))
    (folder / "plant.fmu").write_bytes(python_fmu(BASE))
    (folder / "reuse.c").write_text(offered["REUSE"])
    subprocess.run([compiler(), "-shared", "-fPIC", "-o", "reuse.so", "reuse.c", "-ldl"], cwd=folder, check=True)
    reuse = os.environ | {"LD_PRELOAD": str(folder / "reuse.so")}
    scripts = {
        "a plain script": (PLAIN, os.environ),
        "freed memory used again": (offered["HOST"], reuse),
        "control": (IDLE + offered["HOST"], reuse),
    }
    counts: dict[str, Counter] = {kind: Counter() for kind in scripts}
    end = time.monotonic() + seconds
    for k in range(runs):
        for kind, (script, environment) in scripts.items():
            if time.monotonic() < end and (kind != "control" or k % CONTROL == 0):
                words = [sys.executable, "-c", script, str(folder / "plant.fmu")]
                done = subprocess.run(words, env=environment, check=False, capture_output=True)
                counts[kind][done.returncode] += 1
    return counts
