"""Nonzero pattern of a symmetric block matrix, under any block order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.arguments import as_integers
from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.interface.option_fields import number


@dataclass(frozen=True, eq=False)
class MatrixPattern:
    """Lower triangle of a symmetric pattern by block columns, in the core's format.

    Attributes:
        sizes: (num_blocks,) scalar unknowns of each block.
        column_begin: (num_blocks + 1,) first entry of each block column in ``rows``.
        rows: block rows of each column, ascending, the diagonal first.

    Raises:
        InputError: the arrays do not describe a lower triangle.
    """

    sizes: NDArray[np.int64]
    column_begin: NDArray[np.int64]
    rows: NDArray[np.int64]

    def __post_init__(self) -> None:
        for name in ("sizes", "column_begin", "rows"):
            object.__setattr__(self, name, _row(name, getattr(self, name)))
        begin, rows = self.column_begin, self.rows
        if len(begin) != len(self.sizes) + 1 or begin[0] != 0 or begin[-1] != len(rows):
            raise InputError(
                f"column_begin: expected {len(self.sizes) + 1} numbers from 0 to {len(rows)}, "
                f"found {len(begin)} from {begin[:1]} to {begin[-1:]}"
            )
        if len(rows) and (rows.max() >= len(self.sizes) or (rows < self.columns).any()):
            raise InputError("rows: expected the lower triangle, found an entry above or outside")

    @classmethod
    def from_edges(cls, num_blocks: int, edges: ArrayLike, sizes: Sequence[int] | int = 1) -> Self:
        """Return the pattern of a graph: its edges and the diagonal; repeated edges are allowed."""
        num_blocks = number("num_blocks", num_blocks, whole=True, minimum=0)
        pairs = as_integers("edges", edges)
        if pairs.size and (pairs.ndim != 2 or pairs.shape[1] != 2):
            raise InputError(f"edges: expected shape (num_edges, 2), found {pairs.shape}")
        pairs = np.sort(pairs.reshape(-1, 2), axis=1)
        if pairs.size and not 0 <= pairs.min() <= pairs.max() < num_blocks:
            raise InputError(
                f"edges: expected blocks 0 to {num_blocks - 1}, "
                f"found {pairs.min()} to {pairs.max()}"
            )
        diagonal = np.arange(num_blocks)
        code = np.unique(
            np.concatenate([pairs[:, 0] * num_blocks + pairs[:, 1], diagonal * (num_blocks + 1)])
        )
        columns, rows = np.divmod(code, max(num_blocks, 1))
        begin = np.searchsorted(columns, np.arange(num_blocks + 1))
        return cls(np.broadcast_to(np.asarray(sizes, np.int64), num_blocks), begin, rows)

    @cached_property
    def columns(self) -> NDArray[np.int64]:
        """Block column of each entry of ``rows``."""
        return np.repeat(np.arange(self.num_blocks), np.diff(self.column_begin))

    @property
    def num_blocks(self) -> int:
        """Number of block rows."""
        return len(self.sizes)

    @property
    def num_unknowns(self) -> int:
        """Number of scalar rows."""
        return int(self.sizes.sum())

    @property
    def num_nonzeros(self) -> int:
        """Scalar nonzeros of both triangles and the diagonal."""
        each = self.sizes[self.rows] * self.sizes[self.columns]
        return int((each * np.where(self.rows == self.columns, 1, 2)).sum())

    def permuted(self, order: ArrayLike | None) -> MatrixPattern:
        """Return the pattern with block ``order[k]`` at position k."""
        if order is None:
            return self
        wanted = as_integers("order", order)
        if not np.array_equal(np.sort(wanted), np.arange(self.num_blocks)):
            raise InputError(
                f"order: expected each of {self.num_blocks} blocks once, found {len(wanted)} "
                f"numbers, {len(np.unique(wanted))} of them distinct"
            )
        place = np.empty_like(wanted)
        place[wanted] = np.arange(len(wanted))
        row, column = place[self.rows], place[self.columns]
        low, high = np.minimum(row, column), np.maximum(row, column)
        by_column = np.lexsort((high, low))
        begin = np.searchsorted(low[by_column], np.arange(self.num_blocks + 1))
        return MatrixPattern(self.sizes[wanted], begin, high[by_column])

    @classmethod
    def of(cls, triple: Any) -> MatrixPattern:
        """Return a pattern from (sizes, column_begin, rows); a pattern is returned unchanged."""
        if isinstance(triple, MatrixPattern):
            return triple
        if not isinstance(triple, tuple | list) or len(triple) != 3:
            raise InputError(
                "pattern: expected a MatrixPattern or (sizes, column_begin, rows), "
                f"found {brief(triple)}"
            )
        return cls(*triple)


def _row(name: str, values: Any) -> NDArray[np.int64]:
    row = as_integers(name, values)
    if row.ndim != 1:
        raise InputError(f"{name}: expected integers in one row, found shape {row.shape}")
    return row


def factor_columns(pattern: MatrixPattern) -> Iterator[NDArray[np.int32]]:
    """Yield the block rows of each column of L, ascending, the diagonal first.

    Below the diagonal, column j of L has the rows of column j of the matrix and those of its
    children in the elimination tree. The children are the columns whose first entry below the
    diagonal is j (Davis, Direct Methods for Sparse Linear Systems, 4.1). A column is discarded once
    its parent has used it, so L is never in memory as a whole.
    """
    begin, rows = pattern.column_begin, pattern.rows.astype(np.int32)
    waiting: dict[int, list[NDArray[np.int32]]] = {}
    held = np.zeros(pattern.num_blocks, bool)
    for column in range(pattern.num_blocks):
        held[column] = True
        held[rows[begin[column] : begin[column + 1]]] = True
        for child in waiting.pop(column, ()):
            held[child] = True
        found = (column + np.flatnonzero(held[column:])).astype(np.int32)
        held[found] = False
        if len(found) > 1:
            waiting.setdefault(int(found[1]), []).append(found[1:])
        yield found
