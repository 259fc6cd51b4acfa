import fcntl
import math
import os
import struct
import subprocess
import sys
import termios
import time

import pytest

from hil.columns import SHOWN, shown_beside
from hil.columns import WORDS as SHOWN_WORDS
from hil.live import NoView, line, view

LABELS = (("state", "s", ""), ("thrust", "6.2f", "N"), ("speed", "5.0f", "rpm"))
WORDS = {"state": ("safe", "run")}


def test_a_line_shows_names_numbers_and_units():
    assert line(LABELS, WORDS, (1.0, 7.256, 4321.4), 80) == "run       | thrust   7.26 N | speed  4321 rpm"


def test_unknown_values_are_omitted_and_a_line_fits_a_narrow_terminal():
    assert line(LABELS, WORDS, (0.0, math.nan, 10.0), 80) == "safe      | speed    10 rpm"
    assert line(LABELS, WORDS, (math.nan, 7.256, math.nan), 80) == "thrust   7.26 N"
    assert len(line(LABELS, WORDS, (1.0, 7.256, 4321.4), 20)) == 19


def test_every_label_of_the_rig_can_be_shown():
    text = line(SHOWN, SHOWN_WORDS, [0.0] * len(SHOWN), 500)
    assert text.count("|") == len(SHOWN) - 5  # the twins, the page and the disk show nothing
    alarmed = line(SHOWN, SHOWN_WORDS, [1.0 if name == "twin" else 0.0 for name, *_ in SHOWN], 500)
    assert "| ALARM: not as its model |" in alarmed


def test_an_adaptive_twin_shows_its_first_parameter_and_that_of_its_alarm():
    names = [name for name, *_ in SHOWN]
    labels, words = shown_beside({"pitch_offset.offset": "deg", "sensor_gain.gain": "1"})

    def text(alarm, value, labels=labels, words=words):
        own = {"adaptive twin": alarm, "adapted": value, "thrust": 5.0}
        return line(labels, words, [own.get(name, math.nan) for name in names], 500)

    assert text(0.0, -0.25) == "thrust   5.00 N | pitch_offset.offset -0.2500 deg"
    assert text(1.0, 0.5).startswith("thrust   5.00 N | adaptive twin: most like no parameter | pitch")
    assert text(3.0, 0.5).startswith("thrust   5.00 N | adaptive twin: most like sensor_gain.gain | pitch")
    assert text(math.nan, math.nan) == "thrust   5.00 N"  # while no loop is closed
    assert text(math.nan, math.nan, SHOWN, SHOWN_WORDS) == "thrust   5.00 N"  # without an adaptive twin
    assert shown_beside({"sensor_gain.gain": "1"})[0][names.index("adapted")] == ("sensor_gain.gain", "#7.4g", "")


@pytest.fixture
def terminal():
    """Both ends of a terminal: what it shows, and what a program writes to."""
    ours, theirs = os.openpty()
    os.set_blocking(ours, False)
    yield ours, theirs
    os.close(ours)
    os.close(theirs)


def ran(terminal, labels, code):
    """Standard output of a program whose view `shown` is on the terminal."""
    text = f"import time\nfrom hil.live import view\nshown = view({labels!r}, {WORDS!r})\n{code}"
    own = {"stderr": terminal[1], "stdout": subprocess.PIPE}
    return subprocess.run([sys.executable, "-c", text], **own, check=True, timeout=30).stdout


@pytest.mark.parametrize("columns", [60, 200])
def test_the_terminals_own_width_is_used(terminal, columns):
    fcntl.ioctl(terminal[1], termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    labels = [(f"quantity {k}", "5.1f", "N") for k in range(20)]
    ran(terminal, labels, "shown.show(*[1.0] * 20); time.sleep(0.8); shown.close()")
    seen = os.read(terminal[0], 65536).decode()
    assert max(len(part) for part in seen.split("\r\x1b[K")) == columns - 1


def test_without_a_terminal_nothing_is_shown(capsys):
    assert isinstance(view(LABELS, WORDS), NoView)


def test_a_terminal_shows_the_newest_row(terminal):
    code = """
for k in range(60):
    shown.show(1.0, 0.1 * k, 1000.0 + k)
    time.sleep(0.01)
time.sleep(0.4)
shown.close()
"""
    ran(terminal, LABELS, code)
    seen = os.read(terminal[0], 65536).decode()
    assert "thrust   5.90 N | speed  1059 rpm" in seen
    assert seen.endswith("\r\x1b[K")  # the line is gone at the end


def test_a_blocked_terminal_does_not_delay_the_loop(terminal):
    code = """
began = time.monotonic()
for k in range(10000):
    shown.show(1.0, 0.1 * k, 1000.0 + k)
took = time.monotonic() - began
shown.close()
print(took)
"""
    termios.tcflow(terminal[1], termios.TCOOFF)  # Ctrl-S
    began = time.monotonic()
    assert float(ran(terminal, LABELS, code)) < 2.0
    assert time.monotonic() - began < 20.0
