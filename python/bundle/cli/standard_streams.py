"""Standard output and standard error in any state that a shell leaves them in."""

from __future__ import annotations

import contextlib
import errno
import os
import sys


def open_missing_streams() -> None:
    """Open /dev/null in place of closed standard streams, and permit any file name in output.

    Otherwise the next opened file, such as an output, would get the descriptor of the closed
    stream. Messages of libraries to standard error would then end up in that file.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            with contextlib.suppress(OSError):
                os.open(os.devnull, os.O_RDWR)  # gets the lowest free number, that of this stream
    for descriptor, name in ((1, "stdout"), (2, "stderr")):
        if getattr(sys, name) is None:
            stream = open(descriptor, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
            setattr(sys, name, stream)
    reconfigure = getattr(sys.stdout, "reconfigure", None)
    if reconfigure is not None:
        reconfigure(errors="backslashreplace")


def print_out(text: str) -> None:
    """Print text; a closed pipe such as `| head` is not an error, a full disk is."""
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        pass
    except OSError as error:
        raise OSError(error.errno, error.strerror, "standard output") from error


def complain(text: str) -> None:
    """Print a line to standard error; a closed stream is not an error."""
    with contextlib.suppress(OSError):
        print(text, file=sys.stderr, flush=True)


def release_broken_streams() -> OSError | None:
    """Flush both streams; return the error of standard output unless its reader is gone.

    A failed stream is redirected to /dev/null. Otherwise the interpreter would flush it again at
    exit, print an error and change the exit code.
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
