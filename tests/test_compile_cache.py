"""The cache of compiled models: damaged, foreign or too many libraries, and compilers that fail."""

import ctypes
import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from builders import needs_compiler

from vpp_fmu.app.cli import main
from vpp_fmu.errors import CompilerMissing
from vpp_fmu.native import compiler
from vpp_fmu.native.compiler import compiled

pytestmark = needs_compiler
SOURCE = "double twice(double x) { return 2.0 * x; }\n"
TWICE = """
import ctypes, sys
from vpp_fmu.native.compiler import compiled
twice = compiled(sys.argv[1]).twice
twice.restype, twice.argtypes = ctypes.c_double, [ctypes.c_double]
print(twice(21.0))
"""


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """The cache of this test alone."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    compiler.cache_folder.cache_clear()
    yield tmp_path / "vpp-fmu"
    compiler.cache_folder.cache_clear()


def twice():
    """Run in a fresh process: the dynamic loader of this one keeps libraries that it has loaded, even if the file changes."""
    command, environment = [sys.executable, "-c", TWICE, SOURCE], os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
    return subprocess.run(command, check=False, capture_output=True, text=True, env=environment)


def only(folder):
    (library,) = folder.glob("*.so")
    return library


DAMAGES = {
    "cut within the hash": lambda path, whole: path.write_bytes(whole[:-1]),
    "empty": lambda path, whole: path.write_bytes(b""),
    "a byte changed": lambda path, whole: path.write_bytes(whole[:5000] + bytes([whole[5000] ^ 1]) + whole[5001:]),
    "sound hash, no library": lambda path, whole: path.write_bytes(b"no" + compiler.HASH(b"no").digest()),
    "writable by the group": lambda path, whole: path.chmod(0o620),
    "writable by all": lambda path, whole: path.chmod(0o602),
    "a link": lambda path, whole: (path.rename(path.with_suffix(".own")), path.symlink_to(path.with_suffix(".own"))),
}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A library as the cache holds it."""
    place = tmp_path_factory.mktemp("built")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(place))
        compiler.cache_folder.cache_clear()
        compiled(SOURCE)
    compiler.cache_folder.cache_clear()
    return only(place / "vpp-fmu")


@pytest.fixture
def cached(folder, built):
    """A copy of it in the cache of the test: another file, which no process has loaded."""
    folder.mkdir()
    return Path(shutil.copy2(built, folder / built.name))


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_library_that_cannot_be_trusted_is_built_again(cached, damage):
    whole = cached.read_bytes()
    DAMAGES[damage](cached, whole)
    double = compiled(SOURCE).twice
    double.restype, double.argtypes = ctypes.c_double, [ctypes.c_double]
    assert double(21.0) == 42.0
    assert cached.read_bytes() == whole
    assert not cached.is_symlink()
    assert stat.S_IMODE(cached.stat().st_mode) == 0o600


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root gives files away")
def test_a_library_of_another_user_is_not_loaded(folder, cached, tmp_path):
    library, mark = cached, tmp_path / "loaded"
    evil = f'#include <stdio.h>\n__attribute__((constructor)) static void run(void) {{ fclose(fopen("{mark}", "w")); }}\n'
    compiled(evil + SOURCE)
    mark.unlink()  # it was loaded here, on purpose
    (planted,) = set(folder.glob("*.so")) - {library}
    planted.replace(library)
    os.chown(library, 65534, 65534)
    assert twice().stdout == "42.0\n"
    assert not mark.exists()
    assert library.stat().st_uid == 0
    os.chown(folder, 65534, 65534)  # nor is anything put into or taken from a folder of somebody else
    before = library.stat().st_mtime_ns
    assert twice().stdout == "42.0\n"
    assert library.stat().st_mtime_ns == before


def test_the_least_recently_used_libraries_are_removed(folder, monkeypatch):
    sources = [SOURCE + f"/* {k} */\n" for k in range(4)]
    for k, source in enumerate(sources[:3]):
        compiled(source)
        for path in set(folder.glob("*.so")):
            if path.stat().st_mtime > 1e9:
                os.utime(path, (k + 1.0, k + 1.0))  # times of use far apart, since a file system may count whole seconds
    first, second, third = (path for path, _ in compiler.kept())
    compiled(sources[0])  # the one that was made first is used again
    size = max(path.stat().st_size for path in (first, second, third))
    monkeypatch.setattr(compiler, "LARGEST", 2.5 * size)
    compiled(sources[3])
    left = set(folder.glob("*.so"))
    assert len(left) == 2
    assert first in left
    assert left.isdisjoint({second, third})


def test_the_verb_shows_and_clears_the_cache(folder, capsys):
    compiled(SOURCE)
    assert main(["cache"]) == 0
    size = only(folder).stat().st_size / 2**20
    assert capsys.readouterr().out == f"{folder}: 1 library, {size:.1f} MB, 100 MB at most\n"
    assert main(["cache", "--clear"]) == 0
    assert list(folder.glob("*")) == []


FAILING = {
    "false": ("#!/bin/sh\nexit 1\n", "fails"),
    "no headers": ("#!/bin/sh\necho 'model.c:3:10: fatal error: math.h: No such file or directory' >&2; exit 1\n", "math.h"),
    "no output": ("#!/bin/sh\nexit 0\n", "no output"),
    "no program": ("\0", "fails"),
}


@pytest.fixture
def failing(tmp_path, monkeypatch):
    """Set a compiler that fails."""

    def use(how):
        (tmp_path / "cc").write_text(FAILING[how][0])
        (tmp_path / "cc").chmod(0o755)
        monkeypatch.setenv("CC", str(tmp_path / "cc"))
        compiler.compiler.cache_clear()

    yield use
    compiler.compiler.cache_clear()


@pytest.mark.parametrize("how", FAILING)
def test_a_failing_compiler_is_treated_as_missing(how, folder, failing):
    failing(how)
    with pytest.raises(CompilerMissing, match=FAILING[how][1]):
        compiled(SOURCE)


def test_a_failing_compiler_is_reported_once(folder, failing, tmp_path):
    failing("no headers")
    (tmp_path / "record.csv").write_text("time,omega_ref,beta_ref\n0,4000,5\n0.004,4100,5\n0.008,4100,6\n")
    (tmp_path / "p.json").write_text('{"format": "vpp-parameters/1", "parameters": {}, "effects": [], "source": {}}')
    command = [sys.executable, "-m", "vpp_fmu", "simulate", "record.csv", "--parameters", "p.json", "-o", "out"]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
    done = subprocess.run(command, check=False, capture_output=True, text=True, cwd=tmp_path, env=environment)
    assert (done.returncode, done.stderr.count("\n")) == (0, 1)
    assert "math.h" in done.stderr
    assert "as generated Python" in done.stderr
    assert (tmp_path / "out" / "prediction.csv").exists()
