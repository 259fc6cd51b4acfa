"""The lowest versions are declared, and the constraints that install them exclude nothing else."""

import subprocess
import sys

from tests.lowest import ROOT


def test_each_library_of_this_project_has_one():
    """By the command that `make test-lowest` reads."""
    printed = subprocess.run(
        [sys.executable, "-m", "tests.lowest"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    pinned = [line for line in printed.splitlines() if line.startswith(("numpy", "scipy", "h5py", "tornado"))]
    assert len(pinned) == 4
    assert all(line.count("==") == 1 and ";" not in line for line in pinned)
