"""Handling of Ctrl-C at the start and at the end of the program.

During imports, an exception would pass through code of other packages, which may convert it into
another exception. At that time nothing has been read or written, so the process simply exits.

At the end, while the last line is printed and the interpreter exits, no code can catch an
exception. Python checks for signals only at calls and loops. The first statement after the work is
``is_over = True``, which contains no call, so no signal can arrive before it.

The garbage collector also runs less often. By default it runs after some hundred or thousand new
objects, and imports create many permanent objects.

At the end, the interpreter would free every object, which takes longer than to read a small model.
The process exits after the last exit function instead; the system frees its memory.
"""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
import threading

TYPE_CHECKING = False  # as in typing, but without its slow import
if TYPE_CHECKING:
    from types import FrameType

EXIT_INTERRUPTED = 130

OBJECTS_BETWEEN_COLLECTIONS = 100_000

is_over = False
"""True once the work has ended or was abandoned; SIGINT is then ignored."""

exit_code: int | None = None
"""Code of a process that has nothing left to do; None: the interpreter ends as usual."""


def begin() -> None:
    """Make SIGINT end the process with one line, unless it is ignored; reduce garbage collection.

    Under mpirun, signals wait for the thread that handles them.
    """
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS)
    if atexit._ncallbacks() == 0:  # otherwise others, such as profilers, would run after it
        atexit.register(_exit)
    if os.environ.get("OMPI_COMM_WORLD_SIZE", "1") != "1":
        # One thread will wait for the signals (bundle.solving.ranks.launch). Without a
        # block, threads that libraries start during imports would receive them and end the
        # process.
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGCONT, signal.SIGTERM])
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)


def done() -> None:
    """Restore KeyboardInterrupt as the effect of SIGINT; it ends when ``is_over`` is set."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, _interrupt)


def ignore_interrupts() -> None:
    """Ignore SIGINT until the process exits, and exit by code even if a SIGINT has arrived.

    ``is_over`` must be set before.
    """
    if threading.current_thread() is threading.main_thread():
        sys.unraisablehook = _complain_of_others
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    # If a KeyboardInterrupt arrives while a string is executed (as in dataclasses), Python exits by
    # SIGINT even if the exception was caught. The next execution of a string resets this.
    exec("")


def _exit() -> None:
    """End the process; the last exit function, because it was registered first."""
    if exit_code is None:
        return
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except (OSError, ValueError):
        return  # the interpreter complains
    os._exit(exit_code)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    if not is_over:
        raise KeyboardInterrupt


def _complain_of_others(unraisable: sys.UnraisableHookArgs) -> None:
    """Hide the message about a signal that arrived just before signals were ignored."""
    error = unraisable.exc_value
    if not (isinstance(error, OSError) and "race condition" in str(error)):
        sys.__unraisablehook__(unraisable)


def _end(_number: int, _frame: FrameType | None) -> None:
    try:
        os.write(2, b"error: interrupted; nothing was written\n")
    finally:
        os._exit(EXIT_INTERRUPTED)
