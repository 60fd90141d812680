"""Values of JSON with their places, for messages."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError, brief, shown
from bundle.io.formats.text_numbers import open_binary


@dataclass(frozen=True, slots=True)
class Node:
    """A value and its place in the file."""

    value: Any
    place: str

    def get(self, key: str) -> Node:
        """Return a member.

        Raises:
            InputError: the value is not an object, or has no such member.
        """
        found = self.find(key)
        if found is None:
            raise InputError(f"{self.place}: expected a member {key}, found {_keys(self.value)}")
        return found

    def find(self, key: str) -> Node | None:
        """Return a member; None without it.

        Raises:
            InputError: the value is not an object.
        """
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

    def entries(self) -> Iterator[Node]:
        """Yield the entries of an array."""
        if not isinstance(self.value, list):
            self.fail("an array")
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
    """Read a JSON file of any contents, plain or compressed.

    Raises:
        InputError: the file is not JSON.
        OSError: the file cannot be read.
    """
    try:
        with open_binary(path) as file:
            return parsed(file.read(), path)
    except EOFError as error:
        raise InputError(f"{shown(path)}: expected complete data, found {error}") from None


def parsed(text: bytes, path: Path) -> Node:
    """Return the value of a JSON text of a file.

    Raises:
        InputError: the text is not JSON; the message has the line.
    """
    try:
        return Node(json.loads(text), shown(path))
    except json.JSONDecodeError as error:
        raise InputError(
            f"{shown(path)}:{error.lineno}: expected JSON, found an error in column "
            f"{error.colno} ({error.msg})"
        ) from None
    except (RecursionError, ValueError) as error:
        raise InputError(f"{shown(path)}: expected JSON, found {brief(str(error))}") from None
