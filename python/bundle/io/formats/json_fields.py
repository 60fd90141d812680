"""Values of JSON files with their places, for messages."""

from __future__ import annotations

import gc
import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError, brief, shown
from bundle.io.formats.text_numbers import open_binary

__all__ = ["Node", "read_json", "rows_of", "uncollected", "whole_numbers"]


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


def rows_of(rows: Iterable[Any], width: int) -> NDArray[np.float64]:
    """Return (n, width) finite numbers of lists.

    Raises:
        ValueError, TypeError, OverflowError: a list has another length, or other values.
    """
    lists = list(rows)
    flat = list(chain.from_iterable(lists))
    array = np.array(flat, float).reshape(-1, width)
    if not (set(map(len, lists)) <= {width} and set(map(type, flat)) <= {int, float}):
        raise ValueError
    if not np.isfinite(array).all():
        raise ValueError
    return array


def whole_numbers(values: Iterable[Any], most: int) -> list[int]:
    """Return whole numbers from 0 to ``most``.

    Raises:
        ValueError: a value is another.
    """
    numbers = list(values)
    if not set(map(type, numbers)) <= {int} or not (
        min(numbers, default=0) >= 0 and max(numbers, default=0) <= most
    ):
        raise ValueError
    return numbers


def _flat(value: Any, shape: tuple[int, ...]) -> list[float] | None:
    """Return the numbers of nested lists of a shape; None for other values."""
    if not shape:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        return [value] if is_number and abs(value) <= 1e300 else None
    if not isinstance(value, list) or len(value) != shape[0]:
        return None
    parts = [_flat(entry, shape[1:]) for entry in value]
    return None if None in parts else [number for part in parts for number in part or ()]


@contextmanager
def uncollected() -> Iterator[None]:
    """Pause the collection of cycles: millions of new objects without cycles would trigger it."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def read_json(path: Path) -> Node:
    """Read a JSON file, plain or compressed.

    Raises:
        InputError: the file is not JSON; the message has the line.
        OSError: the file cannot be read.
    """
    try:
        with open_binary(path) as file:
            text = file.read()
    except EOFError as error:
        raise InputError(f"{shown(path)}: expected complete data, found {error}") from None
    try:
        with uncollected():
            return Node(json.loads(text), shown(path))
    except json.JSONDecodeError as error:
        raise InputError(
            f"{shown(path)}:{error.lineno}: expected JSON, found an error in column "
            f"{error.colno} ({error.msg})"
        ) from None
    except (UnicodeDecodeError, RecursionError, ValueError) as error:
        raise InputError(f"{shown(path)}: expected JSON, found {brief(str(error))}") from None
