"""The full-rate log: the loop puts rows into memory, another process writes them to a file. Standard library only.

The loop never touches a file: a row costs it two microseconds, a write to disk sometimes 24 ms. The writer is a separate
process with shared memory, so that they share no interpreter lock. Lines on a pipe tell it of each row (an empty line) and each
event (a JSON object). In the same memory the writer keeps the number of rows on the disk, so that the loop notices a late one.
The writer ends when the pipe closes: if the loop is killed, its log is still complete. If the loop ended without a goodbye, the
writer then executes the command that it was given for this case.

The events (`events_of`) have a second file, one JSON object a line: single occurrences that must survive the loop.
"""

import contextlib
import fcntl
import json
import math
import mmap
import os
import signal
import struct
import subprocess
import sys
import time
import zlib
from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

from vpp_fmu.errors import BadInput

LATE = 1.0
"""Time, s, after which a row that is due on the disk is late: the log is then broken."""

_BATCH = 4096  # bytes of the pipe, rows at most, that the writer takes at once
_PAUSE = 0.05  # s between two batches
_GET_PIPE_SIZE = 1032  # F_GETPIPE_SZ; Python names it from 3.10 on only where the system's headers do
_SYNC_EVERY = 1.0  # s; a power cut may lose the rows of this time, and gzip holds them back
_HANGS = 5.0  # s without a row on the disk after which the writer is ended
_ROW, _GOODBYE = b"\n", b'"goodbye"'
_SAVED, _ERROR, _BYTES, _FREE, _DONE = range(5)
"""Numbers in the memory after the rows: rows saved, the writer's error, bytes saved and free; and the loop's share done."""
_PACKED = 0.45  # of the size of random decimal digits that gzip leaves: log2(10) = 3.3 of 8 bits, Huffman's code needs 3.4


@dataclass(frozen=True)
class Column:
    """A column of the log. `words`: a value is an index into this list, and its cell is the word."""

    name: str
    exact: bool = False
    """Reads back to the same bits; otherwise nine digits are kept. A value that is not finite is an empty cell either way."""
    words: tuple[str, ...] = ()


@dataclass(frozen=True)
class Logged:
    """Result of a log: rows in the file, rows lost, the failure, if any, and a disk that ran short."""

    rows: int
    lost: int
    failure: str = ""
    warning: str = ""


def events_of(path: Path) -> Path:
    """The file of a log's events: log.events.jsonl for log.csv, log.csv.gz and their unfinished forms."""
    return path.with_name(f"{path.name.removeprefix('.').partition('.')[0]}.events.jsonl")


def read_events(path: Path) -> list[dict]:
    """Read a file of events. A line that is no JSON object, as after a crash, is skipped."""
    found = []
    with contextlib.suppress(FileNotFoundError):
        for line in path.read_bytes().splitlines():
            with contextlib.suppress(ValueError, RecursionError):
                found.append(json.loads(line))
    return [event for event in found if isinstance(event, dict)]


class MemoryLog:
    """A log for virtual time: kept in memory, written by `close`.

    It takes rows of numbers, one float per column. `broken`: why rows no longer reach the file; `warning`: why the disk may not
    hold the rest of the rows; both are empty while all is well. `done`: share of the measurement that is done.
    """

    def __init__(self, path: str | os.PathLike, columns: Sequence[Column]):
        self._path, self._columns, self._numbers = Path(path), tuple(columns), array("d")
        self._events, self.broken, self.warning, self.done = _Events(events_of(self._path)), "", "", 0.0

    def put(self, *row: float) -> None:
        """Keep a row."""
        self._numbers.extend(row)

    def note(self, event: Mapping) -> None:
        """Keep an event, a JSON object, beside the rows."""
        self._events.add(_line(event))

    def close(self) -> Logged:
        """Finish the file."""
        self._events.close()
        width, file = len(self._columns), _File(self._path, self._columns)
        for first in range(0, len(self._numbers), _BATCH * width):
            numbers = self._numbers[first : first + _BATCH * width]
            file.add(numbers[k : k + width] for k in range(0, len(numbers), width))
        return file.close()


