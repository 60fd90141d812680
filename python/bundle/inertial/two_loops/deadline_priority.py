"""A thread with deadlines before all others, where the system allows it.

Linux gives a thread of SCHED_FIFO the processor as soon as it wakes up; other threads take turns of
several milliseconds where there are more of them than processors. It takes the right CAP_SYS_NICE,
or a limit RLIMIT_RTPRIO above 0.

Threads of one interpreter wait for each other besides: what works for long belongs into another
process. A collection of garbage over all objects of a program takes 20 ms and more; objects that
are there before are left out of it.
"""

from __future__ import annotations

import gc
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["deadline_priority"]

PRIORITY = 5  # 1 is the least
SWITCH_INTERVAL = 1e-3  # s; Python's own is 5 ms


@contextmanager
def deadline_priority() -> Iterator[bool]:
    """Let the calling thread come first, and threads of the interpreter take turns every 1 ms.

    Threads and processes that it starts meanwhile are as usual.

    Yields:
        Whether the system allowed the first.
    """
    interval = sys.getswitchinterval()
    sys.setswitchinterval(min(interval, SWITCH_INTERVAL))
    gc.freeze()
    before = None
    try:
        before = _scheduled_first()
        yield before is not None
    finally:
        if before is not None:
            os.sched_setscheduler(threading.get_native_id(), *before)
        gc.unfreeze()
        sys.setswitchinterval(interval)


if sys.platform == "linux":

    def _scheduled_first() -> tuple[int, os.sched_param] | None:
        """Return the schedule of the thread before, None where it stays as it is."""
        thread = threading.get_native_id()
        before = os.sched_getscheduler(thread), os.sched_getparam(thread)
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        try:
            os.sched_setscheduler(thread, policy, os.sched_param(PRIORITY))
        except OSError:
            return None
        return before

else:

    def _scheduled_first() -> None:
        return None
