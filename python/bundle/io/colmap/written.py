"""Whether files that another library wrote have arrived on the disk, and why not.

COLMAP's writers do not look whether the disk took what they wrote, and say nothing if it was full.
"""

from __future__ import annotations

import errno
import os
import re
from pathlib import Path

__all__ = ["check_text_files", "failure"]

_COUNT = re.compile(rb"# Number of \w+: (\d+)")
_LINES_PER_ENTRY = {"images.txt": 2}
_MORE = 1 << 20


def check_text_files(folder: Path) -> str | None:
    """Return which text file of a model is cut off, or None: each says how many lines it has.

    A cut at the end of a line, or within its last number, can be read without an error.
    """
    for path in sorted(folder.glob("*.txt")):
        expected, lines, last = -1, 0, b""
        with path.open("rb") as file:
            for last in file:
                if not last.startswith(b"#"):
                    lines += 1
                elif count := _COUNT.match(last):
                    expected = int(count[1]) * _LINES_PER_ENTRY.get(path.name, 1)
        if lines != expected or not last.endswith(b"\n"):
            return f"{path.name}: expected {expected} lines, found {lines}"
    return None


def failure(folder: Path, otherwise: str) -> OSError:
    """Return why files in a folder were not written whole; the folder is of no use afterwards.

    A disk that was full for somebody else is full for us: what the system answers if we make the
    files a little longer is what it answered then.
    """
    try:
        for path in [*sorted(folder.iterdir()), folder / "one more"]:
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
            try:
                remaining = _MORE
                while remaining:
                    remaining -= os.write(descriptor, bytes(remaining))
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
    except OSError as error:
        return OSError(error.errno, error.strerror, os.fspath(folder))
    return OSError(errno.EIO, otherwise, os.fspath(folder))
