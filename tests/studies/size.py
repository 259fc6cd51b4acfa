"""Lines and files of each folder, before and now, and the longest chain of imports below the diagnosis.

Lines of Python files that git tracks, with comments and docstrings. The chain: each module imports the next one.
"""

import subprocess
from collections import Counter
from functools import cache
from pathlib import PurePosixPath

import grimp

PACKAGES = "fmu_src", "vpp_fmu", "identification", "hil"
DIAGNOSIS = "identification.diagnose.diagnose"


def main(parser, arguments):
    parser.add_argument("--against", default="HEAD", metavar="REV", help="the commit before (default: %(default)s)")
    options = parser.parse_args(arguments)
    before, now = counted(options.against), counted("HEAD")
    print(f"| folder | lines, {options.against[:10]} | files | lines, now | files |\n| --- | --- | --- | --- | --- |")
    for folder in sorted(before | now):
        cells = [*before.get(folder, (0, 0)), *now.get(folder, (0, 0))]
        print(f"| {' | '.join(map(str, [folder, *cells]))} |")
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


def longest_chain(module: str) -> list[str]:
    """Module names, each of which imports the next one; imports in functions count. No chain passes a module twice."""
    graph = grimp.build_graph(*PACKAGES)

    @cache
    def below(name: str) -> list[str]:
        return [name, *max((below(n) for n in sorted(graph.find_modules_directly_imported_by(name))), key=len, default=[])]

    return below(module)
