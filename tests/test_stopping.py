"""Signals end a command in order: exit code, one line, and no process or file left behind."""

import gc
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from processes import VPP, cpu_seconds, group, signalled

from identification.workers import spread
from vpp_fmu.errors import WorkerLost
from vpp_fmu.fmu import Fmu, FmuInstance
from vpp_fmu.stopping import SIGNALS, Stopped, stoppable, unbroken

has_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc to find processes in")


def told(verb, number):
    return f"{verb}: stopped by {number.name}; files that were not complete are not kept"


SPREAD = """
import sys, time
from identification.workers import spread
from vpp_fmu.app import cli
cli._run = lambda words: spread(time.sleep, [1000.0] * 8, workers=2)
sys.exit(cli.main(["identify"]))
"""


@has_proc
@pytest.mark.parametrize(("number", "to_all"), [(signal.SIGINT, True), (signal.SIGTERM, False), (signal.SIGKILL, False)])
def test_workers_end_with_the_process_that_started_them(number, to_all):
    ended = signalled([sys.executable, "-c", SPREAD], number, lambda process: len(group(process.pid)) == 4, to_all)
    assert ended.left == ()
    if number == signal.SIGKILL:  # the command itself can't react: its workers noticed
        assert ended.code == -signal.SIGKILL
    else:
        assert ended.code == 128 + number
        assert ended.error.splitlines() == [told("vpp identify", number)]


@has_proc
def test_an_unpacked_fmu_is_removed_by_the_command(fmu_files, tmp_path):
    """By the next one, if it was killed: test_outputs."""
    profile, temporary = tmp_path / "profile.csv", tmp_path / "temporary"
    profile.write_text("time,thrust_set\n0,5\n7900,5\n")
    temporary.mkdir()
    words = [*VPP, "cosim", str(fmu_files["plain"]), str(fmu_files["controller"]), "--profile", str(profile)]
    unpacked = lambda process: len(os.listdir(temporary)) == 2 and cpu_seconds(process.pid) > 2.0  # noqa: E731
    ended = signalled([*words, "-o", str(tmp_path / "out")], signal.SIGTERM, unpacked, TMPDIR=str(temporary))
    assert (ended.left, ended.code) == ((), 143)
    assert not (tmp_path / "out").exists()
    assert os.listdir(temporary) == []


HANGS = """
import ctypes, os, sys
from vpp_fmu import stopping
from vpp_fmu.scratch import Scratch
stopping.GRACE = 0.1
with stopping.stoppable("vpp test"):
    scratch, lock, libc = Scratch(), ctypes.create_string_buffer(64), ctypes.CDLL(None)
    libc.pthread_mutex_lock(lock)
    print("ready", flush=True)
    libc.pthread_mutex_lock(lock)  # never comes back, and no handler of Python's can run
"""


def test_code_that_hangs_is_ended(tmp_path):
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", HANGS], env=environment, text=True, **pipes) as process:
        assert process.stdout.readline() == "ready\n"
        assert len(os.listdir(tmp_path)) == 1
        while Path(f"/proc/{process.pid}/stat").read_text().rpartition(") ")[2][0] != "S":
            pass  # it has said so, and is on its way into the lock, where it sleeps
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate()
    assert process.returncode == 143
    assert said.splitlines() == [told("vpp test", signal.SIGTERM)]
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("number", SIGNALS, ids=str)
def test_the_first_signal_raises_and_the_next_does_nothing(number):
    before = {each: signal.getsignal(each) for each in SIGNALS}
    let_go = []

    def work():
        try:
            signal.raise_signal(number)
        finally:
            for each in SIGNALS:
                signal.raise_signal(each)
            let_go.append("all of it")

    with pytest.raises(Stopped) as stopped, stoppable("vpp test"):
        work()
    assert let_go == ["all of it"]
    assert stopped.value.code == 128 + number
    assert {each: signal.getsignal(each) for each in SIGNALS} == before


def test_a_signal_waits_for_an_unbroken_section():
    done = []

    def work():
        with unbroken():
            signal.raise_signal(signal.SIGTERM)
            done.append("whole")
        done.append("not reached")

    with pytest.raises(Stopped), stoppable("vpp test"):
        work()
    assert done == ["whole"]


def test_a_signal_within_an_fmus_own_python_is_no_error_of_its_model(fmu_files):
    fmu = Fmu(fmu_files["plain"])
    instance = FmuInstance(fmu, ["omega_ref", "beta_ref"], ["thrust"])
    instance.start([5000.0, 5.0])
    (slave,) = [o for o in gc.get_objects() if type(o).__name__ == "GeneratedSlave" and o.time == 0.0]
    take, own = instance.stepper(0.01), slave._take

    def interrupted(*arguments):
        signal.raise_signal(signal.SIGTERM)
        own(*arguments)

    slave._take = interrupted
    with pytest.raises(Stopped) as stopped, stoppable("vpp test"):
        take([6000.0, 5.0])
    assert stopped.value.code == 143
    assert slave.time == 0.01  # the step was whole
    instance.close()
    fmu.close()


def test_a_dead_worker_is_reported():
    with pytest.raises(WorkerLost, match="test: one of 2 processes has died"):
        spread(os._exit, [1, 1], workers=2, what="test")
