"""Read text files and tables; write output atomically."""

import contextlib
import csv
import gzip
import math
import os
import tempfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

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


@dataclass(frozen=True, eq=False)
class Table:
    """The content of a CSV file.

    `columns`: by name in the file's order, (n,) float if every cell is a finite number, else (n,) str as found.
    `lines`: (n,) line number of each row.
    """

    source: str
    columns: Mapping[str, np.ndarray]
    lines: np.ndarray

    def wrong(self, name: str, row: int, found: object, allowed: str, hint: str = "") -> BadInput:
        """The error that names a cell."""
        return BadInput(self.source, f"{name}, line {self.lines[row]}", found, allowed, hint)

    def numbers(self, name: str, gaps: Sequence[str] = ()) -> np.ndarray:
        """(n,) the column as float; `gaps`: cells that become NaN. BadInput names the first invalid cell."""
        cells = self.columns[name]
        if cells.dtype != object:
            return cells
        values = np.array([_number(cell) for cell in cells])
        for row in np.flatnonzero(~np.isfinite(values)):
            if cells[row].lower() not in gaps:
                allowed = "a finite number or an empty cell" if gaps else "a finite number"
                raise self.wrong(name, row, shown(cells[row]), allowed)
        return values


def read_table(path: str | os.PathLike) -> Table:
    """Read a CSV with a header. BadInput: not readable, no header, no rows, columns without or with the same name, ragged."""
    lines = read_text(path).split("\n")
    first = next((i for i, line in enumerate(lines) if line.strip()), None)
    if first is None:
        raise BadInput(path, "file", "an empty file", "a header and at least one row")
    names = _names(path, lines[first])
    rows = [(i, line) for i, line in enumerate(lines[first + 1 :], first + 2) if line.strip()]
    if not rows:
        raise BadInput(path, "file", "a header without rows", "a header and at least one row")
    columns = _all_numbers([line for _, line in rows], len(names))
    numbers = [i for i, _ in rows]
    if columns is None:
        numbers, cells = _cells(path, lines[first + 1 :], first + 1, len(names))
        columns = [_column(column) for column in zip(*cells, strict=True)]
    return Table(str(path), dict(zip(names, columns, strict=True)), np.array(numbers))


def _names(path: str | os.PathLike, line: str) -> list[str]:
    try:
        names = [name.strip() for name in next(csv.reader([line]))]
    except csv.Error as error:
        raise BadInput(path, "header", error, "names separated by commas") from error
    for i, name in enumerate(names):
        if not name:
            raise BadInput(path, f"header, column {i + 1}", "no name", "a name for each column")
        if not name.isprintable():  # it would break the single line of a message
            raise BadInput(path, f"header, column {i + 1}", shown(name), "a name of printable characters")
        if name in names[:i]:
            raise BadInput(path, f"column {name}", "more than one of that name", "each column once")
    return names


def _all_numbers(rows: Sequence[str], width: int) -> Sequence[np.ndarray] | None:
    """The columns of a table of finite numbers only; None for any other table. This is the fast path."""
    try:
        grid = np.loadtxt(rows, delimiter=",", comments=None, ndmin=2)
    except ValueError:
        return None
    return grid.T.copy() if grid.shape[1] == width and np.isfinite(grid).all() else None


def _cells(path: str | os.PathLike, lines: Sequence[str], before: int, width: int) -> tuple[list[int], list[list[str]]]:
    """Line numbers and cells of the rows after the first `before` lines."""
    reader = csv.reader(f"{line}\n" for line in lines)
    numbers, rows = [], []
    try:
        for cells in reader:
            if not cells or (len(cells) == 1 and cells[0].isspace()):
                continue
            if len(cells) != width:
                found = f"{len(cells)} cell{'s' * (len(cells) != 1)}"
                raise BadInput(path, f"line {before + reader.line_num}", found, f"{width} cells, as in the header")
            numbers.append(before + reader.line_num)
            rows.append([cell.strip() for cell in cells])
    except csv.Error as error:
        raise BadInput(path, f"line {before + reader.line_num}", error, "cells separated by commas") from error
    if not rows:
        raise BadInput(path, "file", "a header without rows", "a header and at least one row")
    return numbers, rows


def _column(cells: Sequence[str]) -> np.ndarray:
    if not math.isfinite(_number(cells[0])):
        return np.array(cells, dtype=object)
    values = np.array([_number(cell) for cell in cells])
    return values if np.isfinite(values).all() else np.array(cells, dtype=object)


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan
