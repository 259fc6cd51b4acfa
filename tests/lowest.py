"""The lowest versions that pyproject.toml allows, for `make test-lowest`.

    python -m tests.lowest            # print constraints for pip: these versions, and constraints.txt for all other packages
    python -m tests.lowest --passed   # note them in tests/lowest.txt, as versions with which the tests passed
    python -m tests.lowest --check    # exit code 1 if they are not the noted ones

.ci/run tests the lowest versions whenever they are not the noted ones, so that a run without such a change takes no longer.
"""

import argparse
import sys
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
NOTED = Path(__file__).with_name("lowest.txt")

EXTRAS = ("import", "watch")
"""Extras whose libraries the tests install, beside those of the developers, which constraints.txt has exactly."""


def lowest(project: dict) -> dict[str, str]:
    """Lowest version of each library that runs with this project, by name. ValueError for one without a lower bound."""
    named = [*project["dependencies"], *(line for extra in EXTRAS for line in project["optional-dependencies"][extra])]
    found = {}
    for requirement in map(Requirement, named):
        bounds = [one.version for one in requirement.specifier if one.operator == ">="]
        if len(bounds) != 1:
            raise ValueError(
                f"pyproject.toml: {requirement.name}: found {str(requirement.specifier) or 'no bound'}, expected >="
            )
        found[canonicalize_name(requirement.name)] = bounds[0]
    return found


def constraints(versions: dict[str, str], others: str) -> str:
    """A file of constraints: the `versions`, and the lines of `others` about packages that are none of them."""
    lines = [line for line in others.splitlines() if line.strip() and not line.startswith("#")]
    kept = [line for line in lines if canonicalize_name(Requirement(line).name) not in versions]
    return "\n".join([*(f"{name}=={version}" for name, version in versions.items()), *kept]) + "\n"


def main(words: list[str]) -> int:
    """Exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.lowest", description=__doc__.splitlines()[0])
    parser.add_argument("--passed", action="store_true", help="note the versions in tests/lowest.txt")
    parser.add_argument("--check", action="store_true", help="exit code 1 if they are not the noted ones")
    options = parser.parse_args(words)
    versions = lowest(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"])
    noted = "".join(f"{name}=={version}\n" for name, version in sorted(versions.items()))
    if options.check:
        return 0 if NOTED.exists() and NOTED.read_text() == noted else 1
    if options.passed:
        NOTED.write_text(noted)
    else:
        print(constraints(versions, (ROOT / "constraints.txt").read_text()), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
