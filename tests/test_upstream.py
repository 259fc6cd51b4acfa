"""Patches offered to pythonfmu and fmpy: their tests run against the installed packages."""

import importlib.util
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
PATCHES = {
    "pythonfmu-0.7.0-exceptions": ([["2", "2"]], "assert -11 == 0"),
    "pythonfmu-0.7.0-exit": ([["2", "1"]], "assert -11 == 0"),
    "pythonfmu-0.7.0-uri": ([["16", "3"]], "assert -11 == 0"),
    # an error since numpy 2.4, a warning before
    "fmpy-0.3.32-single-row": ([["2", "1"]], "only 0-dimensional arrays can be converted|an array with ndim > 0 to a scalar"),
}
"""Lines added and removed in the source, and a pattern of the test's output while the installed package needs the patch."""
each_patch = pytest.mark.parametrize("name", PATCHES)


def patch(name: str) -> Path:
    """The file of a patch."""
    return UPSTREAM / f"{name}.patch"


def added(name: str) -> str:
    """The test that a patch adds."""
    hunk = re.split(r"^\+\+\+ b/.*tests/test_\w+\.py\n", patch(name).read_text(), flags=re.M)[1]
    return "".join(line[1:] + "\n" for line in hunk.splitlines() if line.startswith("+"))


def ran(name: str, folder: Path, **environment: str) -> subprocess.CompletedProcess:
    """Run the test that a patch adds, in a folder. Numpy's announcement of a future error counts as an error."""
    test = folder / "test_offered.py"
    test.write_text(added(name))
    run = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", str(folder), str(test)]
    strict = ["-W", "error:Conversion of an array:DeprecationWarning"]
    return subprocess.run(run + strict, cwd=folder, env=os.environ | environment, check=False, capture_output=True, text=True)


@pytest.mark.slow
@each_patch
def test_the_installed_package_still_needs_the_patch(name, tmp_path):
    """pythonfmu's slave crashes after an exception, at the end of the process, or in a folder whose name a URI escapes; fmpy
    refuses an input of one row. Once this test fails, the patch or its like is in, and the workarounds must go: in
    fmu_src/slave.py `_kept` takes references that nobody drops, and `_release_at_exit` is idle; vpp_fmu/export/location.py with
    fmu_src/location.s; fmu_src/README.md advises to write constant inputs twice."""
    done = ran(name, tmp_path)
    if "1 skipped" in done.stdout:
        pytest.skip("no C compiler")
    assert done.returncode == 1
    assert re.search(PATCHES[name][1], done.stdout), done.stdout


def test_patched_fmpy_holds_an_input_of_one_row(tmp_path):
    """The patch on a copy of the installed fmpy: its test passes, and one row gives the result of two equal rows."""
    source = tmp_path / "src" / "fmpy"
    shutil.copytree(Path(importlib.util.find_spec("fmpy").origin).parent, source, ignore=shutil.ignore_patterns("__pycache__"))
    apply = ["git", "apply", "--include=src/*", str(patch("fmpy-0.3.32-single-row"))]
    subprocess.run(apply, cwd=tmp_path, env=os.environ | {"GIT_CEILING_DIRECTORIES": str(tmp_path.parent)}, check=True)
    mended = os.pathsep.join(filter(None, [str(source.parent), os.environ.get("PYTHONPATH")]))
    done = ran("fmpy-0.3.32-single-row", tmp_path, PYTHONPATH=mended)
    assert done.returncode == 0, done.stdout
    (tmp_path / "plant.fmu").write_bytes(python_fmu(BASE))
    shown = {}
    for rows in ("0,4000,5\n", "0,4000,5\n1,4000,5\n"):
        (tmp_path / "in.csv").write_text(f"time,omega_ref,beta_ref\n{rows}")
        command = ["fmpy", "simulate", "plant.fmu", "--input-file", "in.csv", "--output-file", "out.csv"]
        run = [sys.executable, "-m", *command, "--stop-time", "1", "--output-interval", "0.1"]
        subprocess.run(run, cwd=tmp_path, env=os.environ | {"PYTHONPATH": mended}, check=True, capture_output=True)
        shown[rows] = (tmp_path / "out.csv").read_text()
    one, two = shown.values()
    assert one.count("\n") > 10
    assert one == two


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


@each_patch
def test_the_patch_is_one_that_git_reads(name, tmp_path):
    """Its line counts are right; the files that it changes are not here."""
    read = ["git", "apply", "--numstat", str(patch(name))]
    done = subprocess.run(read, cwd=tmp_path, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    lines = [line.split("\t")[:2] for line in done.stdout.splitlines()]
    assert lines == [*PATCHES[name][0], [str(added(name).count("\n")), "0"]]
