"""The fuzz study (python -m tests.studies fuzz) in short: quick verbs, and other seeds than those of the study."""

import os

import pytest
from studies import fuzz

from vpp_fmu.app.cli import VERBS

QUICK = ("compare", "import", "effects")
RUNS = 20


@pytest.fixture(scope="module")
def found():
    if not hasattr(os, "fork"):
        pytest.skip("no fork on this system")
    return list(fuzz.cases(10**6, RUNS, QUICK))


def test_no_damaged_file_ends_in_anything_but_0_or_2(found):
    assert len(found) == RUNS
    assert {case.verb for case in found} == set(QUICK)
    assert [line for line in fuzz.shown(found) if line.startswith(fuzz.FAULTS)] == []


def test_undamaged_files_are_accepted(tmp_path):
    good = fuzz.made_apart(tmp_path, QUICK)
    assert [each for each in fuzz.undamaged(QUICK, good, tmp_path) if each[1]] == []


def test_every_verb_that_takes_a_file_of_the_user_s_is_in_the_study():
    """The other verbs take no file or make their own."""
    assert set(VERBS) - set(fuzz.COMMANDS) == {"demo", "cache", "completion"}


def test_every_kind_of_fault_is_detected(tmp_path):
    """Each fault is made on purpose."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "a.json").write_text('{"x": NaN}')
    (out / ".b.csv.12.part").write_text("")
    faults = set(fuzz._faults("plan", (), 1, "Traceback (most recent call last):\nx\n", out))
    assert faults == {"exit code", "traceback", "half-written", "NaN in JSON"}
    assert set(fuzz._faults("plan", (), None, "", tmp_path / "none")) == {"over 60 s"}
    assert set(fuzz._faults("plan", (), 2, "one\ntwo\n", tmp_path / "none")) == {"not one line"}
    assert not set(fuzz._faults("diagnose", (), 2, "vpp: note: x\nvpp diagnose: quality (0 s)\none\n", tmp_path / "none"))
    assert set(fuzz._faults("plan", (), -11, "", tmp_path / "none")) == {"exit code"}
    assert not set(fuzz._faults("plan", (), 2, "vpp plan: x: found y, expected z\n", tmp_path / "none"))
