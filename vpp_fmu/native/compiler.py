"""Finds a C compiler, compiles, and keeps what was compiled under a name made from its content."""

import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

from vpp_fmu.errors import CompilerMissing
from vpp_fmu.scratch import Scratch

FLAGS = (
    *("-std=c11", "-O1", "-ftree-loop-vectorize", "-fPIC", "-shared"),
    *("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-w"),
)
"""-O1 runs such straight lines as fast as -O2 and compiles them in two thirds of the time; runs side by side are loops. No
contraction into fused multiply-adds: they round once where Python rounds twice, and the bits would differ. Nobody reads errno
or the exception flags: without them roots are one instruction, and choices need no branch."""


@cache
def compiler() -> str:
    """Path of the C compiler: `$CC`, or the first of cc, gcc, clang. CompilerMissing where there is none."""
    wanted = [os.environ["CC"]] if "CC" in os.environ else ["cc", "gcc", "clang"]
    for name in wanted:
        if path := shutil.which(name):
            return path
    raise CompilerMissing(f"no C compiler found (looked for {', '.join(wanted)})")


def compiled(source: str) -> Path:
    """The shared library for a C source text; compiled at the first call, taken from the cache afterwards."""
    return compiled_as(source, lambda: source)


def compiled_as(name: str, source: Callable[[], str]) -> Path:
    """The same under a `name` that no other source text has, which need not be made where the library is there already."""
    cc = compiler()
    tag = hashlib.sha256("\0".join([name, cc, *FLAGS, platform.machine()]).encode()).hexdigest()[:24]
    library = cache_folder() / f"{tag}.so"
    if not library.exists():
        with tempfile.TemporaryDirectory(dir=library.parent) as work:
            text, built = Path(work, "model.c"), Path(work, "model.so")
            text.write_text(source())
            subprocess.run([cc, *FLAGS, str(text), "-o", str(built), "-lm"], check=True, capture_output=True, text=True)
            os.replace(built, library)  # whole or not at all: several processes may compile the same
    return library


@cache
def cache_folder() -> Path:
    """`$XDG_CACHE_HOME/vpp-fmu`, or a temporary folder where that can't be written."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "vpp-fmu")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return _own().path
    return folder


@cache
def _own() -> Scratch:
    """Goes with the process."""
    return Scratch()
