"""Completion of an output on a thread: the caller computes while the disk takes the data over.

The last steps of an output (flush its files, rename it, flush the folder of the new name) wait for
the disk two or three times. In a block of :func:`completing_in_background` they run on a thread, in
the same order. The block ends, and another output in it begins, when the output before is complete.
Ctrl-C or an error in the block does not cancel an output whose data are written.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from time import perf_counter

from bundle.base.interrupts import interrupts_deferred

__all__ = ["Background", "complete", "completing_in_background", "wait_for_output"]


class Background:
    """The thread that completes an output, if any.

    Attributes:
        waited: seconds for which the caller waited for outputs.
    """

    def __init__(self) -> None:
        self.waited = 0.0
        self._thread: threading.Thread | None = None
        self._failure: BaseException | None = None

    def start(self, stack: ExitStack, rest: Callable[[], None]) -> bool:
        """Run the rest of an output, then close its contexts, on a thread; False without threads.

        The caller's stack is empty afterwards, so the contexts are closed once.

        Raises:
            OSError: the output before could not be completed.
        """
        self.wait()
        moved = ExitStack()

        def run() -> None:
            try:
                with moved:
                    rest()
            except BaseException as error:
                self._failure = error

        thread = threading.Thread(target=run)
        with interrupts_deferred():
            try:
                moved = stack.pop_all()
                thread.start()
            except RuntimeError:  # the system has no more threads
                stack.push(moved)
                return False
            self._thread = thread
        return True

    def wait(self) -> None:
        """Wait until the output is complete; raise the error with which it failed."""
        if self._thread is None:
            return
        begun = perf_counter()
        with interrupts_deferred():
            self._thread.join()
            self._thread = None
        self.waited += perf_counter() - begun
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure


_current: ContextVar[Background | None] = ContextVar("background", default=None)


@contextmanager
def completing_in_background() -> Iterator[Background]:
    """Let outputs that the block writes be completed on a thread; wait for them at its end.

    Raises:
        OSError: an output could not be completed; this takes precedence over an error of the block.
    """
    background = Background()
    token = _current.set(background)
    try:
        yield background
    finally:
        _current.reset(token)
        background.wait()


def wait_for_output() -> None:
    """Wait for the output that is being completed in the background, if any.

    Raises:
        OSError: it could not be completed.
    """
    background = _current.get()
    if background is not None:
        background.wait()


def complete(stack: ExitStack, rest: Callable[[], None]) -> None:
    """Run the rest of an output: at once, or on a thread, which then closes the contexts, too.

    Args:
        stack: contexts of the output, which must stay open until its rest is done.
        rest: last steps of the output.
    """
    background = _current.get()
    if background is None or not background.start(stack, rest):
        rest()
