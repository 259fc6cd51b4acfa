"""FMUs and long runs, each made once a session."""

import os
import signal
import sys

import numpy as np
import pytest
from builders import ALL_ON, FAST_PITCH, PROBES, random_steps, reference

from vpp_fmu.export import python_fmu
from vpp_fmu.fmu import Fmu
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.kernel.types import Model
from vpp_fmu.native import compiler, simulator
from vpp_fmu.scratch import remove_scratch


SHARE_A_LONG_RUN = ("test_fmu", "test_native", "test_native_fmu")


def pytest_configure(config):
    """A run in the background ignores these signals, and so would every process that a test starts and stops."""
    for number in (signal.SIGINT, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)


def pytest_collection_modifyitems(items):
    """Where tests run side by side, those in real time run one after the other; the rest of a file stays together, too."""
    for item in items:
        real_time = item.path.parent.name == "hil" or item.path.stem == "test_stopping"
        group = "real time" if real_time else "long run" if item.path.stem in SHARE_A_LONG_RUN else item.path.stem
        item.add_marker(pytest.mark.xdist_group(group))


def pytest_collection_finish(session):
    """Groups that are lost let two rigs run in real time at once, whose faults tell nothing of the group."""
    if session.config.getoption("loadgroup", False) and not all("@" in item.nodeid for item in session.items):
        raise pytest.UsageError("pytest-xdist does not hand on the groups of tests: which pytest is installed? See constraints.txt")


@pytest.fixture(scope="session")
def fmu_files(tmp_path_factory):
    """Paths of FMUs: the plain plant, with every effect at its probe, the paper's control plant, the controller."""
    folder = tmp_path_factory.mktemp("fmus")
    built = {
        "plain": python_fmu(BASE),
        "all_on": python_fmu(ALL_ON, PROBES),
        "fast_pitch": python_fmu(BASE, FAST_PITCH),
        "controller": python_fmu(CONTROLLER),
    }
    paths = {name: folder / f"{name}.fmu" for name in built}
    for name, path in paths.items():
        path.write_bytes(built[name])
    return paths


@pytest.fixture(scope="session")
def fmus(fmu_files):
    """The same FMUs, unpacked."""
    unpacked = {name: Fmu(path) for name, path in fmu_files.items()}
    yield unpacked
    for fmu in unpacked.values():
        fmu.close()


@pytest.fixture(scope="session")
def long_run():
    """20 000 steps of 4 ms with every effect at its probe: (commands, step lengths, the functions' own outputs)."""
    commands, steps = random_steps(20_001, 100, seed=20_000, model=ALL_ON), np.full(20_000, 0.004)
    return commands, steps, reference(ALL_ON, PROBES, commands, steps)


@pytest.fixture
def no_compiler(monkeypatch):
    """A machine without a C compiler, on which nothing has been said about it yet."""
    caches = compiler.compiler, simulator._say_once
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(compiler.shutil, "which", lambda name: None)
    monkeypatch.setattr(Model, "memo", property(lambda model: {}))  # what was compiled before must not serve
    monkeypatch.setattr(simulator, "_runner", simulator._runner.__wrapped__)
    for cached in caches:
        cached.cache_clear()
    yield
    for cached in caches:
        cached.cache_clear()


def pytest_sessionfinish(session, exitstatus):
    """Keep the verdict for the end."""
    session.config.verdict = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config):
    """Leave without tearing the interpreter down: pythonfmu's wrapper crashes in that where many FMUs were loaded."""
    remove_scratch()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(getattr(config, "verdict", 1))
