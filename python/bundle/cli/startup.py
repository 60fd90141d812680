"""Ctrl-C at the program's start and at its end.

While modules are imported an exception would have to pass through other people's code, some of
which turns it into one of its own. Nothing has been read or written yet, so the process may simply
end.

At the end, while the last line is printed and the interpreter is taken down, nobody is left who
could catch an exception. Python looks for signals at calls and loops only: ``is_over = True`` as
the first statement after the work, which contains no call, leaves no moment between.

The garbage collector runs less often as well: by default it runs whenever there are some hundred
or thousand new objects, and imports make many that stay.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading

TYPE_CHECKING = False  # as of typing, whose import takes longer than all that is here
if TYPE_CHECKING:
    from types import FrameType

__all__ = ["begin", "done", "ignore_interrupts", "is_over"]

EXIT_INTERRUPTED = 130

OBJECTS_BETWEEN_COLLECTIONS = 100_000

is_over = False
"""True once the work is done or given up; SIGINT is then ignored."""


def begin() -> None:
    """Let SIGINT end the process with one line, unless it is ignored; collect garbage rarely.

    Under mpirun its signals wait for the thread that looks at them.
    """
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS)
    if os.environ.get("OMPI_COMM_WORLD_SIZE", "1") != "1":
        # One thread will wait for them (bundle.solving.ranks.end_by_mpirun). Those that libraries
        # start as
        # they are imported would take them, and die.
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGCONT, signal.SIGTERM])
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)


def done() -> None:
    """Let SIGINT raise KeyboardInterrupt again, until ``is_over``."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, _interrupt)


def ignore_interrupts() -> None:
    """Ignore SIGINT until the process has ended, by an exit code also where one has come.

    ``is_over`` has to be set before.
    """
    if threading.current_thread() is threading.main_thread():
        sys.unraisablehook = _complain_of_others
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    # A KeyboardInterrupt that was caught, but had come while a string was executed (as dataclasses
    # do), makes Python end by SIGINT after all; the next such execution forgets it.
    exec("")


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    if not is_over:
        raise KeyboardInterrupt


def _complain_of_others(unraisable: sys.UnraisableHookArgs) -> None:
    """Say nothing of a signal that came just before it was ignored; Python knows no better."""
    error = unraisable.exc_value
    if not (isinstance(error, OSError) and "race condition" in str(error)):
        sys.__unraisablehook__(unraisable)


def _end(_number: int, _frame: FrameType | None) -> None:
    try:
        os.write(2, b"error: interrupted; nothing was written\n")
    finally:
        os._exit(EXIT_INTERRUPTED)
