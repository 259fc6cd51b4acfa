"""What is offered to pythonfmu upstream: the tests of the patches, against the binary that is installed."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

import fmu_src
from vpp_fmu.export import python_fmu
from vpp_fmu.kernel.plant import BASE

UPSTREAM = Path(fmu_src.__file__).parent / "upstream"
PATCHES = {
    "exceptions": ([["2", "2"]], "assert -11 == 0"),
    "exit": ([["2", "1"]], "assert -11 == 0"),
}
"""Lines added and taken away in the source, and what the test says as long as the installed binary needs the patch."""
each_patch = pytest.mark.parametrize("name", PATCHES)


def patch(name: str) -> Path:
    """The file of a patch."""
    return UPSTREAM / f"pythonfmu-0.7.0-{name}.patch"


def added(name: str) -> str:
    """The test that a patch adds."""
    hunk = patch(name).read_text().split(f"+++ b/pythonfmu/tests/test_{name}.py\n")[1]
    return "".join(line[1:] + "\n" for line in hunk.splitlines() if line.startswith("+"))


@each_patch
def test_the_installed_binary_still_needs_the_mend(name, tmp_path):
    """A slave of pythonfmu's own dies after an exception, or as the process ends. Once this fails, the patch or its like is in,
    and what fmu_src/slave.py does instead must go: `_kept` takes references that nobody drops, `_release_at_exit` is idle."""
    test = tmp_path / f"test_{name}.py"
    test.write_text(added(name))
    run = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", str(tmp_path), str(test)]
    done = subprocess.run(run, cwd=tmp_path, check=False, capture_output=True, text=True)
    if "1 skipped" in done.stdout:
        pytest.skip("no C compiler")
    assert done.returncode == 1
    assert PATCHES[name][1] in done.stdout, done.stdout


def test_a_script_that_ran_our_fmu_ends_in_spite_of_it(tmp_path):
    """The same host, under which pythonfmu's own slave dies."""
    (tmp_path / "test_exit.py").write_text(added("exit"))
    offered = runpy.run_path(str(tmp_path / "test_exit.py"))
    fmu = tmp_path / "plant.fmu"
    fmu.write_bytes(python_fmu(BASE))
    done = offered["run_to_its_end"](fmu, tmp_path)
    assert (done.returncode, done.stderr) == (0, "")


@each_patch
def test_the_patch_is_one_that_git_reads(name, tmp_path):
    """Its counts of lines are right; what it changes is not at hand here."""
    read = ["git", "apply", "--numstat", str(patch(name))]
    done = subprocess.run(read, cwd=tmp_path, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    lines = [line.split("\t")[:2] for line in done.stdout.splitlines()]
    assert lines == [*PATCHES[name][0], [str(added(name).count("\n")), "0"]]
