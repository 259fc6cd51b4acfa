"""FMUs and long runs that are made once in a session; which tests share a worker; which parameters are sampled."""

import functools
import os
import random
import signal
import sys
import time
from weakref import WeakKeyDictionary

# Tests run side by side: a second thread of BLAS would wait for the other process, and burn its core meanwhile.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pytest
from builders import ALL_ON, FAST_PITCH, PROBES, SHORT_CAMPAIGN, random_steps, reference, shorten_tuning

from tests.hil.quick_vpp import shorten_waits
from tests.stalls import Stalls
from tests.studies.cases import draw
from tests.studies.rig import save
from vpp_fmu.app.cli import main
from vpp_fmu.export import native_flavour, python_fmu
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.kernel.types import Model
from vpp_fmu.native import compiler, simulator
from vpp_fmu.scratch import remove_scratch

SHARED = (*("test_fmu", "test_native", "test_native_fmu", "test_fmi_calls", "test_fmi3", "test_loop"),)
"""Files of one group: they share a long run and native FMUs."""

LONGEST_FIRST = (
    *("real time", "long run", "test_diagnose", "test_answers", "test_readme", "test_api", "test_blind_study"),
    *("test_day", "test_own_rig", "test_check", "test_learned", "test_rounding", "test_hil_campaign"),
    "test_learned_terms",
)
"""Groups that take longest. They start first, so that none of them is still running when all others are done."""

IN_VIRTUAL_TIME = (
    *("test_day", "test_hil_campaign", "test_physics", "test_physics_fmu", "test_physics_hidden", "test_physics_speed"),
    *("test_plausibility", "test_polarity"),
)
"""Files of the rig whose clock is simulated."""

SHARE = 1.0 / 3.0
"""Share of the values of a `sampled` parameter that run with several workers. Without workers all values run."""


