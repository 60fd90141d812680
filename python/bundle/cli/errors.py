"""Errors that a user can cause, each in one line."""

from __future__ import annotations

import re

from bundle.errors import InputError, shown

__all__ = ["EXIT_BAD_INPUT", "EXIT_DONE", "EXIT_NO_SOLUTION", "describe_error"]

# How the dynamic loader says so.
_LACKS_MEMORY = re.compile("failed to map segment|cannot allocate memory", re.IGNORECASE)

EXIT_DONE = 0
EXIT_NO_SOLUTION = 1
EXIT_BAD_INPUT = 2


def describe_error(error: BaseException) -> str | None:
    """Return an error in one line, or None for one that only a bug can cause."""
    if isinstance(error, InputError):
        return _one_line(str(error))
    if isinstance(error, OSError):
        return _one_line(_os_error(error))
    if isinstance(error, MemoryError):
        return _one_line(f"not enough memory: {error}" if str(error) else "not enough memory")
    if isinstance(error, ImportError) and _LACKS_MEMORY.search(str(error)):
        return _one_line(f"not enough memory to load a library: {error}")
    if isinstance(error, KeyboardInterrupt):
        return "interrupted; nothing was written"
    return None


def _os_error(error: OSError) -> str:
    what = error.strerror or str(error) or type(error).__name__
    if error.filename is None:
        return what
    path = error.filename
    return f"{path.decode(errors='replace') if isinstance(path, bytes) else path}: {what}"


def _one_line(message: str) -> str:
    return shown(" ".join(message.split()))
