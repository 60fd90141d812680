"""Ctrl-C while the program is still being imported, which takes a moment.

An exception would have to pass through other people's imports, some of which turn it into one of
their own. Nothing has been read or written yet, so the process may simply end.

The garbage collector runs less often as well: by default it runs whenever there are some hundred
or thousand new objects, and imports make many that stay.
"""

from __future__ import annotations

import gc
import os
import signal

TYPE_CHECKING = False  # as of typing, whose import takes longer than all that is here
if TYPE_CHECKING:
    from types import FrameType

__all__ = ["begin", "done"]

EXIT_INTERRUPTED = 130

OBJECTS_BETWEEN_COLLECTIONS = 100_000


def begin() -> None:
    """Let SIGINT end the process with one line, unless it is ignored; collect garbage rarely.

    Under mpirun its signals wait for the thread that looks at them.
    """
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS)
    if os.environ.get("OMPI_COMM_WORLD_SIZE", "1") != "1":
        # One thread will wait for them (bundle.ranks.end_by_mpirun). Those that libraries start as
        # they are imported would take them, and die.
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGCONT, signal.SIGTERM])
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)


def done() -> None:
    """Let SIGINT raise KeyboardInterrupt again."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(_number: int, _frame: FrameType | None) -> None:
    try:
        os.write(2, b"error: interrupted; nothing was written\n")
    finally:
        os._exit(EXIT_INTERRUPTED)
