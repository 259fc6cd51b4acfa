"""Each verb works with standard streams that are closed, full or not UTF-8, and with folder names that are not UTF-8."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from vpp_fmu.app.cli import main

ROOT = str(Path(__file__).parents[1])
ASCII = {"PYTHONIOENCODING": "ascii"}
C_LOCALE = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
NAME = b"caf\xe9 \xe2\x86\x92"
"""A folder name with a byte that is no UTF-8, and an arrow that is."""

PARAMETERS = {"format": "vpp-parameters/1", "parameters": {}, "effects": [], "source": {"campaign": "Fläche → Süd"}}


@pytest.fixture
def here(tmp_path):
    """A folder with that name, with a record and parameters; its path in bytes."""
    place = os.fsencode(tmp_path) + b"/" + NAME
    os.mkdir(place)
    for name, text in (
        (b"record.csv", "time,omega_ref,beta_ref,thrust\n0,4000,5,5\n0.004,4000,5,5.1\n0.008,4100,5,5.2\n"),
        (b"p.json", json.dumps(PARAMETERS)),
    ):
        with open(place + b"/" + name, "w", encoding="utf-8") as file:
            file.write(text)
    return place


def run(words, redirected="", **environment):
    """`vpp` in a shell, which can close streams: (exit code, bytes on standard output, on standard error)."""
    quoted = [word if isinstance(word, bytes) else os.fsencode(word) for word in words]
    command = [b"sh", b"-c", b'exec "$0" -m vpp_fmu "$@" ' + redirected.encode(), os.fsencode(sys.executable), *quoted]
    done = subprocess.run(command, check=False, capture_output=True, env=os.environ | {"PYTHONPATH": ROOT} | environment)
    assert b"Traceback" not in done.stderr
    assert b"Error" not in done.stderr
    return done.returncode, done.stdout, done.stderr


def simulate(here, *more):
    return ["simulate", here + b"/record.csv", "--parameters", here + b"/p.json", "-o", here + b"/out", *more]


@pytest.mark.parametrize(("environment", "redirected"), [(C_LOCALE, ""), (ASCII, "<&- >&- 2>&-")])
def test_streams_that_are_closed_or_not_utf_8_are_no_errors(environment, redirected, here):
    code, out, said = run(simulate(here), redirected, **environment)
    assert (code, said) == (0, b"")
    assert (b"written to" in out) == (not redirected)
    assert os.path.getsize(here + b"/out/prediction.csv") > 0


def test_characters_that_a_terminal_cannot_show_are_replaced(here):
    """The campaign's name has arrows and umlauts."""
    code, out, said = run(["simulate", here + "/none →.csv".encode(), "--parameters", here + b"/p.json"], **ASCII)
    (out + said).decode("ascii")
    assert (code, said.count(b"\n")) == (2, 1)
    assert b"?" in said


def test_a_full_standard_output_is_reported_after_the_results_are_written(here):
    code, _, said = run(simulate(here), ">/dev/full")
    assert code == 2
    assert said.count(b"\n") == 1
    assert b"no space left" in said
    assert os.path.getsize(here + b"/out/prediction.csv") > 0


def test_results_are_written_before_anything_is_printed(here, monkeypatch, tmp_path):
    """A standard output that fails at the first character."""

    class Broken:
        def write(self, text):
            raise BrokenPipeError

        def flush(self):
            pass

        def fileno(self):
            return os.open(os.devnull, os.O_WRONLY)

    monkeypatch.setattr(sys, "stdout", Broken())
    assert main([os.fsdecode(word) for word in simulate(here)]) == 141
    assert os.path.getsize(here + b"/out/prediction.csv") > 0
