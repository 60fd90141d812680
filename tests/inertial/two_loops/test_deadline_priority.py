"""A thread that comes first does so until it is done, and leaves everything as it was."""

import gc
import os
import sys
import threading

import pytest

from bundle.inertial.two_loops.loop_thread import deadline_priority

linux = pytest.mark.skipif(sys.platform != "linux", reason="schedules are Linux's")


@pytest.fixture(autouse=True)
def thawed():
    """The process of the tests is frozen after their collection (conftest.py)."""
    gc.unfreeze()


def state():
    return sys.getswitchinterval(), gc.get_freeze_count() > 0, os.sched_getscheduler(0)


@linux
@pytest.mark.parametrize("ends", ["well", "badly"])
def test_all_is_as_it_was_afterwards(ends):
    before = state()
    try:
        with deadline_priority() as first:
            assert sys.getswitchinterval() <= 1e-3
            assert gc.get_freeze_count() > 0
            schedule = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
            assert schedule == (os.SCHED_FIFO if first else before[2])
            seen = []
            thread = threading.Thread(target=lambda: seen.append(os.sched_getscheduler(0)))
            thread.start()
            thread.join()
            assert seen == [os.SCHED_OTHER]
            if ends == "badly":
                raise ZeroDivisionError
    except ZeroDivisionError:
        assert ends == "badly"
    assert state() == before


@linux
def test_without_the_right_all_else_is_done(monkeypatch):
    def refused(*_):
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refused)
    before = state()
    with deadline_priority() as first:
        assert first is False
        assert sys.getswitchinterval() <= 1e-3
    assert state() == before
