"""Graphs as text files: an edge a line."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

from bundle.errors import InputError, shown

__all__ = ["GraphFile", "load_graph"]


@dataclass(frozen=True)
class GraphFile:
    """A graph whose variables are numbered from 0.

    Attributes:
        names: of the variables. Integers come in their order, other names in that of the file.
        edges: pairs of variables as they stand in the file.
        landmarks: variables with names such as l17 or L17, GTSAM's for landmarks.
    """

    names: tuple[str, ...]
    edges: tuple[tuple[int, int], ...]
    landmarks: tuple[int, ...]


def load_graph(path: str | os.PathLike[str]) -> GraphFile:
    """Read edges "a b", one per line; a line with one name is a variable, of edges or without.

    Names are words without spaces or commas, either of which separates them. What follows # or %
    is a comment. A repeated edge counts once.

    Raises:
        InputError: the text is not UTF-8, a line has more than two names or joins a variable to
            itself; the message has path and line.
        OSError: the file cannot be read.
    """
    lines: list[list[str]] = []
    for number, raw in enumerate(Path(path).read_bytes().splitlines(), start=1):
        where = f"{shown(path)}:{number}"
        try:
            text = raw.decode("utf-8-sig" if number == 1 else "utf-8")
        except UnicodeDecodeError as error:
            raise InputError(
                f"{where}: expected UTF-8 text, found byte 0x{raw[error.start]:02x}"
            ) from None
        names = re.split("[#%]", text, maxsplit=1)[0].replace(",", " ").split()
        if len(names) > 2:
            found = shown(" ".join(names))
            raise InputError(
                f"{where}: expected two variables, an edge, or one, found {len(names)}: {found:.60}"
            )
        if len(names) == 2 and names[0] == names[1]:
            raise InputError(
                f"{where}: expected two different variables, found {shown(names[0])} twice"
            )
        lines.append(names)
    return _number(lines)


def _number(lines: list[list[str]]) -> GraphFile:
    found = dict.fromkeys(name for names in lines for name in names)
    if all(re.fullmatch(r"-?[0-9]{1,18}", name) for name in found):
        names = tuple(sorted(found, key=lambda name: (int(name), name)))
    else:
        names = tuple(found)
    number = {name: variable for variable, name in enumerate(names)}
    edges = tuple((number[line[0]], number[line[1]]) for line in lines if len(line) == 2)
    landmarks = tuple(v for v, name in enumerate(names) if re.fullmatch("[lL][0-9]+", name))
    return GraphFile(names, edges, landmarks)
