"""Lines and files of each folder and modules that `vpp demo` loads, before and now; the longest imports below the diagnosis.

Lines of Python files that git tracks, with comments and docstrings. The chain: each module imports the next one.
"""

import subprocess
import sys
from collections import Counter
from functools import cache
from pathlib import PurePosixPath
from tempfile import TemporaryDirectory

import grimp

PACKAGES = "fmu_src", "vpp_fmu", "identification", "hil"
DIAGNOSIS = "identification.diagnose.diagnose"

DEMO = """
import sys
from vpp_fmu.app.cli import main

main(["demo", "--quiet"])
print(sum(name.partition(".")[0] in sys.argv for name in sys.modules))
"""


def main(parser, arguments):
    parser.add_argument("--against", default="HEAD", metavar="REV", help="the commit before (default: %(default)s)")
    options = parser.parse_args(arguments)
    before, now = counted(options.against), counted("HEAD")
    print(f"| folder | lines, {options.against[:10]} | files | lines, now | files |\n| --- | --- | --- | --- | --- |")
    for folder in sorted(before | now):
        cells = [*before.get(folder, (0, 0)), *now.get(folder, (0, 0))]
        print(f"| {' | '.join(map(str, [folder, *cells]))} |")
    print(f"\nmodules that the demo loads: {demo_modules(options.against)}, now {demo_modules('HEAD')}")
    chain = longest_chain(DIAGNOSIS)
    print(f"\nlongest chain of imports below the diagnosis, {len(chain)} modules:\n" + "\n".join(f"  {name}" for name in chain))


def counted(revision: str) -> dict[str, tuple[int, int]]:
    """(lines, files) of the Python files below each top folder, and of all that is not a test."""
    command = ["git", "grep", "-c", "", revision, "--", "*.py"]
    listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    lines, files = Counter(), Counter()
    for row in listed.splitlines():
        _, path, count = row.rsplit(":", 2)
        top = PurePosixPath(path).parts[0]
        for folder in (top, *(["product"] if top in PACKAGES else [])):
            lines[folder] += int(count)
            files[folder] += 1
    return {folder: (lines[folder], files[folder]) for folder in lines}


def demo_modules(revision: str) -> int:
    """Number of the project's modules that `vpp demo` of a commit loads."""
    with TemporaryDirectory() as folder:
        tree = subprocess.run(["git", "archive", revision], capture_output=True, check=True).stdout
        subprocess.run(["tar", "-x", "-C", folder], input=tree, check=True)
        command = [sys.executable, "-c", DEMO, *PACKAGES]
        return int(subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout.split()[-1])


def longest_chain(module: str) -> list[str]:
    """Module names, each of which imports the next one; imports in functions count. No chain passes a module twice."""
    graph = grimp.build_graph(*PACKAGES)

    @cache
    def below(name: str) -> list[str]:
        return [name, *max((below(n) for n in sorted(graph.find_modules_directly_imported_by(name))), key=len, default=[])]

    return below(module)
