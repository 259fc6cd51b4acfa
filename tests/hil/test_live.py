import fcntl
import math
import os
import select
import struct
import sys
import termios
import time

import pytest

from hil.loop.live import EVERY, StatusLine, status_line, text_of

ERASE = "\r\x1b[K"


def test_the_text_has_names_numbers_units_and_warnings_but_no_unknown_values():
    numbers = (("thrust", "6.2f", 7.256, "N"), ("set-point", "6.2f", math.nan, "N"), ("missed", "3.0f", 2, ""))
    assert text_of("run", numbers, ["ALARM"]) == "run       | thrust   7.26 N | missed   2 | ALARM"


@pytest.fixture
def terminal():
    """Both ends of a terminal: what it shows, and what a program writes to."""
    ours, theirs = os.openpty()
    os.set_blocking(ours, False)
    yield ours, theirs
    os.close(ours)
    os.close(theirs)


def shown(terminal, end: str) -> str:
    """What a terminal shows until a text comes; the kernel may pass it on in parts."""
    found = ""
    while not found.endswith(end) and select.select(terminal[:1], [], [], 5.0)[0]:
        found += os.read(terminal[0], 65536).decode()
    return found


@pytest.mark.parametrize("columns", [60, 200])
def test_the_terminals_own_width_is_used(terminal, columns):
    fcntl.ioctl(terminal[1], termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    line = StatusLine(os.ttyname(terminal[1]))
    line.show("x" * 500)
    line.close()
    whole = ERASE + "x" * (columns - 1) + ERASE  # the line is gone at the end
    assert shown(terminal, whole) == whole


def test_a_blocked_terminal_does_not_delay_the_loop(terminal):
    """Nor do writes of the program itself wait less than before: the line's descriptor is its own."""
    line = StatusLine(os.ttyname(terminal[1]))
    termios.tcflow(terminal[1], termios.TCOOFF)  # Ctrl-S
    began = time.monotonic()
    for k in range(1000):
        line.show(f"row {k}")
    assert time.monotonic() - began < 5.0  # a write that waits would never return
    assert os.get_blocking(terminal[1])
    termios.tcflow(terminal[1], termios.TCOON)
    line.show("the newest row")
    newest = f"{ERASE}the newest row"
    assert shown(terminal, newest).endswith(newest)
    line.close()


def test_without_a_terminal_there_is_no_line(monkeypatch, tmp_path):
    with open(tmp_path / "errors", "w") as file:
        monkeypatch.setattr(sys, "stderr", file)
        assert status_line() is None


def test_the_line_of_a_rig_is_shown_five_times_a_second(terminal, new_rig):
    line = StatusLine(os.ttyname(terminal[1]))
    rig, _ = new_rig(line=line)
    rig.start(3000.0, 2.0)
    os.read(terminal[0], 10**6)
    for _ in range(3 * EVERY):
        rig.step(3000.0, 2.0)
    shown = os.read(terminal[0], 10**6).decode().split(ERASE)[1:]
    assert len(shown) == 3
    assert all(text.startswith("run       | thrust") for text in shown)
    rig.stop()
    line.close()
