import gc
import os

from hil.loop import realtime
from hil.loop.realtime import real_time


def locked():
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmLck"))


def test_collector_memory_and_scheduler_are_what_was_granted_and_are_restored():
    before = os.sched_getscheduler(0), gc.isenabled(), locked()
    assert before[1:] == (True, 0)
    with real_time() as granted:
        assert not gc.isenabled()
        assert granted.frozen > 1000  # an interpreter with a test runner holds many more
        assert (locked() > 0) == granted.locked
        assert (os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO) == granted.fifo
        if granted.fifo:
            assert os.sched_getparam(0).sched_priority == realtime.PRIORITY
            child = os.fork()
            if child == 0:
                os._exit(os.sched_getscheduler(0))  # what it starts must not compete with the loop
            assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == os.SCHED_OTHER
    assert (os.sched_getscheduler(0), gc.isenabled(), locked()) == before
    assert gc.get_freeze_count() == 0


def test_the_kernels_workers_of_serial_bytes_are_hurried_and_restored():
    def ordinary():
        return {w for w in realtime._workers() if os.sched_getscheduler(w) == os.SCHED_OTHER}

    before = ordinary()
    with real_time() as granted:
        assert not granted.hurried or not before & ordinary()
    assert before & set(realtime._workers()) <= ordinary()


def test_a_refusal_is_reported(monkeypatch):
    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(realtime.os, "sched_setscheduler", refuse)
    with real_time() as granted:
        assert not granted.fifo
        assert any("SCHED_FIFO" in text for text in granted.refusals)
        assert "no SCHED_FIFO" in str(granted)
        assert granted.hurried == ("serial lines not hurried" not in str(granted))
