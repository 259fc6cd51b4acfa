"""Finds a C compiler, compiles, and caches libraries under the hash of their source.

A truncated library ends the process with SIGBUS when it is loaded, and a foreign one may run any code. So a library ends with a
hash of its content, and it is loaded only if the hash is right and only this user owns it and can write it.
"""

import contextlib
import ctypes
import hashlib
import os
import platform
import shutil
import stat
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

from vpp_fmu.errors import CompilerMissing
from vpp_fmu.scratch import Scratch

FLAGS = (
    *("-std=c11", "-O1", "-ftree-loop-vectorize", "-fPIC", "-shared"),
    *("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-w"),
)
"""Straight-line code is as fast with -O1 as with -O2, and compiles in two thirds of the time; parallel runs are loops. No fused
multiply-adds: they round once where Python rounds twice. errno and the exception flags are not read; without them a root is
one instruction, and choices need no branch."""

VECTORS = ("avx512f", "avx2")
"""Sets of vector instructions, the widest first, as /proc/cpuinfo names them. A library for one of them compiles in three
quarters of the time of one for all."""

LARGEST = 100 * 2**20
"""Maximum bytes of all cached libraries: some 2000 of them. A long diagnosis needs some hundred."""

ZIG = "zig"
"""Cache folder of the compiler for other platforms, which manages it."""

HASH = hashlib.sha256
OTHERS = stat.S_IWGRP | stat.S_IWOTH


@cache
def compiler() -> str:
    """Path of the C compiler: `$CC`, or the first of cc, gcc, clang. CompilerMissing."""
    wanted = [os.environ["CC"]] if "CC" in os.environ else ["cc", "gcc", "clang"]
    for name in wanted:
        if path := shutil.which(name):
            return path
    raise CompilerMissing(f"no C compiler found (looked for {', '.join(wanted)})")


def compiled(source: str) -> ctypes.CDLL:
    """The shared library of a C source text: compiled at the first call, loaded from the cache afterwards.

    CompilerMissing: there is no compiler, or it fails.
    """
    return compiled_as(source, lambda: source)


def compiled_as(name: str, source: Callable[[], str]) -> ctypes.CDLL:
    """The same under a `name` that no other source text has. `source` is called only if the library is not cached."""
    cc = compiler()
    tag = HASH("\0".join([name, cc, *FLAGS, *_vectors(), platform.machine()]).encode()).hexdigest()[:24]
    for folder in (cache_folder, private_folder):
        library = folder() / f"{tag}.so"
        if found := _loaded(library):
            return found
        with contextlib.suppress(OSError):  # no room, no permission
            _build(cc, source(), library)
        if found := _loaded(library):
            return found
    raise CompilerMissing(f"what {cc} compiles cannot be loaded")


@cache
def _vectors() -> tuple[str, ...]:
    """The flag for the widest vectors of this processor; none if they are unknown."""
    try:
        known = Path("/proc/cpuinfo").read_text(encoding="utf-8").partition("\nflags")[2].partition("\n")[0].split()
    except OSError:
        return ()
    return tuple(f'-DVECTORS="{name}"' for name in VECTORS if name in known)[:1]


def _loaded(library: Path) -> ctypes.CDLL | None:
    """A cached library, marked as used now; None, and the file deleted, if a check or loading fails."""
    try:
        if not _is_sound(library):
            raise OSError
        found = ctypes.CDLL(str(library))
    except FileNotFoundError:
        return None
    except OSError:
        with contextlib.suppress(OSError):
            library.unlink()
        return None
    with contextlib.suppress(OSError):
        os.utime(library)
    return found


def _is_sound(library: Path) -> bool:
    """Whether only this user owns and can write the file, and it is complete. OSError."""
    with open(os.open(library, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0)), "rb") as file:
        status = os.fstat(file.fileno())
        if not _is_own(status) or status.st_mode & OTHERS:
            return False
        content = file.read()
    size = HASH().digest_size
    return len(content) > size and HASH(content[:-size]).digest() == content[-size:]


def _is_own(status: os.stat_result) -> bool:
    return not hasattr(os, "geteuid") or status.st_uid == os.geteuid()


def _build(cc: str, source: str, library: Path) -> None:
    """Compile to a file atomically, since processes may compile the same. A file that a power cut damages has a wrong hash.
    OSError, CompilerMissing."""
    with contextlib.closing(Scratch(library.parent)) as work:
        (work.path / "model.c").write_text(source, encoding="utf-8")
        _run([cc, *FLAGS, *_vectors(), "model.c", "-o", "model.so", "-lm"], work.path)
        built = work.path / "model.so"
        with open(built, "r+b") as file:
            file.write(HASH(file.read()).digest())
        built.chmod(0o600)
        os.replace(built, library)
    _evict(library)


def _run(command: list[str], work: Path) -> None:
    """Run the compiler. CompilerMissing if it fails, for example without the C library's headers."""
    try:
        done = subprocess.run(command, cwd=work, check=False, capture_output=True, text=True, errors="replace")
        errors = [line.partition("error: ")[2] for line in done.stderr.splitlines() if "error: " in line]
        failure = (errors[0] if errors else f"exit code {done.returncode}") if done.returncode else ""
    except OSError as error:
        failure = str(error.strerror)
    if failure or not (work / "model.so").is_file():
        raise CompilerMissing(f"the C compiler {command[0]} fails ({failure or 'no output'})")


def kept() -> list[tuple[Path, os.stat_result]]:
    """The cached libraries with their file status, the least recently used first."""
    found = []
    with os.scandir(cache_folder()) as entries:
        for entry in entries:
            with contextlib.suppress(OSError):  # another process has just deleted it
                if entry.name.endswith(".so"):
                    found.append((Path(entry.path), entry.stat(follow_symlinks=False)))
    return sorted(found, key=lambda each: each[1].st_mtime)


def clear() -> None:
    """Delete all cached libraries, and the cache of the compiler for other platforms."""
    for path, _ in kept():
        path.unlink(missing_ok=True)
    shutil.rmtree(cache_folder() / ZIG, ignore_errors=True)


def _evict(newest: Path) -> None:
    """If all exceed LARGEST, delete the least recently used tenth. Loaded libraries stay usable."""
    libraries = kept()
    size = sum(status.st_size for _, status in libraries)
    excess = size - 0.9 * LARGEST if size > LARGEST else 0.0
    for path, status in libraries:
        if excess <= 0.0:
            return
        if path != newest:
            path.unlink(missing_ok=True)
            excess -= status.st_size


@cache
def cache_folder() -> Path:
    """`$XDG_CACHE_HOME/vpp-fmu` if that is absolute, else `~/.cache/vpp-fmu`; a temporary folder if it is another user's or
    cannot be written."""
    try:
        base = Path(os.environ.get("XDG_CACHE_HOME", ""))
        folder = (base if base.is_absolute() else Path.home() / ".cache") / "vpp-fmu"
        if not folder.is_absolute():
            return private_folder()
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        status = folder.stat()
        if not _is_own(status):
            return private_folder()
        if status.st_mode & OTHERS:  # whoever can write to the folder can replace a library after its check
            folder.chmod(0o700)
        Scratch(folder).close()
    except (OSError, RuntimeError):  # RuntimeError: no home folder
        return private_folder()
    return folder


def private_folder() -> Path:
    """A folder that is removed with the process."""
    return _own().path


@cache
def _own() -> Scratch:
    return Scratch()
