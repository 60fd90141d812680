"""Lines of OpenDroneMap's text files, whatever editor wrote them.

Tabs, blank lines and ``#`` comments are all found in the wild. The first line that is left names
the coordinate reference system.
"""

from __future__ import annotations

import math
import os

from bundle.errors import InputError, brief, shown
from bundle.georeference.reference_system import ReferenceSystem
from bundle.text_lines import numbered_lines

__all__ = ["parse_number", "read_lines"]


def read_lines(
    path: str | os.PathLike[str],
) -> tuple[ReferenceSystem, list[tuple[int, list[str]]]]:
    """Return the reference system, and the words of every further line with its number from 1.

    Raises:
        InputError: the file is no text, or its first line names no reference system.
        OSError: it cannot be read.
    """
    lines = [
        (number, line)
        for number, line in numbered_lines(path)
        if line.strip() and not line.strip().startswith("#")
    ]
    if not lines:
        raise InputError(
            f"{shown(path)}: expected a line with the coordinate reference system, found none"
        )
    (number, header), *rows = lines
    try:
        system = ReferenceSystem(header.strip())
    except InputError as error:
        raise InputError(f"{shown(path)}: line {number}: {error}") from None
    return system, [(number, line.split()) for number, line in rows]


def parse_number(place: str, name: str, word: str, *, unknown: bool = False) -> float:
    """Return a word as a number.

    Args:
        place: file and line, for messages.
        name: what the number is.
        word: as it stands in the file.
        unknown: whether nan is allowed, for what is not known.

    Raises:
        InputError: it is no number, or not finite.
    """
    try:
        value = float(word)
    except ValueError:
        value = math.inf
    if math.isinf(value) or (math.isnan(value) and not unknown):
        kind = "a number or nan" if unknown else "a number"
        raise InputError(f"{place}: {name}: expected {kind}, found {brief(word)}")
    return value
