import csv
import gzip
import math
import os
import resource
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from hil.loop.log import Column, Logged, MemoryLog, ProcessLog, Reader, events_of, largest, read_events

COLUMNS = (Column("time"), Column("exact", exact=True), Column("short"), Column("state", words=("safe", "run")))
ROWS = [(0.004 * k, math.pi / (k + 1), math.e * k if k % 3 else math.nan, float(k % 2)) for k in range(5000)]


def read(path):
    with gzip.open(path, "rt") if path.suffix == ".gz" else open(path) as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("log", [MemoryLog, ProcessLog])
@pytest.mark.parametrize("name", ["run.csv", "run.csv.gz"])
def test_every_row_is_in_the_file(tmp_path, log, name):
    made = log(tmp_path / name, COLUMNS)
    for row in ROWS:
        made.put(*row)
    assert made.close() == Logged(len(ROWS), 0)
    cells = read(tmp_path / name)
    assert len(cells) == len(ROWS)
    assert [float(c["time"]) for c in cells] == [round(0.004 * k, 9) for k in range(5000)]
    assert [float(c["exact"]) for c in cells] == [row[1] for row in ROWS]  # to the bit
    assert [c["short"] for c in cells[:3]] == ["", "2.71828183", "5.43656366"]
    assert [c["state"] for c in cells[:2]] == ["safe", "run"]
    assert os.listdir(tmp_path) == [name]


def test_a_second_reader_gets_every_row_but_the_newest(tmp_path):
    log = ProcessLog(tmp_path / "run.csv", COLUMNS)
    reader = Reader(log.shared, log.slots, len(COLUMNS))
    found = []
    for k, row in enumerate(ROWS):
        log.put(*row)
        if k % 700 == 0:
            found += reader.rows()
            assert len(found) == k  # the newest may still be being written
    while rows := reader.rows():
        found += rows
    assert [row[:2] for row in found] == [row[:2] for row in ROWS[:-1]]
    reader.close()
    log.close()


def test_a_row_that_finds_no_room_is_counted_and_the_loop_does_not_wait(tmp_path):
    log = ProcessLog(tmp_path / "run.csv", COLUMNS)
    os.kill(log._writer.pid, signal.SIGSTOP)
    began = time.monotonic()
    for k in range(80_000):
        log.put(float(k), 0.0, 0.0, 0.0)
    assert time.monotonic() - began < 5.0
    os.kill(log._writer.pid, signal.SIGCONT)
    done = log.close()
    assert done.lost >= 80_000 - log.slots
    assert done.rows + done.lost == 80_000
    times = np.array([float(c["time"]) for c in read(tmp_path / "run.csv")])
    assert len(times) == done.rows
    assert (np.diff(times) == 1.0).all()  # the newest rows are lost, the older ones are intact


def test_events_and_rows_on_one_pipe_do_not_disturb_each_other(tmp_path):
    log, noted = ProcessLog(tmp_path / "run.csv", COLUMNS), []
    for k, row in enumerate(ROWS):
        log.put(*row)
        if k % 10 == 0:  # in all, ten times what the writer reads at once
            noted.append({"time": row[0], "why": "x" * (k % 70)})
            log.note(noted[-1])
    assert log.close() == Logged(len(ROWS), 0)
    assert [float(c["exact"]) for c in read(tmp_path / "run.csv")] == [row[1] for row in ROWS]
    assert read_events(events_of(tmp_path / "run.csv")) == noted


def test_a_killed_loop_leaves_a_complete_log(tmp_path):
    text = f"""
import os, signal
from hil.loop.log import Column, ProcessLog
log = ProcessLog({str(tmp_path / "run.csv")!r}, [Column("time"), Column("value")])
for k in range(1000):
    log.put(0.004 * k, k)
os.kill(os.getpid(), signal.SIGKILL)
"""
    assert subprocess.run([sys.executable, "-c", text], check=False).returncode == -signal.SIGKILL
    deadline = time.monotonic() + 20.0
    while not (tmp_path / "run.csv").exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert [float(c["value"]) for c in read(tmp_path / "run.csv")] == list(range(1000))


def test_a_full_disk_loses_rows_and_is_reported_but_stops_nothing(tmp_path):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20000, before[1]))
    try:
        log = MemoryLog(tmp_path / "run.csv", [Column("time"), Column("value")])
        for k in range(5000):
            log.put(0.004 * k, k)
        done = log.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert done.rows + done.lost == 5000
    assert done.lost > 0
    assert "too large" in done.failure  # the system's message for a file at its limit
    assert [float(c["value"]) for c in read(tmp_path / "run.csv")] == list(range(done.rows))  # whole lines only


def test_a_row_that_waits_for_the_disk_for_more_than_a_second_breaks_the_log(tmp_path, monkeypatch):
    monkeypatch.setattr("hil.loop.log._HANGS", 0.2)
    log = ProcessLog(tmp_path / "run.csv", COLUMNS)
    os.kill(log.writer, signal.SIGSTOP)
    for k in range(300):
        log.put(0.004 * k, 0.0, 0.0, 0.0)
        assert bool(log.broken) == (0.004 * k > 1.0), (k, log.broken)
    assert f"process {log.writer} does not write" in log.broken
    done = log.close()  # a writer that hangs does not hold it
    assert (done.rows, done.lost) == (0, 300)
    assert done.failure


def test_a_full_disk_is_named_by_the_log_and_rows_that_found_room_again_are_kept(tmp_path):
    log = ProcessLog(tmp_path / "run.csv", COLUMNS)
    before = resource.prlimit(log.writer, resource.RLIMIT_FSIZE, (10_000, resource.RLIM_INFINITY))
    deadline, k = time.monotonic() + 20.0, 0
    while not log.broken and time.monotonic() < deadline:
        log.put(0.004 * k, *ROWS[k][1:])
        k += 1
        time.sleep(0.0005)  # the writer takes rows meanwhile
    assert "file too large: found rows that wait" in log.broken
    resource.prlimit(log.writer, resource.RLIMIT_FSIZE, before)
    assert log.close().lost == 0
    assert len(read(tmp_path / "run.csv")) == k


def test_a_writer_that_died_is_reported(tmp_path):
    log = ProcessLog(tmp_path / "run.csv", COLUMNS)
    log._writer.kill()
    log._writer.wait()
    for row in ROWS:
        log.put(*row)
    done = log.close()
    assert done.rows == 0
    assert done.lost == len(ROWS)
    assert "died" in done.failure


def test_no_log_is_larger_than_its_bound(tmp_path):
    """Digits as random as they can be, in every kind of column."""
    rng = np.random.default_rng(0)
    for name in ("run.csv", "run.csv.gz"):
        log = MemoryLog(tmp_path / name, COLUMNS)
        for k in range(20_000):
            log.put(0.004 * k, *(-rng.standard_normal(2) * 10.0 ** rng.integers(-9, 9)), 1.0)
        log.close()
        bound = largest(tmp_path / name, COLUMNS, 20_000)
        assert 0.5 * bound < (tmp_path / name).stat().st_size <= bound
