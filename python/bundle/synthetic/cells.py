"""A uniform grid over points, of which only the occupied cells are kept."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["Cells"]

Array = NDArray[np.float64]


class Cells:
    """Finds the cells that a ball may touch.

    Attributes:
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
        self._centers = (grid[self.order[first]] + 0.5) * size + keys.min(axis=0)
        self._half_diagonal = 0.5 * np.sqrt(3.0) * size

    def __len__(self) -> int:
        return len(self.starts) - 1

    def touched_by(self, center: Array, radius: float) -> NDArray[np.int64]:
        """Return the cells that a ball may touch: all that it does, and a few neighbours."""
        offset = self._centers - center
        squared = offset[:, 0] ** 2 + offset[:, 1] ** 2 + offset[:, 2] ** 2
        return np.flatnonzero(squared <= (radius + self._half_diagonal) ** 2)

    def members(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return positions in ``order`` of everything in the given cells."""
        counts = self.starts[cells + 1] - self.starts[cells]
        ends = np.cumsum(counts)
        total = int(ends[-1]) if len(ends) else 0
        members: NDArray[np.int64] = np.repeat(self.starts[cells] - (ends - counts), counts)
        return members + np.arange(total)
