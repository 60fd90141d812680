"""Numbers at the beginning of a text file: counts and cameras, before the points."""

from __future__ import annotations

import bz2
import gzip
import math
import re
from codecs import BOM_UTF8
from pathlib import Path
from typing import BinaryIO, NoReturn, cast

from bundle.errors import InputError, brief, shown

_BLOCK = 1 << 16
_NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_TOKEN = re.compile(rb"\S+")
MOST_IMAGES = 10**7


def open_binary(path: Path) -> BinaryIO:
    """Open a file for reading; gzip and bzip2 are decompressed, a byte order mark is skipped."""
    with path.open("rb") as file:
        start = file.read(3)
    if start.startswith(b"\x1f\x8b"):
        return cast(BinaryIO, gzip.open(path, "rb"))
    if start == b"BZh":
        return cast(BinaryIO, bz2.open(path, "rb"))
    file = path.open("rb")
    file.seek(len(BOM_UTF8) if start == BOM_UTF8 else 0)
    return file


class Head:
    """The beginning of a file, read token by token.

    Attributes:
        position: bytes before the next token.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.position = 0
        self._file = open_binary(path)
        self._text = b""
        self._at_end = False

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def num_lines(self) -> int:
        """Number of line ends before the position."""
        return self._text.count(b"\n", 0, self.position)

    def line(self) -> bytes:
        """Return the rest of the current line and move after it."""
        while (end := self._text.find(b"\n", self.position)) < 0 and self._more():
            pass
        end = len(self._text) if end < 0 else end + 1
        line = self._text[self.position : end]
        self.position = end
        return line.strip()

    def next_line(self, what: str) -> bytes:
        """Return the next line that is not blank.

        Raises:
            InputError: the file ends.
        """
        while True:
            line = self.line()
            if line:
                return line
            if self._at_end and self.position == len(self._text):
                self.fail(what, "the end of the file")

    def token(self, what: str) -> bytes:
        """Return the next token.

        Raises:
            InputError: the file ends.
        """
        while True:
            found = _TOKEN.search(self._text, self.position)
            if found is not None and (found.end() < len(self._text) or self._at_end):
                self.position = found.end()
                return found[0]
            if not self._more() and found is None:
                self.fail(what, "the end of the file")

    def number(self, what: str) -> float:
        """Return the next token as a finite number.

        Raises:
            InputError: it is not a finite number.
        """
        token = self.token(what)
        value = number_of(token)
        if value is None:
            self.fail(f"{what} (a finite number)", brief(token.decode(errors="replace")))
        return value

    def count(self, what: str, most: int = MOST_IMAGES) -> int:
        """Return the next token as a count.

        Raises:
            InputError: it is not a whole number from 0 to ``most``.
        """
        token = self.token(what)
        if not token.isdigit() or len(token) > 18 or int(token) > most:
            found = brief(token.decode(errors="replace"))
            self.fail(f"{what} (a whole number from 0 to {most})", found)
        return int(token)

    def fail(self, expected: str, found: str) -> NoReturn:
        """Raise an InputError with file and line."""
        line = self._text.count(b"\n", 0, max(self.position - 1, 0)) + 1
        raise InputError(f"{shown(self.path)}:{line}: expected {expected}, found {found}")

    def _more(self) -> bool:
        try:
            block = self._file.read(max(_BLOCK, len(self._text)))
        except (EOFError, OSError) as error:
            if isinstance(error, OSError) and error.errno is not None:
                raise
            raise InputError(f"{shown(self.path)}: expected complete data, found {error}") from None
        self._text += block
        self._at_end = not block
        return bool(block)


def number_of(token: bytes) -> float | None:
    """Return a finite number, or None for other text."""
    if _NUMBER.fullmatch(token) is None:
        return None
    value = float(token)
    return value if math.isfinite(value) else None
