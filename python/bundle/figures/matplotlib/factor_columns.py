"""The structure of a Cholesky factor, one block column at a time.

Column j of L holds what column j of the matrix holds below the diagonal, and what the columns hold
whose first entry below their diagonal is j: its children in the elimination tree (Davis, Direct
Methods for Sparse Linear Systems, 4.1). A column is forgotten as soon as its parent has taken it,
so that L never stands in memory as a whole.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from bundle.figures.matplotlib.matrix_pattern import MatrixPattern

__all__ = ["factor_columns"]


def factor_columns(pattern: MatrixPattern) -> Iterator[NDArray[np.int32]]:
    """Yield the block rows of each column of L, ascending, the diagonal first."""
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
