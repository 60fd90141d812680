"""Reader of OpenDroneMap's text files: the header, and the words of each line.

Files contain tabs, blank lines and ``#`` comments. The first remaining line names the coordinate
reference system. A name with blanks is in quotes, or between tabs in a line whose other fields have
no blanks.
"""

from __future__ import annotations

import math
import os
import re

from bundle.base.paths import numbered_lines
from bundle.errors import InputError, brief, shown
from bundle.georeference.reference_system import ReferenceSystem

_COORDINATES = ("x", "y", "z")
_QUOTES = "; put a name with blanks in quotes"
_ENDS_AS_FILES_DO = re.compile(r"\.[A-Za-z]\w{1,4}$")
_WORDS = re.compile(r"""(?<!\S)(?:"([^"]+)"|'([^']+)')(?!\S)|(\S+)""")

LOCAL = "LOCAL"
"""First line of a file whose coordinates are metres in a frame of their own, the third axis up."""


def read_lines(
    path: str | os.PathLike[str], name_at: int
) -> tuple[ReferenceSystem | None, list[tuple[int, list[str]]]]:
    """Return the reference system, and the words of every further line with its number from 1.

    The system is None after a first line LOCAL: coordinates are metres in a frame of their own.

    Args:
        path: path of the file.
        name_at: index of the word that is the name of an image.

    Raises:
        InputError: the file is not text, or its first line does not name a reference system.
        OSError: the file cannot be read.
    """
    lines = [
        (number, line)
        for number, line in numbered_lines(path)
        if line.strip() and not line.strip().startswith("#")
    ]
    if not lines:
        raise InputError(
            f"{shown(path)}: expected a line with the coordinate reference system, found 0 lines"
        )
    (number, header), *rows = lines
    split = [(place, split_words(line, name_at)) for place, line in rows]
    if header.strip().upper() == LOCAL:
        return None, split
    try:
        system = ReferenceSystem(header.strip())
    except InputError as error:
        raise InputError(f"{shown(path)}: line {number}: {error}") from None
    return system, split


def split_words(line: str, name_at: int) -> list[str]:
    """Return the words of a line: the fields between tabs if only the name has blanks."""
    fields = [field.strip() for field in line.split("\t") if field.strip()]
    if len(fields) > max(name_at, 1) and _ENDS_AS_FILES_DO.search(fields[name_at].strip("'\"")):
        others = fields[:name_at] + fields[name_at + 1 :]
        if not any(re.search(r"\s", field) for field in others):
            fields[name_at] = fields[name_at].strip("'\"")
            return fields
    return [next(filter(None, groups)) for groups in _WORDS.findall(line)]


def parse_number(place: str, name: str, word: str, *, unknown: bool = False) -> float:
    """Return a word as a number.

    Args:
        place: file and line, for messages.
        name: name of the number for messages.
        word: the word in the file.
        unknown: allow nan for unknown values.

    Raises:
        InputError: the word is not numeric, or not finite.
    """
    try:
        value = float(word)
    except ValueError:
        value = math.inf
    if math.isinf(value) or (math.isnan(value) and not unknown):
        kind = "a number or nan" if unknown else "a number"
        hint = "" if name not in _COORDINATES or not re.search("[^\\W\\d]", word) else _QUOTES
        raise InputError(f"{place}: {name}: expected {kind}, found {brief(word)}{hint}")
    return value
