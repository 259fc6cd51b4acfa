"""Compile C text to shared libraries: for this machine with its own compiler, for every platform with Zig's."""

import os
import platform
import re
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

from vpp_fmu.errors import BadInput, CompilerMissing
from vpp_fmu.native.compiler import ZIG, cache_folder, compiler
from vpp_fmu.tracer.graph import CALLS

TARGETS = {
    "linux64": ("x86_64-linux-gnu.2.17", "so"),
    "aarch64-linux": ("aarch64-linux-gnu.2.17", "so"),
    "win64": ("x86_64-windows-gnu", "dll"),
    "darwin64": ("x86_64-macos.11.0", "dylib"),
    "aarch64-darwin": ("aarch64-macos.11.0", "dylib"),
}
"""FMI 2.0.4's platform folders: Zig's target and the libraries' suffix, for the oldest C libraries that Zig supports."""

TUPLES = {
    "linux64": "x86_64-linux",
    "aarch64-linux": "aarch64-linux",
    "win64": "x86_64-windows",
    "darwin64": "x86_64-darwin",
    "aarch64-darwin": "aarch64-darwin",
}
"""FMI 3.0's names of the platforms."""

FLAGS = ("-std=c99", "-O2", "-fPIC", "-ffp-contract=off", "-fvisibility=hidden", "-fno-ident", "-g0", "-w")
"""Options for shipped libraries, other than those of `vpp_fmu.native`. No debug information: it has names of folders."""

LONG_SOURCE = 500_000
"""Characters from which on a source is compiled with -O1: its straight-line code is as fast, and compiles in half the time."""


def flags(text: str) -> list[str]:
    """The options for a source text."""
    return [("-O1" if flag == "-O2" and len(text) > LONG_SOURCE else flag) for flag in FLAGS]


UCRT = (
    *CALLS,
    *("ceil", "malloc", "calloc", "realloc", "free", "memcpy", "memmove", "memset", "strcmp", "strlen", "strcpy", "strchr"),
    *("strtod", "atoi", "__stdio_common_vsprintf"),
)
"""Functions of Windows' C library that an FMU uses."""


def host() -> str:
    """FMI's name for this machine."""
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine().lower(), platform.machine().lower())
    system = platform.system().lower()
    name = (
        {"linux": "linux64", "windows": "win64", "darwin": "darwin64"}.get(system)
        if machine == "x86_64"
        else f"{machine}-{system}"
    )
    if name not in TARGETS:
        raise BadInput("native FMU", "this machine", f"{machine} under {system}", f"one of {', '.join(TARGETS)}")
    return name


def binaries(name: str, text: str, platforms: str | Iterable[str], version: str = "2.0") -> dict[str, bytes]:
    """Shared libraries of the C text by their path in an FMU. `platforms`: "host", "all", or names of TARGETS. `version`: of
    FMI; 3.0 has other names of paths.

    Importers look for 64-bit ARM in different folders. An FMU for this machine has its library in both. An FMU for all
    platforms has FMI's names only, and a library for both kinds of Mac under the older name.
    """
    if platforms == "host":
        here, library = host(), _for_this_machine(name, text)
        if version == "3.0":
            return {f"binaries/{TUPLES[here]}/{name}.{TARGETS[here][1]}": library}
        places = {here, {"aarch64-linux": "linux64", "aarch64-darwin": "darwin64"}.get(here, here)}
        return {f"binaries/{place}/{name}.{TARGETS[here][1]}": library for place in places}
    wanted = list(TARGETS) if platforms == "all" else list(platforms)
    for unknown in set(wanted) - set(TARGETS):
        raise BadInput("native FMU", "platform", unknown, f"host, all, {', '.join(TARGETS)}")
    _check_zig()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        built = dict(zip(wanted, pool.map(lambda p: _with_zig(name, text, p), wanted), strict=True))
    if version == "3.0":
        return {f"binaries/{TUPLES[p]}/{name}.{TARGETS[p][1]}": library for p, library in built.items()}
    if {"darwin64", "aarch64-darwin"} <= set(built):
        built["darwin64"] = _universal(built["darwin64"], built["aarch64-darwin"])
    return {f"binaries/{p}/{name}.{TARGETS[p][1]}": library for p, library in built.items()}


