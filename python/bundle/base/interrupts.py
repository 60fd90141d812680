"""Deferral of Ctrl-C during short critical blocks.

Three kinds of blocks must not be interrupted:

* renames of files that belong together: the folder would contain a mixture of two models;
* the import of pycolmap, which fails after an interruption;
* the start of a process with its files: what an interrupted constructor opened stays open.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def interrupts_deferred() -> Iterator[None]:
    """Defer SIGINT until the block has ended; an exception of the block takes precedence.

    Use this only for blocks that take milliseconds. In threads other than the main thread it has no
    effect, because Python runs signal handlers in the main thread. A handler that is not a function
    (SIG_IGN, SIG_DFL) stays.

    Example:
        >>> with interrupts_deferred():
        ...     old.rename(backup)
        ...     new.rename(old)
    """
    handler = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(handler):
        yield
        return
    arrived: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda number, frame: arrived.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
    if arrived:
        handler(*arrived[0])
