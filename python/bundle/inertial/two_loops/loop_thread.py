"""A thread that does what its rings hold, and says what went wrong."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

from bundle.base.display import Displayed

__all__ = ["LoopThread", "SolveLoop"]


class LoopThread:
    """A thread that calls a function whenever something is new.

    Args:
        name: of the thread.
        work: called on the thread; what it raises ends the thread and comes out of :meth:`close`.
    """

    def __init__(self, name: str, work: Callable[[], None]) -> None:
        self._work = work
        self._news = threading.Event()
        self._stopping = False
        self._waiting: deque[threading.Event] = deque()
        self.error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def notify(self) -> None:
        """Say that there is something to do; returns at once."""
        self._news.set()

    def settle(self, timeout: float | None = None) -> bool:
        """Wait until all that was there before is done; return whether it was in time.

        Raises:
            Exception: what the work raised.
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
        """Let the thread finish what there is to do; return whether it has ended in time.

        Args:
            timeout: seconds to wait for it; None: as long as it takes.

        Raises:
            Exception: what the work raised.
        """
        self._stopping = True
        self._news.set()
        self._thread.join(timeout)
        self._raise_error()
        return not self._thread.is_alive()

    def _raise_error(self) -> None:
        if self.error is not None:
            error, self.error = self.error, None
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
        except BaseException as error:  # for whoever closes: a thread's traceback helps nobody
            self.error = error
        finally:
            while self._waiting:
                self._waiting.popleft().set()


class SolveLoop(Displayed):
    """What loops that solve have in common: a thread of their own, a count, an end."""

    _worker: LoopThread
    _num_solves = 0

    def _start(self, name: str) -> None:
        """Start the thread, once there is all that its work needs."""
        self._worker = LoopThread(name, self._work)

    def _work(self) -> None:
        """Do what there is to do, on the thread."""
        raise NotImplementedError

    @property
    def error(self) -> BaseException | None:
        """What ended the thread, if anything did."""
        return self._worker.error

    @property
    def num_solves(self) -> int:
        """Solves that have ended."""
        return self._num_solves

    def settle(self, timeout: float | None = None) -> bool:
        """Wait until all that was put before is solved; return whether it was in time.

        Args:
            timeout: seconds to wait for it; None: as long as it takes.

        Raises:
            Exception: what the solve raised.
        """
        return self._worker.settle(timeout)

    def close(self, timeout: float | None = None) -> bool:
        """Solve what waits and end the thread; return whether it has ended in time.

        Args:
            timeout: seconds to wait for it; None: as long as it takes.

        Raises:
            Exception: what the solve raised.
        """
        return self._worker.close(timeout)
