"""Seconds that `import vpp_fmu` and each of its public names take in a fresh interpreter, beyond those of an empty one. Then
the package is installed as a wheel outside the checkout, and the example of every public docstring runs there."""

import os
import subprocess
import sys
import sysconfig
import tempfile
import venv
from functools import partial
from pathlib import Path
from timeit import repeat

import vpp_fmu

AIM = 0.2
"""s for the import of the package; names are loaded when they are used."""

ROOT = Path(__file__).parents[2]

EXAMPLES = """
import doctest, vpp_fmu as vpp
print(vpp.__file__)
flags, run, names = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE, 0, 0
for name in vpp.__all__:
    found = [t for t in doctest.DocTestFinder().find(getattr(vpp, name), name, globs={"vpp": vpp}) if t.examples]
    names += bool(found)
    for test in found:
        failed, tried = doctest.DocTestRunner(optionflags=flags).run(test)
        run += tried
        if failed:
            raise SystemExit(f"{name}: {failed} of {tried} examples fail")
print(f"{run} examples of {names} names of {len(vpp.__all__)} run, none fails")
"""


def seconds(code: str, times: int) -> float:
    """Seconds of the fastest of several fresh interpreters."""
    start = partial(subprocess.run, [sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)
    return min(repeat(start, repeat=times, number=1))


def from_wheel(folder: Path) -> list[str]:
    """Output of the examples, run from a wheel of the checkout in an environment in `folder`; dependencies come from this
    environment. Raises SystemExit, with the failure, if an example fails."""
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", "--no-deps", "--wheel-dir", str(folder), str(ROOT)], check=True)
    (wheel,) = folder.glob("*.whl")
    home, empty = folder / "environment", folder / "empty"
    venv.create(home, symlinks=True)
    empty.mkdir()
    # A checkout on this environment's path must not pass for an installation there.
    install = [*pip, "--python", str(home / "bin" / "python"), "install", "--no-deps", "--ignore-installed", str(wheel)]
    subprocess.run(install, check=True)
    needed = {"PYTHONPATH": sysconfig.get_path("purelib"), "PATH": os.environ["PATH"]}  # its .pth files have no effect there
    command = [home / "bin" / "python", "-c", EXAMPLES]
    done = subprocess.run(command, check=False, cwd=empty, env=needed, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{done.stdout}{done.stderr}".rstrip())
    return done.stdout.splitlines()


def main(parser, arguments):
    parser.add_argument("--times", type=int, default=3, metavar="N", help="interpreters, of which the fastest counts")
    times = parser.parse_args(arguments).times
    nothing = seconds("pass", times)
    print(f"import vpp_fmu        {seconds('import vpp_fmu', times) - nothing:6.3f} s (aim: below {AIM:g} s)")
    for name in ("__version__", *vpp_fmu.__all__):
        print(f"vpp.{name:17} {seconds(f'import vpp_fmu; vpp_fmu.{name}', times) - nothing:6.3f} s", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        place, said = from_wheel(Path(folder))
        print(f"as a wheel, in {Path(place).relative_to(folder)}: {said}")