class ProcessLog:
    """A MemoryLog for real time. The memory holds as many rows as a pipe holds bytes, 65536 as a rule: four minutes at 250 Hz.

    `after`: the command that the writer executes if the loop ends without `close`. `rows`: their expected number, for the
    warning. The first column is the time [s]. A process with the descriptor `shared` can read the rows (`Reader`) at no cost to
    the loop. BadInput if the file cannot be begun.
    """

    def __init__(self, path: str | os.PathLike, columns: Sequence[Column], after: Sequence[str] = (), rows: int = 0):
        self._row, self._head, self._lost, self._expected = struct.Struct(f"{len(columns)}d"), 0, 0, rows
        self._broken = self._warning = ""
        read, self._pipe = os.pipe()
        # The writer takes a batch from the pipe before it reads the rows from memory: room for one batch more.
        self.slots = fcntl.fcntl(self._pipe, _GET_PIPE_SIZE) + _BATCH
        shared = os.memfd_create("hil-log")
        self._memory, self._status = _shared(shared, self.slots * self._row.size)
        os.set_blocking(self._pipe, False)
        self.path, self.columns, self.shared = Path(path), tuple(columns), shared
        self._due = LATE + _SYNC_EVERY * (self.path.suffix == ".gz")
        task = json.dumps([str(path), [astuple(c) for c in columns], list(after), self.slots, shared, read])
        self._writer = subprocess.Popen(
            [sys.executable, "-m", "hil.loop.log", task],
            pass_fds=(shared, read),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            start_new_session=True,  # so that Ctrl-C does not reach it
        )
        os.close(read)
        if refused := json.loads(self._writer.stdout.readline() or '"the writer of the log has died"'):
            self.close()
            raise BadInput(path, "log", f"not writable ({refused})", "a file that can be written")

    @property
    def writer(self) -> int:
        """Number of the writer's process."""
        return self._writer.pid

    def put(self, *row):
        self._row.pack_into(self._memory, self._head % self.slots * self._row.size, *row)
        try:
            os.write(self._pipe, _ROW)
        except (BlockingIOError, BrokenPipeError) as error:
            self._lost += 1
            gone = isinstance(error, BrokenPipeError)
            self._broken = self._broken or (f"its writer, process {self.writer}, " + ("has died" if gone else "takes no rows"))
        else:
            self._head += 1

    @property
    def broken(self):
        saved = int(self._status[_SAVED])
        if not self._broken and saved < self._head:
            late = self._time(self._head - 1) - self._time(saved)
            if late > self._due:
                error = int(self._status[_ERROR])
                why = os.strerror(error).lower() if error else f"process {self.writer} does not write"
                self._broken = f"{self.path}: {why}: found rows that wait {late:.1f} s for the disk, expected {self._due:g} s"
        return self._broken

    @property
    def warning(self):
        saved, _, size, free, _ = self._status
        need = (self._expected - saved) * size / saved if saved else 0.0
        if not self._warning and free < need:
            self._warning = f"the disk has {free / 1e6:.1f} MB left, the rest of the log takes {need / 1e6:.1f} MB"
        return self._warning

    @property
    def done(self):
        return self._status[_DONE]

    @done.setter
    def done(self, share):
        self._status[_DONE] = share

    def note(self, event):
        with contextlib.suppress(BlockingIOError, BrokenPipeError):  # `put` reports it
            os.write(self._pipe, _line(event))

    def close(self):
        with contextlib.suppress(BlockingIOError, BrokenPipeError):
            os.write(self._pipe, _GOODBYE + b"\n")
        os.close(self._pipe)
        data, saved = self._finished(), int(self._status[_SAVED])
        self._status.release()
        self._memory.close()
        os.close(self.shared)
        try:
            rows, failure = json.loads(data)
        except ValueError:
            rows, failure = saved, f"the log's writer has died (exit code {self._writer.poll()})"
        return Logged(rows, self._lost + self._head - rows, failure, self._warning)

    def _finished(self) -> bytes:
        """The writer's result. A writer that hangs, as on a network disk that is gone, is ended."""
        saved = -1.0
        while saved < self._status[_SAVED]:
            saved = self._status[_SAVED]
            with contextlib.suppress(subprocess.TimeoutExpired):
                return self._writer.communicate(timeout=_HANGS)[0]
        self._writer.kill()
        self._writer.stdout.close()
        with contextlib.suppress(subprocess.TimeoutExpired):  # the kernel may hold it for as long as the disk does not answer
            self._writer.wait(_HANGS)
        return b""

    def _time(self, row: int) -> float:
        return self._row.unpack_from(self._memory, row % self.slots * self._row.size)[0]


