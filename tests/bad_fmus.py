"""FMUs that must be refused, made from a good one: the fault of each, and the words of its refusal."""

import io
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

DESCRIPTION = "modelDescription.xml"
SLAVE = "resources/slavemodule.txt"
FMI_1 = """<fmiModelDescription fmiVersion="1.0" modelName="M" modelIdentifier="M" guid="g"
numberOfContinuousStates="0" numberOfEventIndicators="0"/>"""
FMI_3 = """<fmiModelDescription fmiVersion="3.0" modelName="M" instantiationToken="t"><CoSimulation modelIdentifier="M"/>
<ModelVariables><Float64 name="time" valueReference="0" causality="independent" variability="continuous"/></ModelVariables>
<ModelStructure/></fmiModelDescription>"""
ZEROS = bytes(2**20)

Files = dict[str, bytes]


def _with(**changed: bytes | str | None) -> Callable[[Files], Files]:
    """Exchange some files of the good FMU; None removes one."""

    def made(files: Files) -> Files:
        found = {**files, **{name: text for name, text in changed.items() if text is not None}}
        return {name: content for name, content in found.items() if changed.get(name, "") is not None}

    return made


def _described(old: str, new: str) -> Callable[[Files], Files]:
    def made(files: Files) -> Files:
        text = files[DESCRIPTION].decode()
        assert old in text
        return {**files, DESCRIPTION: text.replace(old, new)}

    return made


def _only(part: str, name: str) -> Callable[[Files], Files]:
    """Give the binaries of the good FMU another name."""
    return lambda files: {k.replace(part, name) if k.startswith("binaries/") else k: v for k, v in files.items()}


def _library(content: bytes) -> Callable[[Files], Files]:
    return lambda files: {k: content if k.startswith("binaries/") else v for k, v in files.items()}


def _module(change: Callable[[bytes], bytes | None]) -> Callable[[Files], Files]:
    """Give the module of the good FMU another name."""
    return lambda files: _with(**{SLAVE: change(files[SLAVE])})(files)


CHANGED: Mapping[str, tuple[Callable[[Files], Files], tuple[str, ...]]] = {
    "FMI 3.0": (_with(**{DESCRIPTION: FMI_3}), ("found FMI 3.0", "FMI 2.0 co-simulation, which is what this reads")),
    "FMI 1.0": (_with(**{DESCRIPTION: FMI_1}), ("found FMI 1.0", "FMI 2.0 co-simulation, which is what this reads")),
    "model exchange only": (_described("<CoSimulation ", "<ModelExchange "), ("FMI 2.0 for model exchange only",)),
    "no description": (_with(**{DESCRIPTION: None}), ("without modelDescription.xml",)),
    "description no XML": (_with(**{DESCRIPTION: "fmiVersion 2.0"}), ("modelDescription.xml", "no XML")),
    "not as the schema": (_described('causality="output"', 'causality="outcome"'), ("modelDescription.xml", "outcome")),
    "for another machine": (_only("linux64", "win64"), ("binaries for win64 only",)),
    "no binaries": (lambda files: {k: v for k, v in files.items() if "binaries/" not in k}, ("no binaries",)),
    "library no library": (_library(b"\x7fELF not really"), ("a library that can't be loaded",)),
    "no slavemodule.txt": (_module(lambda name: None), ("no slavemodule.txt that names a module",)),
    "slavemodule.txt empty": (_module(lambda name: b""), ("no slavemodule.txt that names a module",)),
    "slavemodule.txt of bytes": (_module(lambda name: b"\xff\0"), ("no slavemodule.txt that names a module",)),
    "no module": (_module(lambda name: name + b"x"), ("no module vppplant_", "which slavemodule.txt names")),
    "path above": (_with(**{"../evil.txt": "x"}), ("../evil.txt", "within the FMU's folder")),
    "path above, inside": (_with(**{"resources/../../evil.txt": "x"}), ("resources/../../evil.txt", "within")),
    "absolute path": (_with(**{"/tmp/evil.txt": "x"}), ("/tmp/evil.txt", "within the FMU's folder")),
    "drive": (_with(**{"C:/evil.txt": "x"}), ("C:/evil.txt", "within the FMU's folder")),
    "backslashes": (_with(**{"resources\\evil.txt": "x"}), ("within the FMU's folder",)),
    "file where a folder is": (_with(**{"resources/a": "x", "resources/a/b": "y"}), ("not to be unpacked",)),
    "bomb of zeros": (_with(**{f"resources/{k}.bin": ZEROS for k in range(128)}), ("times its size unpacked", "200 times")),
    "20 001 files": (_with(**{f"resources/{k}": "" for k in range(20_001)}), ("files, expected 20000 at most",)),
}
"""By fault: how to make it from the files of the good FMU, and the words that the refusal must have."""


def _declared(size: int, name: str = DESCRIPTION) -> Callable[[zipfile.ZipFile], None]:
    def forge(archive: zipfile.ZipFile) -> None:
        archive.getinfo(name).file_size = size

    return forge


def _flagged(archive: zipfile.ZipFile) -> None:
    archive.getinfo(DESCRIPTION).flag_bits |= 1


FORGED: Mapping[str, tuple[Callable[[zipfile.ZipFile], None], tuple[str, ...]]] = {
    "600 MB declared": (_declared(600 * 2**20, "resources/large.bin"), ("MB unpacked", "500 MB at most")),
    "60 MB of XML": (_declared(60 * 2**20), ("60 MB of modelDescription.xml", "50 MB at most")),
    "smaller than it is": (_declared(10, "resources/large.bin"), ("a broken archive",)),
    "encrypted": (_flagged, ("encrypted", "modelDescription.xml")),
}
"""The same for faults in the directory of the archive."""


def bad_fmus(good: Path, folder: Path) -> dict[str, tuple[Path, tuple[str, ...]]]:
    """(path, words that the refusal must have) by fault."""
    with zipfile.ZipFile(good) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    incompressible = bytes(range(256)) * 4096
    found = {}

    def put(what: str, content: bytes, words: tuple[str, ...]) -> None:
        path = folder / f"{''.join(c if c.isalnum() else '_' for c in what)}.fmu"
        path.write_bytes(content)
        found[what] = path, words

    for what, (change, words) in CHANGED.items():
        put(what, _zipped(change(files)), words)
    for what, (forge, words) in FORGED.items():
        put(what, _zipped({**files, "resources/large.bin": incompressible * 4}, forge, zipfile.ZIP_STORED), words)
    put("packed by bzip2", _zipped(files, packing=zipfile.ZIP_BZIP2), ("packed by method 12", "deflate"))
    put("cut off", _zipped(files)[:-100], ("a broken archive, or none",))
    put("text", b"not a zip", ("a broken archive, or none",))
    put("empty", b"", ("a broken archive, or none",))
    (folder / "folder.fmu").mkdir()
    return found | {
        "a folder": (folder / "folder.fmu", ("is a directory",)),
        "nowhere": (folder / "none.fmu", ("no such file",)),
        "below a file": (good / "none.fmu", ("not a directory",)),
    }


def _zipped(files: Mapping[str, bytes | str], forge=lambda archive: None, packing: int = zipfile.ZIP_DEFLATED) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", packing) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
        forge(archive)  # before the directory is written
    return packed.getvalue()
