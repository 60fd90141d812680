"""Numbers of text files and values of JSON, with their places for messages."""

from __future__ import annotations

import bz2
import gzip
import json
import math
import re
from codecs import BOM_UTF8
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, NoReturn, cast

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
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
        """Return the next line that is not blank."""
        while True:
            line = self.line()
            if line:
                return line
            if self._at_end and self.position == len(self._text):
                self.fail(what, "the end of the file")

    def token(self, what: str) -> bytes:
        """Return the next token."""
        while True:
            found = _TOKEN.search(self._text, self.position)
            if found is not None and (found.end() < len(self._text) or self._at_end):
                self.position = found.end()
                return found[0]
            if not self._more() and found is None:
                self.fail(what, "the end of the file")

    def number(self, what: str) -> float:
        """Return the next token as a finite number."""
        token = self.token(what)
        value = number_of(token)
        if value is None:
            self.fail(f"{what} (a finite number)", brief(token.decode(errors="replace")))
        return value

    def count(self, what: str, most: int = MOST_IMAGES) -> int:
        """Return the next token as a count."""
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


@dataclass(frozen=True, slots=True)
class Node:
    """A value and its place in the file."""

    value: Any
    place: str

    def get(self, key: str) -> Node:
        """Return a member."""
        found = self.find(key)
        if found is None:
            raise InputError(f"{self.place}: expected a member {key}, found {_keys(self.value)}")
        return found

    def find(self, key: str) -> Node | None:
        """Return a member; None without it."""
        if not isinstance(self.value, dict):
            self.fail("an object")
        if key not in self.value:
            return None
        return Node(self.value[key], f"{self.place}: {key}")

    def items(self) -> Iterator[tuple[str, Node]]:
        """Yield the members of an object."""
        if not isinstance(self.value, dict):
            self.fail("an object")
        for key, value in self.value.items():
            yield key, Node(value, f"{self.place}: {key}")

    def keys(self) -> list[str]:
        """Return the names of the members of an object."""
        if not isinstance(self.value, dict):
            self.fail("an object")
        return list(self.value)

    def entries(self, expected: str = "an array") -> Iterator[Node]:
        """Yield the entries of an array."""
        if not isinstance(self.value, list):
            self.fail(expected)
        for index, value in enumerate(self.value):
            yield Node(value, f"{self.place}[{index}]")

    def text(self) -> str:
        """Return a text."""
        if not isinstance(self.value, str):
            self.fail("a text")
        return self.value

    def number(self) -> float:
        """Return a finite number."""
        if isinstance(self.value, bool) or not isinstance(self.value, int | float):
            self.fail("a number")
        if not abs(self.value) <= 1e300:
            self.fail("a finite number")
        return float(self.value)

    def whole(self, most: int = 2**31 - 1) -> int:
        """Return a whole number from 0 to ``most``."""
        value = self.value
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most:
            self.fail(f"a whole number from 0 to {most}")
        return value

    def numbers(self, *shape: int) -> NDArray[np.float64]:
        """Return finite numbers in an array of a shape."""
        values = _flat(self.value, shape)
        if values is None:
            self.fail(f"{' x '.join(map(str, shape))} finite numbers")
        return np.array(values, float).reshape(shape)

    def fail(self, expected: str) -> NoReturn:
        """Raise an InputError with file and place."""
        raise InputError(f"{self.place}: expected {expected}, found {brief(self.value)}")


def _keys(value: dict[str, Any]) -> str:
    return brief(", ".join(value)) if value else "an empty object"


def _flat(value: Any, shape: tuple[int, ...]) -> list[float] | None:
    """Return the numbers of nested lists of a shape; None for other values."""
    if not shape:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        return [value] if is_number and abs(value) <= 1e300 else None
    if not isinstance(value, list) or len(value) != shape[0]:
        return None
    parts = [_flat(entry, shape[1:]) for entry in value]
    return None if None in parts else [number for part in parts for number in part or ()]


def read_json(path: Path) -> Node:
    """Read a JSON file of any contents, plain or compressed."""
    try:
        with open_binary(path) as file:
            return parsed(file.read(), path)
    except EOFError as error:
        raise InputError(f"{shown(path)}: expected complete data, found {error}") from None


def parsed(text: bytes, path: Path) -> Node:
    """Return the value of a JSON text of a file."""
    try:
        return Node(json.loads(text), shown(path))
    except json.JSONDecodeError as error:
        raise InputError(
            f"{shown(path)}:{error.lineno}: expected JSON, found an error in column "
            f"{error.colno} ({error.msg})"
        ) from None
    except RecursionError:
        raise InputError(f"{shown(path)}: expected JSON, found nesting that is too deep") from None
    except ValueError as error:
        raise InputError(f"{shown(path)}: expected JSON, found {brief(str(error))}") from None
