"""Standard output and standard error, whatever the shell has made of them."""

from __future__ import annotations

import contextlib
import errno
import os
import sys

__all__ = ["complain", "open_missing_streams", "print_out", "release_broken_streams"]


def open_missing_streams() -> None:
    """Put /dev/null where a standard stream is closed, and let any file name be printed.

    Else the next file that is opened, such as an output, would get the number of the closed stream,
    and whatever a library says on standard error would end up in it.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            with contextlib.suppress(OSError):
                os.open(os.devnull, os.O_RDWR)  # takes the lowest free number, which is this one
    for descriptor, name in ((1, "stdout"), (2, "stderr")):
        if getattr(sys, name) is None:
            stream = open(descriptor, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
            setattr(sys, name, stream)
    reconfigure = getattr(sys.stdout, "reconfigure", None)
    if reconfigure is not None:
        reconfigure(errors="backslashreplace")


def print_out(text: str) -> None:
    """Print as long as somebody reads: `| head` is no failure of the work that was done.

    Raises:
        OSError: the text did not arrive for another reason, such as a full disk.
    """
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        pass
    except OSError as error:
        raise OSError(error.errno, error.strerror, "standard output") from error


def complain(text: str) -> None:
    """Print a line on standard error; a closed stream is no error."""
    with contextlib.suppress(OSError):
        print(text, file=sys.stderr, flush=True)


def release_broken_streams() -> OSError | None:
    """Flush both streams; return what standard output did not take, if somebody was reading.

    A stream that fails is pointed at /dev/null: the interpreter flushes once more at its exit and
    would turn that into a complaint and an exit code of its own.
    """
    lost = None
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError as error:
            if stream is sys.stdout and error.errno != errno.EPIPE:
                lost = OSError(error.errno, error.strerror, "standard output")
            with contextlib.suppress(OSError):
                null = os.open(os.devnull, os.O_WRONLY)
                os.dup2(null, stream.fileno())
                os.close(null)
    return lost
