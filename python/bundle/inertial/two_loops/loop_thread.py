"""Thread that processes the content of its rings and passes its exceptions on."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

from bundle.base.display import Displayed


class LoopThread:
    """Thread that calls a function whenever there is new work.

    Args:
        name: name of the thread.
        work: function to call on the thread; its exception ends the thread and is raised by
            :meth:`close`.
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
        """Announce new work; return at once."""
        self._news.set()

    def settle(self, timeout: float | None = None) -> bool:
        """Wait until all earlier work is done; return False after a time-out.

        Raises:
            Exception: the exception that the function of the thread raised.
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
        """Let the thread finish pending work; return False after a time-out.

        Args:
            timeout: seconds to wait for it; None: without limit.

        Raises:
            Exception: the exception that the function of the thread raised.
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
        except BaseException as error:  # raised by close(): nobody reads a thread's traceback
            self.error = error
        finally:
            while self._waiting:
                self._waiting.popleft().set()


class SolveLoop(Displayed):
    """Base class of solving loops: a thread, a count of solves, and an end."""

    _worker: LoopThread
    _num_solves = 0

    def _start(self, name: str) -> None:
        """Start the thread once its work can run."""
        self._worker = LoopThread(name, self._work)

    def _work(self) -> None:
        """Do the pending work, on the thread."""
        raise NotImplementedError

    @property
    def error(self) -> BaseException | None:
        """Exception that ended the thread, if any."""
        return self._worker.error

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
        return self._worker.settle(timeout)

    def close(self, timeout: float | None = None) -> bool:
        """Solve all queued input and end the thread; return False after a time-out.

        Args:
            timeout: seconds to wait for it; None: without limit.

        Raises:
            Exception: exception of the solve.
        """
        return self._worker.close(timeout)
