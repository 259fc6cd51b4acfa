"""One line in the terminal with the state of the loop, five times a second.

A terminal may block (a slow line, Ctrl-S). So the line has a descriptor of its own, which never waits: text that the terminal
does not take is dropped.
"""

import contextlib
import math
import os
import sys
from collections.abc import Iterable, Sequence

EVERY = 50
"""Ticks between two lines."""

_ERASE = "\r\x1b[K"


class StatusLine:
    """The last line of the terminal of this name, as of `os.ttyname`. OSError if it can't be opened."""

    def __init__(self, terminal: str):
        self._out = os.open(terminal, os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)

    def show(self, text: str) -> None:
        """Replace the line, within the terminal's width."""
        with contextlib.suppress(OSError):
            width = os.get_terminal_size(self._out).columns or 80
            os.write(self._out, (_ERASE + text[: width - 1]).encode())

    def close(self) -> None:
        """Erase the line."""
        self.show("")
        os.close(self._out)


def status_line() -> StatusLine | None:
    """A line on the terminal of standard error, None without one."""
    with contextlib.suppress(OSError):
        return StatusLine(os.ttyname(sys.stderr.fileno()))
    return None


def text_of(state: str, numbers: Iterable[tuple[str, str, float, str]], warnings: Sequence[str]) -> str:
    """The line's text. `numbers`: name, format, value and unit of each; unknown values (NaN) are omitted."""
    known = [f"{name} {value:{form}} {unit}".rstrip() for name, form, value, unit in numbers if not math.isnan(value)]
    return " | ".join([f"{state:9}", *known, *warnings])
