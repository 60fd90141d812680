"""Real-time priority of a thread with deadlines, if the system allows it.

Linux runs a thread of SCHED_FIFO as soon as it wakes up. Other threads get time slices of several
milliseconds if there are more threads than processors. SCHED_FIFO requires the capability
CAP_SYS_NICE, or a limit RLIMIT_RTPRIO above 0.

Threads of one interpreter also wait for each other: long work belongs into another process. Garbage
collection over all objects of a program takes 20 ms and more, so existing objects are excluded from
it.
"""

from __future__ import annotations

import gc
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

PRIORITY = 5  # 1 is the lowest
SWITCH_INTERVAL = 1e-3  # s; Python's default is 5 ms


@contextmanager
def deadline_priority() -> Iterator[bool]:
    """Give the calling thread priority, and switch threads of the interpreter every 1 ms.

    Threads and processes that it starts meanwhile have normal priority.

    Yields:
        True if the system allowed the priority.
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
        """Return the previous schedule of the thread, None if it was not changed."""
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
