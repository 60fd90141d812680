"""Graphs as text: an edge a line."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from bundle.errors import InputError, shown

__all__ = ["EdgeList", "read_edge_list"]


class EdgeList(NamedTuple):
    """A graph whose variables are numbered from 0.

    Attributes:
        names: of the variables. Whole numbers come in their order, other names in that of the file.
        edges: pairs of variables.
    """

    names: tuple[str, ...]
    edges: tuple[tuple[int, int], ...]


def read_edge_list(path: str) -> EdgeList:
    """Read a file of edges, "a b" a line, of variables alone, "a", and of comments after "#".

    Raises:
        InputError: a line has more than two names or joins a variable to itself, or there is none.
        OSError: the file cannot be read.
    """
    pairs: list[tuple[str, ...]] = []
    text = Path(path).read_text(encoding="utf-8", errors="replace")
    for number, line in enumerate(text.splitlines(), start=1):
        names = tuple(line.partition("#")[0].replace(",", " ").split())
        if len(names) > 2:
            raise InputError(
                f"{shown(path)}:{number}: expected two variables, found {len(names)}: "
                f"{shown(line.strip())!r}"
            )
        if len(names) == 2 and names[0] == names[1]:
            raise InputError(
                f"{shown(path)}:{number}: expected two different variables, found "
                f"{shown(names[0])!r} twice"
            )
        if names:
            pairs.append(names)
    if not pairs:
        raise InputError(f"{shown(path)}: expected edges, found none")
    found = dict.fromkeys(name for names in pairs for name in names)
    order = sorted(found, key=int) if all(map(_is_number, found)) else list(found)
    index = {name: position for position, name in enumerate(order)}
    edges = tuple((index[names[0]], index[names[1]]) for names in pairs if len(names) == 2)
    return EdgeList(tuple(order), edges)


def _is_number(name: str) -> bool:
    return name.isascii() and name.isdigit() and len(name) < 20
