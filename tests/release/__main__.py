"""Builds wheel and sdist into build/dist, checks them, and tries the wheel in a clean environment of each Python found.

    python -m tests.release                 # all Pythons from 3.10 on that are on PATH or under pyenv
    python -m tests.release --pythons 3.12

Prints a table, and ends with 1 if a cell is not "ok". Everything runs outside the checkout, so that the wheel is tested.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
DIST = ROOT / "build" / "dist"
VERSIONS = ("3.10", "3.11", "3.12", "3.13")

API = ("test_api.py", "conftest.py", "builders.py", "stalls.py", "hil/quick_vpp.py")
"""The tests of the public names, and the files of their folder that they import."""


def main() -> int:
    """Exit code: 0, or 1 if a check or a trial failed."""
    parser = argparse.ArgumentParser(prog="python -m tests.release", description=__doc__.splitlines()[0])
    parser.add_argument("--pythons", nargs="+", default=VERSIONS, choices=VERSIONS)
    parser.add_argument("--checks-only", action="store_true", help="build and check, without trying the wheel")
    options = parser.parse_args()
    wheel, sdist = build()
    if not check(wheel, sdist):
        return 1
    if options.checks_only:
        return 0
    print(
        "| Python | wheel installs | version | vpp demo | tests of the public API |\n| --- | --- | --- | --- | --- |",
        flush=True,
    )
    good = True
    for version in options.pythons:
        cells = list(tried(version, wheel))
        good = good and all(cell.startswith(("ok", "not here")) for cell in cells)
        print(f"| {version} | {' | '.join(cells)} |", flush=True)
    return 0 if good else 1


def build() -> tuple[Path, Path]:
    """Wheel and sdist of the checkout."""
    shutil.rmtree(DIST, ignore_errors=True)
    shutil.rmtree(ROOT / "build" / "lib", ignore_errors=True)  # setuptools would pack old files from there
    subprocess.run([sys.executable, "-m", "build", "--outdir", str(DIST), str(ROOT)], check=True, capture_output=True)
    (wheel,), (sdist,) = DIST.glob("*.whl"), DIST.glob("*.tar.gz")
    for path in (wheel, sdist):
        print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1e6:.1f} MB")
    return wheel, sdist


def check(wheel: Path, sdist: Path) -> bool:
    """Whether a package index would accept both."""
    found = True
    # W004 concerns cli/import.py: a verb's module has the verb's name, even if that is a keyword
    contents = ["--toplevel", "vpp_fmu,fmu_src,identification,hil", "--ignore", "W004", str(wheel)]
    checks = (
        [sys.executable, "-m", "twine", "--no-color", "check", "--strict", str(wheel), str(sdist)],
        [str(Path(sys.executable).with_name("check-wheel-contents")), *contents],
    )
    for command in checks:
        done = subprocess.run(command, check=False, capture_output=True, text=True, env=os.environ | {"NO_COLOR": "1"})
        print((done.stdout + done.stderr).strip(), flush=True)
        found = found and done.returncode == 0
    return found


def tried(version: str, wheel: Path) -> Iterator[str]:
    """The cells of a Python's row; it ends at the first failure."""
    python = interpreter(version)
    if python is None:
        yield from ("not here", "-", "-", "-")
        return
    with tempfile.TemporaryDirectory(prefix="vpp-release-") as name:
        folder = Path(name)
        subprocess.run([python, "-m", "venv", str(folder / "venv")], check=True, capture_output=True)
        own = folder / "venv" / "bin"
        pip = [str(own / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        constraint = ["--constraint", str(ROOT / "constraints.txt")]
        yield (cell := ran([*pip, *constraint, str(wheel)], folder))
        if not cell.startswith("ok"):
            yield from ("-", "-", "-")
            return
        printed = subprocess.run([str(own / "vpp"), "--version"], cwd=folder, check=True, capture_output=True, text=True)
        expected = wheel.name.split("-")[1]
        yield f"ok {expected}" if printed.stdout == f"vpp {expected}\n" else f"failed: {printed.stdout}"
        yield ran([str(own / "vpp"), "demo", "-o", "demo"], folder, (folder / "demo" / "report.html",))
        yield api_tested(own, pip + constraint, folder)


def api_tested(own: Path, pip: list[str], folder: Path) -> str:
    """The tests of the public API, copied out of the checkout, against the installed wheel."""
    (folder / "tests" / "hil").mkdir(parents=True)
    for name in API:
        shutil.copy(ROOT / "tests" / name, folder / "tests" / name)
    (folder / "pytest.ini").write_text(
        "[pytest]\ntestpaths = tests\npythonpath = . tests\nfilterwarnings = error\naddopts = -q\n"
    )
    installed = ran([*pip, "pytest<9.2", "pytest-xdist"], folder)
    if not installed.startswith("ok"):
        return installed
    return ran([str(own / "python"), "-m", "pytest", "tests/test_api.py"], folder)


def ran(command: list[str], folder: Path, needed: tuple[Path, ...] = ()) -> str:
    """ "ok" with the seconds, or the last line printed, of a command outside the checkout and without its path."""
    hidden = ("PYTHONPATH", "PYENV_VERSION", "VIRTUAL_ENV")
    clean = {name: text for name, text in os.environ.items() if name not in hidden} | {"OMP_NUM_THREADS": "1"}
    began = time.monotonic()
    done = subprocess.run(command, cwd=folder, env=clean, check=False, capture_output=True, text=True)
    if done.returncode == 0 and all(path.is_file() for path in needed):
        return f"ok, {time.monotonic() - began:.0f} s"
    lines = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
    return f"failed: {lines[-1] if lines else f'exit code {done.returncode}'}".replace("|", "/")


def interpreter(version: str) -> str | None:
    """A Python of this version: under pyenv, else on PATH."""
    roots = sorted(Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"), "versions").glob(f"{version}.*/bin/python"))
    candidates = [str(path) for path in roots] + [f"python{version}"]
    for candidate in candidates:
        found = shutil.which(candidate)
        if found is None:
            continue
        said = subprocess.run(
            [found, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"], check=False, capture_output=True, text=True
        )
        if said.stdout.strip() == version:
            return found
    return None


if __name__ == "__main__":
    sys.exit(main())
