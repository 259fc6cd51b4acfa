"""The live view: the newest row of the loop in the terminal, five times a second, drawn by a process of its own.

A terminal may block (a slow line, Ctrl-S), so the loop only writes to memory and never waits for it. Nothing is shown if
standard error is not a terminal.
"""

import json
import math
import mmap
import os
import shutil
import struct
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import Protocol

_EVERY = 0.2  # s
_ERASE = "\r\x1b[K"


class View(Protocol):
    """Shows the latest values."""

    def show(self, *values: float) -> None:
        """Show the newest values."""

    def close(self) -> None:
        """End the view."""


class NoView:
    """Shows nothing."""

    def show(self, *values):
        pass

    def close(self):
        pass


class LiveView:
    """Shows labelled numbers. `labels`: name, format and unit of each, as ("thrust", "6.2f", "N"); `words`: by the label's
    name, the words that the number is an index of."""

    def __init__(self, labels: Sequence[tuple[str, str, str]], words: dict[str, Sequence[str]]):
        self._row = struct.Struct(f"{len(labels)}d")
        shared = os.memfd_create("hil-live")
        os.ftruncate(shared, self._row.size)
        self._page = mmap.mmap(shared, self._row.size)
        described = [json.dumps(list(labels)), json.dumps({name: list(text) for name, text in words.items()})]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "hil.live", str(shared), *described],
            pass_fds=(shared,),
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            start_new_session=True,  # so that Ctrl-C does not reach it
        )
        os.close(shared)

    def show(self, *values):
        self._row.pack_into(self._page, 0, *values)

    def close(self):
        self._process.stdin.close()
        try:
            self._process.wait(1.0)
        except subprocess.TimeoutExpired:  # the terminal blocks
            self._process.kill()
            self._process.wait()
        self._page.close()


def view(labels: Sequence[tuple[str, str, str]], words: dict[str, Sequence[str]]) -> View:
    """A live view if standard error is a terminal."""
    return LiveView(labels, words) if sys.stderr.isatty() else NoView()


def line(labels: Sequence[tuple[str, str, str]], words: dict[str, Sequence[str]], values: Sequence[float], width: int) -> str:
    """The line's text, without unknown values (NaN)."""
    cells = []
    for (name, form, unit), value in zip(labels, values, strict=True):
        if math.isnan(value):
            continue
        if name in words:
            word = words[name][int(value)]
            cells += [f"{word:9}"] * bool(word)
        else:
            cells.append(f"{name} {value:{form}} {unit}".rstrip())
    return " | ".join(cells)[: width - 1]


def width_of(terminal: int) -> int:
    """Columns of the terminal of a descriptor; `shutil` would use standard output, which is not a terminal here."""
    try:
        return os.get_terminal_size(terminal).columns or 80
    except OSError:
        return shutil.get_terminal_size().columns


def _draw(shared: int, labels, words) -> None:
    row = struct.Struct(f"{len(labels)}d")
    page = mmap.mmap(shared, row.size)
    os.set_blocking(0, False)
    while True:
        try:
            if not os.read(0, 1):  # the loop has ended
                break
        except BlockingIOError:
            pass
        sys.stderr.write(_ERASE + line(labels, words, row.unpack_from(page), width_of(2)))
        sys.stderr.flush()
        time.sleep(_EVERY)
    sys.stderr.write(_ERASE)
    sys.stderr.flush()


if __name__ == "__main__":
    _draw(int(sys.argv[1]), *map(json.loads, sys.argv[2:]))
