"""What is offered to pythonfmu upstream: the test of the patch, against the binary that is installed."""

import subprocess
import sys
from pathlib import Path

import fmu_src

PATCH = Path(fmu_src.__file__).parent / "upstream" / "pythonfmu-0.7.0-exceptions.patch"


def added(name: str) -> str:
    """The file that the patch adds."""
    hunk = PATCH.read_text().split(f"+++ b/{name}\n")[1]
    return "".join(line[1:] + "\n" for line in hunk.splitlines() if line.startswith("+"))


def test_the_installed_binary_still_needs_the_mend(tmp_path):
    """A slave of pythonfmu's own dies after an exception. Once this fails, the patch or its like is in: `_kept` in
    fmu_src/slave.py then takes references that nobody drops, and must go."""
    test = tmp_path / "test_exceptions.py"
    test.write_text(added("pythonfmu/tests/test_exceptions.py"))
    run = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", str(tmp_path), str(test)]
    done = subprocess.run(run, cwd=tmp_path, check=False, capture_output=True, text=True)
    assert done.returncode == 1
    assert "assert -11 == 0" in done.stdout, done.stdout


def test_the_patch_is_one_that_git_reads(tmp_path):
    """Its counts of lines are right; what it changes is not at hand here."""
    done = subprocess.run(["git", "apply", "--numstat", str(PATCH)], cwd=tmp_path, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert [line.split("\t")[:2] for line in done.stdout.splitlines()] == [["2", "2"], [str(added_lines()), "0"]]


def added_lines():
    return added("pythonfmu/tests/test_exceptions.py").count("\n")
