"""Ctrl-C while the program is still being imported, which takes a moment.

An exception would have to pass through other people's imports, some of which turn it into one of
their own. Nothing has been read or written yet, so the process may simply end.
"""

from __future__ import annotations

import os
import signal

TYPE_CHECKING = False  # as of typing, whose import takes longer than all that is here
if TYPE_CHECKING:
    from types import FrameType

__all__ = ["begin", "done"]

EXIT_INTERRUPTED = 130


def begin() -> None:
    """Let SIGINT end the process with one line, unless it is ignored."""
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
