"""Thread that processes the content of its bounded queues, in real time if possible."""

from __future__ import annotations

import gc
import os
import sys
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

from bundle.base.display import Displayed
from bundle.interface.option_fields import number


class SolveLoop(Displayed):
    """Base class of solving loops: a thread that calls ``_work`` whenever there is new work."""

    _num_solves = 0

    def _start(self, name: str) -> None:
        self._news = threading.Event()
        self._stopping = False
        self._waiting: deque[threading.Event] = deque()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def _work(self) -> None:
        raise NotImplementedError

    @property
    def error(self) -> BaseException | None:
        """Exception that ended the thread, if any."""
        return self._error

    @property
    def num_solves(self) -> int:
        """Number of finished solves."""
        return self._num_solves

    def settle(self, timeout: float | None = None) -> bool:
        """Wait until everything queued before is solved; return False after a time-out.

        Args:
            timeout: seconds to wait for it; None: without limit.

        Raises:
            Exception: exception of the solve.
        """
        done = threading.Event()
        self._waiting.append(done)
        self._news.set()
        if not self._thread.is_alive():
            done.set()
        in_time = done.wait(timeout)
        self._raise_error()
        return in_time

    def close(self, timeout: float | None = None) -> bool:
        """Solve all queued input and end the thread; return False after a time-out.

        Args:
            timeout: seconds to wait for it; None: without limit.

        Raises:
            Exception: exception of the solve.
        """
        self._stopping = True
        self._news.set()
        self._thread.join(timeout)
        self._raise_error()
        return not self._thread.is_alive()

    def _raise_error(self) -> None:
        if self._error is not None:
            error, self._error = self._error, None
            raise error

    def _run(self) -> None:
        try:
            while True:
                self._news.wait()
                self._news.clear()
                last = self._stopping
                waiting = len(self._waiting)
                self._work()
                for _ in range(waiting):
                    self._waiting.popleft().set()
                if last:
                    return
        except BaseException as error:  # raised by close(): nobody reads a thread's traceback
            self._error = error
        finally:
            while self._waiting:
                self._waiting.popleft().set()


Record = TypeVar("Record")


class Ring(Generic[Record]):
    """Queue of the newest records of one thread for another.

    A full ring discards its oldest record.

    One thread puts, one takes. Both use single operations of ``collections.deque``, which the
    interpreter does not interrupt. No lock can therefore delay a thread with a deadline.

    Args:
        capacity: largest number of records.

    Raises:
        InputError: capacity is not a whole number above 0.
    """

    def __init__(self, capacity: int = 64) -> None:
        size = number("Ring: capacity", capacity, whole=True, minimum=1)
        self._records: deque[tuple[int, Record]] = deque(maxlen=size)
        self._put = 0
        self._last_taken = 0
        self._lost = 0

    def __len__(self) -> int:
        return len(self._records)

    @property
    def num_lost(self) -> int:
        """Number of records discarded before they were taken, as known at the last take."""
        return self._lost

    def put(self, record: Record) -> None:
        """Append a record."""
        self._put += 1
        self._records.append((self._put, record))

    def take_all(self) -> list[Record]:
        """Return and remove the records, oldest first."""
        taken: list[Record] = []
        while True:
            try:
                place, record = self._records.popleft()
            except IndexError:
                return taken
            self._lost += place - self._last_taken - 1
            self._last_taken = place
            taken.append(record)

    def take_newest(self) -> Record | None:
        """Return the newest record and discard the others; None if the ring is empty."""
        taken = self.take_all()
        return taken[-1] if taken else None


# Real-time priority of a thread with deadlines, if the system allows it.
#
# Linux runs a thread of SCHED_FIFO as soon as it wakes up. Other threads get time slices of several
# milliseconds if there are more threads than processors. SCHED_FIFO requires the capability
# CAP_SYS_NICE, or a limit RLIMIT_RTPRIO above 0.
#
# Threads of one interpreter also wait for each other: long work belongs into another process.
# Garbage collection over all objects of a program takes 20 ms and more, so existing objects are
# excluded from it.

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