def _for_this_machine(name: str, text: str) -> bytes:
    """Compile for Linux with Zig's compiler if it is installed: it links to the oldest suitable C library, so that the FMU also
    runs on older systems. This machine's compiler links to this machine's C library."""
    if platform.system() == "Linux" and find_spec("ziglang"):
        return _with_zig(name, text, host())
    return _with_own_compiler(text)


def needs_glibc(library: bytes) -> str | None:
    """The oldest GNU C library with which a Linux library runs, such as "2.29"; None if it needs none."""
    found = {tuple(map(int, version.split(b"."))) for version in re.findall(rb"GLIBC_(\d+\.\d+(?:\.\d+)?)\0", library)}
    return ".".join(map(str, max(found))) if found else None


def _with_own_compiler(text: str) -> bytes:
    try:
        command = [compiler()]
    except CompilerMissing:
        if not find_spec("ziglang"):
            raise
        command = [sys.executable, "-m", "ziglang", "cc"]
    linked = ["-s", "-Wl,--build-id=none"] if platform.system() == "Linux" else []
    with tempfile.TemporaryDirectory() as work:
        Path(work, "model.c").write_text(text, encoding="utf-8")
        _run([*command, *flags(text), "-shared", *linked, "model.c", "-o", "model.so", "-lm"], work)
        return Path(work, "model.so").read_bytes()


def _check_zig() -> None:
    if not find_spec("ziglang"):
        raise CompilerMissing("compiler for other platforms: found none, expected ziglang. Try: pip install 'vpp-fmu[cross]'")


def _with_zig(name: str, text: str, target: str) -> bytes:
    zig, (triple, ending) = [sys.executable, "-m", "ziglang"], TARGETS[target]
    with tempfile.TemporaryDirectory() as work:
        library = Path(work, f"{name}.{ending}")
        Path(work, "model.c").write_text(text, encoding="utf-8")
        if ending == "dll":
            _link_for_windows([*zig, "cc", "-target", triple], zig, library.name, work)
            return _without_date(library.read_bytes())
        _run([*zig, "cc", "-target", triple, *flags(text), "-shared", "-s", "model.c", "-o", library.name, "-lm"], work)
        return library.read_bytes()


def _link_for_windows(cc: list[str], zig: list[str], library: str, work: str) -> None:
    Path(work, "windows.c").write_text((files("fmu_src") / "windows.c").read_text(encoding="utf-8"), encoding="utf-8")
    Path(work, "ucrt.def").write_text("\n".join(["LIBRARY ucrtbase.dll", "EXPORTS", *UCRT, ""]))
    for source in ("model", "windows"):
        _run([*cc, *FLAGS, "-c", f"{source}.c", "-o", f"{source}.obj"], work)
    _run([*zig, "dlltool", "-m", "i386:x86-64", "-d", "ucrt.def", "-l", "ucrt.lib"], work)
    _run([*cc, "-nostdlib", "-shared", "-s", "model.obj", "windows.obj", "ucrt.lib", "-o", library], work)


def _run(command: list[str], work: str) -> None:
    """Compile in the folder `work` with relative names only, so that the library does not depend on its path."""
    cache = str(cache_folder() / ZIG)
    environment: Mapping[str, str] = {"ZIG_GLOBAL_CACHE_DIR": cache, "ZIG_LOCAL_CACHE_DIR": cache, **os.environ}
    done = subprocess.run(command, cwd=work, env=environment, check=False, capture_output=True, text=True)
    if done.returncode:
        said = next((line for line in done.stderr.splitlines() if "error" in line), f"exit code {done.returncode}")
        raise CompilerMissing(f"{Path(command[0]).name} could not compile a native FMU: {said}")


def _without_date(library: bytes) -> bytes:
    """A Windows library without its build time, the third field of its COFF header."""
    at = struct.unpack_from("<I", library, 0x3C)[0] + 8
    return library[:at] + bytes(4) + library[at + 4 :]


def _universal(*slices: bytes) -> bytes:
    """One macOS library for several processors: a table of offsets, then the libraries."""
    align, table, body = 14, struct.pack(">II", 0xCAFEBABE, len(slices)), b""
    start = 1 << align
    for part in slices:
        processor, kind = struct.unpack_from("<II", part, 4)
        body += bytes(-len(body) % (1 << align))
        table += struct.pack(">5I", processor, kind, start + len(body), len(part), align)
        body += part
    return table.ljust(start, b"\0") + body
