"""Lines of text files, whatever editor wrote them.

Byte order marks, UTF-16 and CRLF are all found in the wild.
"""

from __future__ import annotations

import codecs
import os
from pathlib import Path

from bundle.errors import InputError, shown

__all__ = ["numbered_lines"]

_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def numbered_lines(path: str | os.PathLike[str]) -> list[tuple[int, str]]:
    """Return the lines of a file with their numbers from 1.

    Raises:
        InputError: the file is no text.
        OSError: it cannot be read.
    """
    content = Path(path).read_bytes()
    try:
        text = content.decode("utf-16" if content.startswith(_UTF16) else "utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{shown(path)}: expected text in UTF-8, found other bytes") from None
    return list(enumerate(text.replace("\ufeff", "").split("\n"), 1))
