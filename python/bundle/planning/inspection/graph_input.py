"""Graphs that users give, as arguments or as text files with one edge per line.

Each function returns checked arrays or raises an InputError of one line.
"""

from __future__ import annotations

import operator
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arguments import as_integers
from bundle.base.records import dataclass
from bundle.errors import InputError, brief, shown


@dataclass(frozen=True)
class GraphFile:
    """Graph whose variables are numbered from 0.

    Attributes:
        names: names of the variables: integers in ascending order, other names in file order.
        edges: pairs of variables in file order.
        landmarks: variables with names such as l17 or L17, as GTSAM names landmarks.
    """

    names: tuple[str, ...]
    edges: tuple[tuple[int, int], ...]
    landmarks: tuple[int, ...]


def load_graph(path: str | os.PathLike[str]) -> GraphFile:
    """Read edges "a b", one per line; a line with one name declares a variable.

    Spaces or commas separate names. Text after # or % is a comment. A repeated edge counts once.

    Raises:
        InputError: the text is not UTF-8, or a line has more than two names or the same name twice;
            the message has path and line.
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
                f"{where}: expected one or two variables, found {len(names)}: {found:.60}"
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


MOST_VARIABLES = 2**31 - 2
MOST_SCALARS_A_BLOCK = 2**31 - 1


def as_edges(edges: Any) -> NDArray[np.int64]:
    """Return the edges as (num_edges, 2); refuse loops."""
    pairs = as_integers("edges", edges)
    if pairs.size == 0:
        return np.zeros((0, 2), np.int64)
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise InputError(f"edges: expected shape (num_edges, 2), found {pairs.shape}")
    loops = np.flatnonzero(pairs[:, 0] == pairs[:, 1])
    if len(loops):
        raise InputError(
            f"edge {loops[0]}: expected two variables, found {pairs[loops[0], 0]} twice"
        )
    return pairs


def as_names(
    names: Sequence[str] | None, pairs: NDArray[np.int64], num_variables: int | None
) -> tuple[str, ...]:
    """Return one name per variable."""
    listed = isinstance(names, str | list | tuple) or (
        isinstance(names, np.ndarray) and names.ndim == 1
    )
    if names is not None and not listed:
        raise InputError(f"names: expected a list of names, found {brief(names)}")
    if num_variables is None:
        num_variables = len(names) if names is not None else int(pairs.max(initial=-1)) + 1
    try:
        count = operator.index(num_variables)
    except TypeError:
        raise InputError(
            f"num_variables: expected an integer, found {brief(num_variables)}"
        ) from None
    if not 0 <= count <= MOST_VARIABLES:
        raise InputError(f"num_variables: expected 0 to {MOST_VARIABLES}, found {count}")
    if names is None:
        return tuple(map(str, range(count)))
    if len(names) != count:
        raise InputError(f"names: expected {count} names, one per variable, found {len(names)}")
    return tuple(map(str, names))


def as_variables(
    argument: str, values: Iterable[Any] | NDArray[np.int64], num_variables: int
) -> NDArray[np.int64]:
    """Return indices of variables; refuse indices out of range."""
    variables = as_integers(argument, values)
    wrong = variables[(variables < 0) | (variables >= num_variables)]
    if len(wrong):
        expected = f"variables 0 to {num_variables - 1}" if num_variables else "no variables"
        raise InputError(f"{argument}: expected {expected}, found {wrong[0]}")
    return variables


def as_block_sizes(block_size: int | Sequence[int], num_variables: int) -> NDArray[np.int32]:
    """Return the number of scalars of each variable."""
    one = isinstance(block_size, int | np.integer)
    sizes = as_integers("block_size", [block_size] if one else block_size)
    if one:
        sizes = np.full(num_variables, sizes[0])
    if sizes.shape != (num_variables,):
        raise InputError(
            f"block_size: expected one size, or {num_variables} sizes, one per variable, found "
            f"{sizes.shape}"
        )
    wrong = sizes[(sizes < 1) | (sizes > MOST_SCALARS_A_BLOCK)]
    if len(wrong):
        raise InputError(f"block_size: expected 1 to {MOST_SCALARS_A_BLOCK}, found {wrong[0]}")
    return sizes.astype(np.int32)