def pytest_configure(config):
    """Restore signals that a background run ignores: every process that a test starts would ignore them, too."""
    for number in (signal.SIGINT, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
    config.option.loadscopereorder = False  # pytest-xdist would begin with the groups that have most tests
    config.addinivalue_line("markers", "sampled(name): side by side, a third of this parameter's values is drawn at random")


def in_real_time(item):
    """Whether a test runs in real time, so that no other one of its kind may run beside it."""
    stem = item.path.stem
    return stem == "test_stopping" or (item.path.parent.name == "hil" and stem not in IN_VIRTUAL_TIME)


def is_drawn(item):
    """Whether this run's sample of a `sampled` parameter, the same in each worker, includes the item's value."""
    mark, run = item.get_closest_marker("sampled"), os.environ.get("PYTEST_XDIST_TESTRUNUID")
    if not mark or not run:
        return True
    value = item.callspec.params[mark.args[0]]
    return random.Random(f"{run} {getattr(value, 'name', value)}").random() < SHARE


STALLS = pytest.StashKey[Stalls]()
BEGUN = pytest.StashKey[float]()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Watch the machine for stalls from here on."""
    if in_real_time(item):
        stash = item.config.stash
        if STALLS not in stash:
            stash[STALLS] = Stalls()
            item.config.add_cleanup(stash[STALLS].close)
        item.stash[BEGUN] = time.monotonic()
        item.parent.stash.setdefault(BEGUN, item.stash[BEGUN])


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Count a failure in real time as skipped if the machine stalled during the test."""
    report = yield
    if report.failed and in_real_time(item):
        # A failed fixture of the whole file fails each later test, too: stalls since the file began count.
        begun = (item.parent if report.when == "setup" else item).stash[BEGUN]
        if stood := item.config.stash[STALLS].longest(since=begun):
            report.outcome = "skipped"
            report.longrepr = (
                str(item.path),
                item.reportinfo()[1],
                f"Skipped: {item.name} failed, and a core stood still for {1e3 * stood:.0f} ms",
            )
    return report


@pytest.hookimpl(tryfirst=True)  # before pytest-xdist reads the groups
def pytest_collection_modifyitems(items):
    """With several workers, tests in real time run one after the other, and the other tests of a file share a worker."""
    groups = {}
    for item in filter(is_drawn, items):
        group = "real time" if in_real_time(item) else "long run" if item.path.stem in SHARED else item.path.stem
        item.add_marker(pytest.mark.xdist_group(group))
        groups.setdefault(group, []).append(item)
    order = [*(group for group in LONGEST_FIRST if group in groups), *groups]
    items[:] = [item for group in dict.fromkeys(order) for item in groups[group]]


@pytest.fixture(scope="session", autouse=True)
def compiled_once():
    """Compile a native FMU's source for this machine once in a session: the same text gives the same library."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native_flavour, "binaries", functools.cache(native_flavour.binaries))
        yield


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
def long_run():
    """700 steps of 4 ms with every effect at its probe: (commands, step lengths, outputs of the functions in Python)."""
    commands, steps = random_steps(701, 100, seed=10_000, model=ALL_ON), np.full(700, 0.004)
    return commands, steps, reference(ALL_ON, PROBES, commands, steps)


@pytest.fixture(scope="session")
def short_campaign(tmp_path_factory):
    """Folder of a campaign of an emulated rig with a dead band of its pitch servo: every file, 20 s at 100 Hz."""
    case = draw(11, "single", hidden=("pitch_command_deadband",), **SHORT_CAMPAIGN)
    save(case.measured(), case.rig.size, folder := tmp_path_factory.mktemp("campaigns") / "2026-03-01")
    return folder


@pytest.fixture(scope="module")
def short_waits():
    """Runs on the emulated rig wait less before they begin, in a whole file."""
    with pytest.MonkeyPatch.context() as patch:
        shorten_waits(patch.setattr)
        yield


@pytest.fixture
def short_search(monkeypatch):
    """One search per controller, in one round."""
    shorten_tuning(monkeypatch.setattr)


def words_of(request, words) -> list[str]:
    """The words of a call of `vpp`, after the FIRST_WORDS of the test's file, if it has some."""
    return [*map(str, (*getattr(request.module, "FIRST_WORDS", ()), *words))]


@pytest.fixture
def printed(capsys, request):
    """Run `vpp`, which must succeed, and return its standard output."""

    def run(*words):
        capsys.readouterr()
        assert main(words_of(request, words)) == 0
        return capsys.readouterr().out

    return run


@pytest.fixture
def refused(capsys, request):
    """Run `vpp`, which must end with exit code 2 and one line on standard error, and return that line."""

    def run(*words):
        capsys.readouterr()
        assert main(words_of(request, words)) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        return said

    return run


@pytest.fixture
def no_compiler(monkeypatch):
    """A machine without a C compiler, before the first warning of it."""
    caches = compiler.compiler, simulator._say_once
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(compiler.shutil, "which", lambda name: None)
    monkeypatch.setattr(Model, "memo", property(lambda model: {}))  # models compiled before must not be used
    monkeypatch.setattr(simulator, "_runner", simulator._runner.__wrapped__)
    monkeypatch.setattr(simulator, "_any_runner", WeakKeyDictionary())
    monkeypatch.setattr(native_flavour, "binaries", native_flavour.binaries.__wrapped__)
    for cached in caches:
        cached.cache_clear()
    yield
    for cached in caches:
        cached.cache_clear()


def pytest_terminal_summary(terminalreporter):
    """Print in one line which tests were not run, and why."""
    reasons = {report.longrepr[2].removeprefix("Skipped: ") for report in terminalreporter.stats.get("skipped", ())}
    drawn = [
        "two thirds of the effects, rigs, faults and logs in tests of each (a file that runs alone tries all)",
        "slow tests (make study)",
    ]
    side_by_side = bool(terminalreporter.config.getoption("numprocesses", None))
    terminalreporter.write_line(f"not run: {'; '.join([*sorted(reasons), *drawn * side_by_side]) or 'nothing'}")


def pytest_sessionfinish(session, exitstatus):
    """Keep the exit code for the end."""
    session.config.verdict = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config):
    """Exit without finalising the interpreter: pythonfmu's wrapper crashes in that after many FMUs were loaded."""
    remove_scratch()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(getattr(config, "verdict", 1))
