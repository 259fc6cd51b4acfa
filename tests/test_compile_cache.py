"""The cache of compiled models: damaged, foreign or too many libraries, and compilers that fail."""

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from builders import needs_compiler

from vpp_fmu.app.cli import main
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


def twice(source=SOURCE, **environment):
    """Run in a fresh process: the dynamic loader of this one keeps libraries that it has loaded, even if the file changes."""
    command = [sys.executable, "-c", TWICE, source]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])} | environment
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
    assert twice(XDG_CACHE_HOME=str(place)).stdout == "42.0\n"
    return only(place / "vpp-fmu")


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_library_that_cannot_be_trusted_is_built_again(folder, built, damage):
    library, whole = folder / built.name, built.read_bytes()
    folder.mkdir()
    shutil.copy2(built, library)
    DAMAGES[damage](library, whole)
    done = twice()
    assert (done.returncode, done.stdout, done.stderr) == (0, "42.0\n", "")
    assert library.read_bytes() == whole
    assert not library.is_symlink()
    assert stat.S_IMODE(library.stat().st_mode) == 0o600


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root gives files away")
def test_a_library_of_another_user_is_not_loaded(folder, tmp_path):
    twice()
    library, mark = only(folder), tmp_path / "loaded"
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


@pytest.mark.parametrize("failing", ["false", "no headers", "no output", "no program"])
def test_a_failing_compiler_is_reported_once_and_treated_as_missing(failing, folder, tmp_path):
    cc = tmp_path / "cc"
    lines = {
        "false": "exit 1",
        "no headers": "echo 'model.c:3:10: fatal error: math.h: No such file or directory' >&2; exit 1",
        "no output": "exit 0",
        "no program": "",
    }
    cc.write_text(f"#!/bin/sh\n{lines[failing]}\n" if lines[failing] else "\0")
    cc.chmod(0o755)
    (tmp_path / "record.csv").write_text("time,omega_ref,beta_ref\n0,4000,5\n0.004,4100,5\n0.008,4100,6\n")
    words = ["simulate", str(tmp_path / "record.csv"), "-o", str(tmp_path / "out")]
    (tmp_path / "p.json").write_text('{"format": "vpp-parameters/1", "parameters": {}, "effects": [], "source": {}}')
    command = [sys.executable, "-m", "vpp_fmu", *words, "--parameters", str(tmp_path / "p.json")]
    environment = os.environ | {"CC": str(cc)}
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    assert done.returncode == 0
    assert done.stderr.count("\n") == 1
    assert "as generated Python" in done.stderr
    assert (tmp_path / "out" / "prediction.csv").exists()
    for word in {"no headers": ("math.h",), "no output": ("no output",)}.get(failing, ("fails",)):
        assert word in done.stderr