Log = MemoryLog | ProcessLog


class Reader:
    """Reads a ProcessLog's memory from another process, while the loop writes to it: `width` numbers a row in `slots` places.

    A row is complete once the next one is written, with a later time in the first column.
    """

    def __init__(self, shared: int, slots: int, width: int):
        self._row, self._slots, self._next = struct.Struct(f"{width}d"), slots, 0
        self._memory = mmap.mmap(shared, 0, access=mmap.ACCESS_READ)

    def rows(self) -> list[tuple[float, ...]]:
        """Rows that were completed since the last call."""
        found = []
        while len(found) < _BATCH and self._at(self._next + 1)[0] > self._at(self._next)[0]:
            found.append(self._at(self._next))
            self._next += 1
        return found

    @property
    def done(self) -> float:
        """Share of the measurement that is done."""
        return struct.unpack_from("d", self._memory, self._slots * self._row.size + _DONE * struct.calcsize("d"))[0]

    def close(self) -> None:
        self._memory.close()

    def _at(self, place: int) -> tuple[float, ...]:
        return self._row.unpack_from(self._memory, place % self._slots * self._row.size)


class _Events:
    """The file of events, created with the first of them. Lines that a full disk refuses are written later."""

    def __init__(self, path: Path):
        self._path, self._file, self._waiting = path, None, bytearray()

    def add(self, lines: bytes) -> None:
        """Write complete lines."""
        self._waiting += lines
        if not self._waiting:
            return
        with contextlib.suppress(OSError):
            if self._file is None:
                self._file = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
            while self._waiting:
                del self._waiting[: os.write(self._file, self._waiting)]
            os.fsync(self._file)

    def close(self) -> None:
        self.add(b"")
        if self._file is not None:
            os.close(self._file)


