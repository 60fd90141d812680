"""What users hand in as a graph, made into arrays or refused in one line."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arguments import as_integers
from bundle.errors import InputError, brief

__all__ = ["as_block_sizes", "as_edges", "as_names", "as_tracks", "as_variables"]

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
    """Return a name for each variable, as many as there are."""
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
        raise InputError(f"names: expected {count}, one a variable, found {len(names)}")
    return tuple(map(str, names))


def as_variables(
    argument: str, values: Iterable[Any] | NDArray[np.int64], num_variables: int
) -> NDArray[np.int64]:
    """Return numbers of variables; refuse numbers of no variable."""
    variables = as_integers(argument, values)
    wrong = variables[(variables < 0) | (variables >= num_variables)]
    if len(wrong):
        expected = f"variables 0 to {num_variables - 1}" if num_variables else "no variables"
        raise InputError(f"{argument}: expected {expected}, found {wrong[0]}")
    return variables


def as_block_sizes(block_size: int | Sequence[int], num_variables: int) -> NDArray[np.int32]:
    """Return the scalars of each variable."""
    one = isinstance(block_size, int | np.integer)
    sizes = as_integers("block_size", [block_size] if one else block_size)
    if one:
        sizes = np.full(num_variables, sizes[0])
    if sizes.shape != (num_variables,):
        raise InputError(
            f"block_size: expected one or {num_variables}, one a variable, found {sizes.shape}"
        )
    wrong = sizes[(sizes < 1) | (sizes > MOST_SCALARS_A_BLOCK)]
    if len(wrong):
        raise InputError(f"block_size: expected 1 to {MOST_SCALARS_A_BLOCK}, found {wrong[0]}")
    return sizes.astype(np.int32)


def as_tracks(track_lengths: Iterable[int], num_cameras: int) -> NDArray[np.int64]:
    """Return track lengths of points, each at most one observation a camera."""
    tracks = as_integers("track_lengths", track_lengths)
    wrong = tracks[(tracks < 0) | (tracks > num_cameras)]
    if len(wrong):
        raise InputError(f"track_lengths: expected 0 to {num_cameras}, found {wrong[0]}")
    return tracks
