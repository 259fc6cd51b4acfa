"""An FMU's archive, checked before it is unpacked: its kind, size and paths.

A zip of 3 MB can hold 3 GB. The bounds are far above the size of FMUs and below the memory of a machine. The reader stops at
the sizes that the archive declares, so checking those is enough.
"""

import zipfile
import zlib
from itertools import takewhile
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree

from vpp_fmu.errors import BadInput
from vpp_fmu.files import reason
from vpp_fmu.scratch import Scratch

DESCRIPTION = "modelDescription.xml"

LARGEST = 500 * 2**20
"""Maximum unpacked size in bytes. This project's FMUs have 1 MB, those with a tool's runtime some 100 MB. A Raspberry Pi may
have 1 GB of memory, which also holds its temporary files."""

LARGEST_DESCRIPTION = 50 * 2**20
"""Maximum bytes of modelDescription.xml, which is read into memory: some 100 000 variables."""

ENTRIES = 20_000
"""Maximum number of files and folders: usually a few dozen, some thousand with sources, documentation and a runtime."""

RATIO = 200.0
"""Maximum ratio of unpacked to packed size: 2 to 20 for machine code and XML, 100 for tables of few values, 1000 for a bomb."""

_PACKING = (
    zipfile.ZIP_STORED,
    zipfile.ZIP_DEFLATED,
)  # as the standard requires; other methods have no bound on the size of one read
_BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError)  # RuntimeError: encrypted

READS = "FMI 2.0 co-simulation, which is what this reads"


def unpacked(path: Path) -> Scratch:
    """Unpack the archive to a new folder. BadInput: no FMI 2.0 co-simulation FMU, or out of bounds."""
    try:
        with zipfile.ZipFile(path) as archive:
            _check(path, archive)
            _check_version(path, archive)
            return _unpacked(path, archive)
    except FileNotFoundError as error:
        raise BadInput(path, "FMU", "no such file", READS) from error
    except _BROKEN as error:
        raise BadInput(path, "FMU", f"a broken archive, or none ({str(error) or type(error).__name__})", READS) from error
    except OSError as error:
        raise BadInput(path, "FMU", f"not readable ({reason(error)})", READS) from error


def _unpacked(path: Path, archive: zipfile.ZipFile) -> Scratch:
    try:
        scratch = Scratch()
        try:
            archive.extractall(scratch.path)
        except BaseException:
            scratch.close()
            raise
    except OSError as error:
        found = f"not to be unpacked ({reason(error)})"
        raise BadInput(path, "FMU", found, "files and folders of different names, and room for them") from error
    return scratch


def _check(path: Path, archive: zipfile.ZipFile) -> None:
    entries = archive.infolist()
    if len(entries) > ENTRIES:
        raise BadInput(path, "FMU", f"{len(entries)} files", f"{ENTRIES} at most")
    for entry in entries:
        _check_entry(path, entry)
    size, packed = sum(entry.file_size for entry in entries), max(path.stat().st_size, 1)
    if size > LARGEST:
        raise BadInput(path, "FMU", f"{size / 2**20:.0f} MB unpacked", f"{LARGEST / 2**20:.0f} MB at most")
    if size > RATIO * packed:
        found = f"{size / packed:.0f} times its size unpacked ({size / 2**20:.0f} MB)"
        raise BadInput(path, "FMU", found, f"{RATIO:g} times at most")


def _check_entry(path: Path, entry: zipfile.ZipInfo) -> None:
    name = entry.orig_filename
    parts = PurePosixPath(name).parts
    if not parts or name.startswith("/") or ".." in parts or any(c in name for c in "\\:\0"):
        raise BadInput(path, "FMU", f"an entry {name[:80]!r}", "paths that stay within the FMU's folder")
    if entry.compress_type not in _PACKING:
        raise BadInput(path, "FMU", f"packed by method {entry.compress_type}: {name[:80]!r}", "deflate, as the standard has it")
    if entry.flag_bits & 1:
        raise BadInput(path, "FMU", f"encrypted: {name[:80]!r}", "no encryption")


def _check_version(path: Path, archive: zipfile.ZipFile) -> None:
    """BadInput if the FMU is not FMI 2.0 co-simulation."""
    try:
        entry = archive.getinfo(DESCRIPTION)
    except KeyError as error:
        raise BadInput(path, "FMU", f"an archive without {DESCRIPTION}", READS) from error
    if entry.file_size > LARGEST_DESCRIPTION:
        found = f"{entry.file_size / 2**20:.0f} MB of {DESCRIPTION}"
        raise BadInput(path, "FMU", found, f"{LARGEST_DESCRIPTION / 2**20:.0f} MB at most")
    try:
        with archive.open(entry) as file:
            elements = (element for _, element in ElementTree.iterparse(file, events=("start",)))
            version = next(elements).get("fmiVersion", "of no version")
            kinds = {each.tag for each in takewhile(lambda element: element.tag != "ModelVariables", elements)}
    except (ElementTree.ParseError, LookupError) as error:
        raise BadInput(path, DESCRIPTION, f"no XML ({error})", READS) from error
    if version != "2.0":
        raise BadInput(path, "FMU", f"FMI {version[:20]}", READS)
    if "CoSimulation" not in kinds:
        found = "FMI 2.0 for model exchange only" if "ModelExchange" in kinds else "FMI 2.0 without co-simulation"
        raise BadInput(path, "FMU", found, READS)
