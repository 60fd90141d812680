"""A thread that does what its rings hold, and says what went wrong."""

from __future__ import annotations

import threading
from collections.abc import Callable

__all__ = ["LoopThread"]


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
        self.error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def notify(self) -> None:
        """Say that there is something to do; returns at once."""
        self._news.set()

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
        if self.error is not None:
            error, self.error = self.error, None
            raise error
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            while True:
                self._news.wait()
                self._news.clear()
                last = self._stopping
                self._work()
                if last:
                    return
        except BaseException as error:  # for whoever closes: a thread's traceback helps nobody
            self.error = error
