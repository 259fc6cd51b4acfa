"""The lowest versions are declared, and the constraints that install them exclude nothing else."""

import subprocess
import sys

import pytest

from tests.lowest import ROOT, constraints, lowest


def project(dependencies, extra=()):
    return {"dependencies": dependencies, "optional-dependencies": {"import": list(extra), "watch": []}}


def test_bounds_are_read_from_dependencies_and_extras():
    found = lowest(project(["Numpy>=2.1.3", "tomli>=2.0.1; python_version < '3.11'", "scipy>=1.13,<2"], ["h5py>=3.11"]))
    assert found == {"numpy": "2.1.3", "tomli": "2.0.1", "scipy": "1.13", "h5py": "3.11"}


@pytest.mark.parametrize("line", ["numpy", "numpy<3", "numpy==2.0", "numpy>2"])
def test_a_library_without_a_lowest_version_is_named(line):
    with pytest.raises(ValueError, match="numpy"):
        lowest(project([line]))


def test_the_lowest_versions_replace_the_usual_ones_and_others_stay():
    usual = "# names only\nNumPy==2.4.6; python_version >= '3.11'\nNumPy==2.2.6; python_version < '3.11'\nlark==1.3.1\n"
    assert constraints({"numpy": "2.1.3"}, usual) == "numpy==2.1.3\nlark==1.3.1\n"


def test_each_library_of_this_project_has_one():
    """By the command that `make test-lowest` reads."""
    printed = subprocess.run(
        [sys.executable, "-m", "tests.lowest"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    pinned = [line for line in printed.splitlines() if line.startswith(("numpy", "scipy", "h5py", "tornado"))]
    assert len(pinned) == 4
    assert all(line.count("==") == 1 and ";" not in line for line in pinned)
