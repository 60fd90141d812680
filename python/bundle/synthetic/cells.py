"""A uniform grid over points, of which only the occupied cells are kept."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["Cells"]

Array = NDArray[np.float64]


class Cells:
    """Which points are in which cell.

    Attributes:
        centers: (num_cells, 3)
        half_diagonal: of a cell.
        order: (n,) the points, cell by cell.
        starts: (num_cells + 1,) where each cell begins in ``order``.
    """

    order: NDArray[np.int64]
    starts: NDArray[np.int64]

    def __init__(self, keys: Array, size: float) -> None:
        grid = np.floor((keys - keys.min(axis=0)) / size).astype(np.int64)
        extent = grid.max(axis=0) + 1
        code = (grid[:, 0] * extent[1] + grid[:, 1]) * extent[2] + grid[:, 2]
        self.order = np.argsort(code, kind="stable")
        code = code[self.order]
        first = np.flatnonzero(np.concatenate([[True], code[1:] != code[:-1]]))
        self.starts = np.append(first, len(code))
        self.centers = (grid[self.order[first]] + 0.5) * size + keys.min(axis=0)
        self.half_diagonal = 0.5 * float(np.sqrt(3.0)) * size

    def __len__(self) -> int:
        return len(self.starts) - 1
