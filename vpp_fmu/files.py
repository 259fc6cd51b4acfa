"""Read files; write output atomically."""

import contextlib
import gzip
import os
import tempfile
import zlib
from dataclasses import dataclass
from pathlib import Path

from vpp_fmu.errors import BadInput


class OutputFolder:
    """The folder that one job writes to. It is created if it does not exist.

    BadInput if it can't be created or written, so that a long job fails before its work and not after.
    """

    def __init__(self, path: str | os.PathLike):
        self.path = Path(path)
        self._others: dict[str, bool] = {}
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            # Permission bits are not reliable (root, read-only mounts, /proc), so a write is tried.
            tempfile.TemporaryFile(dir=self.path).close()
        except FileExistsError as error:
            raise self._refused("a file") from error
        except OSError as error:
            raise self._refused(f"not writable ({reason(error)})") from error

    @property
    def replaced(self) -> tuple[str, ...]:
        """Names of files that `write` replaced and whose content was different."""
        return tuple(name for name, other in self._others.items() if other)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the files that `write` wrote."""
        return tuple(self._others)

    def write(self, name: str, data: str | bytes) -> Path:
        """Write `data` (text as UTF-8) to the file `name`; returns its path.

        The previous file stays until the new one is complete. BadInput if the system refuses.
        """
        target, content = self.path / name, as_bytes(data)
        other = holds_other(target, content)
        write_whole(target, content, target)
        self._others.setdefault(name, other)  # a second write in the same job replaces no file of the user's
        return target

    def _refused(self, found: str) -> BadInput:
        return BadInput(self.path, "output folder", found, "a folder that can be written")


@dataclass(frozen=True)
class InFolder:
    """From a path to the path of a file: a folder stands for the first of its files `names` that exists."""

    names: tuple[str, ...]

    def __call__(self, path: str | os.PathLike) -> str:
        if not os.path.isdir(path):
            return os.fspath(path)
        found = [os.path.join(path, name) for name in self.names]
        return next(filter(os.path.exists, found), found[0])


def as_bytes(data: str | bytes) -> bytes:
    """The bytes of `data`: text as UTF-8, with "?" for each byte of a file's name that is no UTF-8."""
    return data.encode(errors="replace") if isinstance(data, str) else data


def write_whole(path: Path, content: bytes, shown: Path) -> None:
    """Write a file; the previous one stays until the new one is complete. BadInput, naming `shown`, if the system refuses."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with open(temporary, "wb") as file:  # not mkstemp: only the owner can read its files
            file.write(content)
            file.flush()
            os.fsync(file.fileno())  # without it a power cut can leave an empty file
        os.replace(temporary, path)
    except OSError as error:
        raise BadInput(shown, "output file", f"not writable ({reason(error)})", "a file that can be written") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def holds_other(path: Path, content: bytes) -> bool:
    """Whether `path` exists and is not a file of this content."""
    try:
        return os.path.lexists(path) and path.read_bytes() != content
    except OSError:
        return True


def reason(error: OSError) -> str:
    """The system's reason for an error."""
    return (error.strerror or str(error)).lower()


LARGEST = 500 * 2**20
"""Maximum bytes of a file that is read into memory: some 10 million rows of a record."""

RATIO = 200
"""Maximum ratio of unpacked to packed size, beyond the first megabyte: 3 to 50 for tables, 1000 for a bomb."""


def read_bytes(path: str | os.PathLike) -> bytes:
    """The bytes of a file, unpacked if its name ends in .gz. BadInput."""
    path = Path(path)
    packed = path.suffix.lower() == ".gz"
    try:
        size = path.stat().st_size
        most = min(LARGEST, RATIO * size + 2**20) if packed else LARGEST
        with gzip.open(path) if packed else open(path, "rb") as file:
            data = file.read(most + 1)
    except (FileNotFoundError, NotADirectoryError) as error:
        raise BadInput(path, "file", "no such file", "a file that exists") from error
    except IsADirectoryError as error:
        raise BadInput(path, "file", "a folder", "a file") from error
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise BadInput(path, "file", "broken or cut off gzip data", "a whole gzip file") from error
    except OSError as error:
        raise BadInput(path, "file", f"not readable ({reason(error)})", "a file that can be read") from error
    if len(data) > most:
        bomb = packed and most < LARGEST
        allowed = f"{RATIO} times its size and 1 MB at most, unpacked" if bomb else f"{LARGEST / 2**20:.0f} MB at most"
        raise BadInput(path, "file", f"more than {most / 2**20:.0f} MB{' unpacked' * packed}", allowed)
    return data


def read_text(path: str | os.PathLike) -> str:
    """The text of a UTF-8 file, unpacked if its name ends in .gz; without byte-order mark, lines ended by LF. BadInput."""
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise BadInput(path, f"line {line}", f"the byte 0x{error.object[error.start]:02x}", "text in UTF-8") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def shown(cell: str) -> str:
    """A cell for a message: quoted, on one line, shortened."""
    return repr(cell if len(cell) <= 40 else f"{cell[:37]}...") if cell else "an empty cell"
