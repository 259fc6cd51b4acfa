"""The release of the interpreter by pythonfmu's binary, for which pythonfmu is offered a patch."""

import os
import re
import runpy
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import fmu_src
from vpp_fmu.export import python_fmu
from vpp_fmu.kernel.plant import BASE

UPSTREAM = Path(fmu_src.__file__).parent / "upstream"


def added(name: str) -> str:
    """The test that a patch adds."""
    hunk = re.split(r"^\+\+\+ b/.*tests/test_\w+\.py\n", (UPSTREAM / f"{name}.patch").read_text(), flags=re.M)[1]
    return "".join(line[1:] + "\n" for line in hunk.splitlines() if line.startswith("+"))


def test_a_script_that_ran_our_fmu_ends_without_a_crash(tmp_path):
    """A plain script; one in which freed memory is used again at the end of the process, so that a second release of the
    interpreter crashes at once; and the same where our slave assumes a system without the fault."""
    if not (shutil.which("cc") and sys.platform == "linux"):
        pytest.skip("no C compiler on Linux")
    (tmp_path / "offered.py").write_text(added("pythonfmu-0.7.0-exit"))
    offered = runpy.run_path(str(tmp_path / "offered.py"))
    (tmp_path / "plant.fmu").write_bytes(python_fmu(BASE))
    (tmp_path / "reuse.c").write_text(offered["REUSE"])
    subprocess.run(["cc", "-shared", "-fPIC", "-o", "reuse.so", "reuse.c", "-ldl"], cwd=tmp_path, check=True)
    reuse = {"LD_PRELOAD": str(tmp_path / "reuse.so")}
    plain = "import sys, fmpy\nfmpy.simulate_fmu(sys.argv[1], stop_time=0.1, output_interval=0.01, validate=False)\n"
    idle = "import os\ndel os.RTLD_NOLOAD\n"
    scripts = {0: [(plain, {}), (offered["HOST"], reuse)], -signal.SIGSEGV: [(idle + offered["HOST"], reuse)]}
    for code, script, environment in ((code, *one) for code, those in scripts.items() for one in those):
        words = [sys.executable, "-c", script, str(tmp_path / "plant.fmu")]
        done = subprocess.run(words, env=os.environ | environment, check=False, capture_output=True)
        assert done.returncode == code, done.stderr