class _File:
    """The growing CSV, under a temporary name until it is complete. If the disk is full, rows wait in memory.

    `saved` rows and `written` bytes are on the disk; `error`: the number of the system's error while rows wait, else 0.
    """

    def __init__(self, path: Path, columns: Sequence[Column]):
        self._path, self._part = path, path.with_name(f".{path.name}.part")
        self._cells: list[Callable[[float], str]] = [cell(column) for column in columns]
        self._pack = zlib.compressobj(1, wbits=31) if path.suffix == ".gz" else None
        self._waiting, self._rows, self.saved, self.written, self.error = bytearray(), 0, 0, 0, 0
        self._synced = time.monotonic()
        self._file = os.open(self._part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        fcntl.flock(self._file, fcntl.LOCK_EX)  # else `found_log` would take it for an abandoned one
        self._queue(",".join(column.name for column in columns) + "\n")

    def add(self, rows: Iterable[Sequence[float]]) -> None:
        """Write rows, or keep them if the disk is full."""
        lines = [",".join([write(value) for write, value in zip(self._cells, row, strict=True)]) for row in rows]
        self._rows += len(lines)
        self._queue("\n".join(lines) + "\n" if lines else "")
        self._flush()

    def close(self) -> Logged:
        """Write the waiting rows and give the file its name. A gzip file that a full disk cut off keeps its temporary name, by
        which `hil.loop.session.found_log` finds it for repair."""
        self._flush(zlib.Z_FINISH)
        whole = self._rows if self._pack else min(self._rows, self._waiting.count(b"\n"))
        lost = whole if self._waiting else 0
        with contextlib.suppress(OSError):
            if lost:
                os.ftruncate(self._file, self._last_line())
            os.fsync(self._file)
        os.close(self._file)
        if not (lost and self._pack):
            os.replace(self._part, self._path)
        return Logged(self._rows - lost, lost, f"{self._path}: {os.strerror(self.error).lower()}" if lost else "")

    def _queue(self, text: str) -> None:
        self._waiting += self._pack.compress(text.encode()) if self._pack else text.encode()

    def _flush(self, packing: int = zlib.Z_SYNC_FLUSH) -> None:
        due = packing == zlib.Z_FINISH or time.monotonic() - self._synced > _SYNC_EVERY
        if due and self._pack:  # so that the data so far can be unpacked without the rest
            self._waiting += self._pack.flush(packing)
        try:
            while self._waiting:
                count = os.write(self._file, self._waiting)
                del self._waiting[:count]
                self.written += count
            if due:
                os.fsync(self._file)
                self._synced = time.monotonic()
        except OSError as error:
            self.error = error.errno
        else:
            self.error = 0
            if due or not self._pack:
                self.saved = self._rows

    def _last_line(self) -> int:
        """Offset of the end of the file's last complete line [bytes]."""
        if self._pack:
            return self.written
        with open(self._part, "rb") as file:
            return file.read().rfind(b"\n") + 1


def cell(column: Column) -> Callable[[float], str]:
    """The function that formats a column's numbers."""
    if column.words:
        return lambda value: column.words[int(value)]
    if column.name == "time":
        return lambda value: repr(round(value, 9))
    if column.exact:
        return lambda value: repr(value) if math.isfinite(value) else ""
    return lambda value: f"{value:.9g}" if math.isfinite(value) else ""


def largest(path: Path, columns: Sequence[Column], rows: int) -> int:
    """Size [bytes] that a log of so many rows does not exceed."""
    widest = {name: 99999.996 if name == "time" else -math.pi * 1e-200 for name in (column.name for column in columns)}
    cells = (max(map(len, c.words)) if c.words else len(cell(c)(widest[c.name])) for c in columns)
    return round(rows * (sum(cells) + len(columns)) * (_PACKED if path.suffix == ".gz" else 1.0))


def _shared(descriptor: int, size: int) -> tuple[mmap.mmap, memoryview]:
    """(memory of the rows, `size` bytes, and of the numbers after them; a view of these numbers)."""
    numbers = (_DONE + 1) * struct.calcsize("d")
    os.ftruncate(descriptor, size + numbers)
    memory = mmap.mmap(descriptor, size + numbers)
    return memory, memoryview(memory)[size:].cast("d")  # a view stores a number at once, other than struct


def _line(event: Mapping) -> bytes:
    return json.dumps(event).encode() + b"\n"


def write_rows(path: Path, columns: Sequence[Column], slots: int, shared: int, pipe: int) -> tuple[Logged, bool]:
    """The writer's loop: for each empty line on `pipe` write a row from the memory `shared` to the file, and write the other
    lines as events. Returns the log's result and whether the loop said goodbye."""
    row = struct.Struct(f"{len(columns)}d")
    memory, status = _shared(shared, slots * row.size)
    file, events, taken, goodbye, rest = _File(path, columns), _Events(events_of(path)), 0, False, b""
    print("null", flush=True)  # it takes rows
    while data := os.read(pipe, _BATCH):
        *lines, rest = (rest + data).split(b"\n")
        told, rows = [line for line in lines if line], lines.count(b"")
        file.add([row.unpack_from(memory, k % slots * row.size) for k in range(taken, taken + rows)])
        taken += rows
        status[_SAVED], status[_ERROR], status[_BYTES] = file.saved, file.error, file.written
        status[_FREE] = free_bytes(path.parent)
        goodbye |= _GOODBYE in told
        events.add(b"".join(line + b"\n" for line in told if line != _GOODBYE))
        if len(data) < _BATCH:  # else more is waiting
            time.sleep(_PAUSE)
    events.close()
    return file.close(), goodbye


def free_bytes(folder: Path) -> int:
    """Free space [bytes] of a folder's disk for an ordinary user."""
    disk = os.statvfs(folder)
    return disk.f_bavail * disk.f_frsize


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # it ends when its loop does
    name, described, after, *rest = json.loads(sys.argv[1])
    try:
        done, ended = write_rows(Path(name), [Column(n, exact, tuple(words)) for n, exact, words in described], *rest)
    except OSError as error:  # the file could not be begun
        print(json.dumps((error.strerror or str(error)).lower()))
        sys.exit(1)
    with contextlib.suppress(BrokenPipeError):  # its loop may be gone
        os.write(1, json.dumps([done.rows, done.failure]).encode())
    if after and not ended:
        os.dup2(2, 1)  # standard output was a pipe to the loop
        os.execv(after[0], after)
