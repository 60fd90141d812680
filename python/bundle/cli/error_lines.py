"""Errors that a user can cause, each as one line, and the exit codes.

===== =============================================================================================
code  meaning
===== =============================================================================================
0     done
1     no usable solution, or interrupted with something to show for it; the report is written
2     bad input or usage, or the system refused to read or write
3     undecided: `bundle check` can say nothing of some derivatives
130   interrupted (Ctrl-C) before there was anything to show
===== =============================================================================================
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from bundle.cli import startup
from bundle.errors import InputError, shown

# Messages of the dynamic loader about missing memory.
_LACKS_MEMORY = re.compile("failed to map segment|cannot allocate memory", re.IGNORECASE)

_NO_FOLDER = "the working directory is gone (removed or renamed); change to one that exists"

EXIT_DONE = 0
EXIT_NO_SOLUTION = 1
EXIT_BAD_INPUT = 2
EXIT_UNDECIDED = 3
EXIT_INTERRUPTED = startup.EXIT_INTERRUPTED


def describe_error(error: BaseException, written: Sequence[Path] = ()) -> str | None:
    """Return an error as one line; None for an error that only a bug can cause.

    The line names the paths in ``written``, which were already replaced.
    """
    paths = [shown(path) for path in dict.fromkeys(written)]
    after = f"{' and '.join(paths)} {'were' if len(paths) > 1 else 'was'} written"
    if is_interruption(error):
        return f"interrupted; {after if paths else 'nothing was written'}"
    line = _line(error)
    return f"{line}; {after}" if line is not None and paths else line


def is_interruption(error: BaseException) -> bool:
    """Return True if Ctrl-C caused an error; an import may replace it by an ImportError."""
    if isinstance(error, ImportError):
        cause = error.__cause__ or error.__context__
        return cause is not None and is_interruption(cause)
    return isinstance(error, KeyboardInterrupt)


def _line(error: BaseException) -> str | None:
    if isinstance(error, InputError):
        return _one_line(str(error))
    if isinstance(error, OSError):
        return _one_line(_os_error(error))
    if isinstance(error, MemoryError):
        return _one_line(f"not enough memory: {error}" if str(error) else "not enough memory")
    if isinstance(error, ImportError) and _LACKS_MEMORY.search(str(error)):
        return _one_line(f"not enough memory to load a library: {error}")
    return None


def _is_folder_gone() -> bool:
    try:
        Path.cwd()
    except FileNotFoundError:
        return True
    return False


def _os_error(error: OSError) -> str:
    what = error.strerror or str(error) or type(error).__name__
    if error.filename is None:
        return _NO_FOLDER if isinstance(error, FileNotFoundError) and _is_folder_gone() else what
    path = error.filename
    return f"{path.decode(errors='replace') if isinstance(path, bytes) else path}: {what}"


def _one_line(message: str) -> str:
    return shown(" ".join(message.split()))


# Standard output and standard error in any state that a shell leaves them in.


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
