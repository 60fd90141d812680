"""Cost of each method's factor, with exact counts where they are affordable."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.planning.inspection.problem_pattern import (
    BlockPattern,
    FactorCount,
    ProblemPattern,
    count_dense,
    count_factor,
)

# Largest number of entries of the full pattern for which AMD takes only seconds.
MOST_ENTRIES_FOR_AMD = _core.MOST_ENTRIES_FOR_AMD

# Number of pairs of points to collect before duplicates are removed.
CODES_AT_A_TIME = 1 << 22
# Largest number of pairs of covisible points for which the system of the points is counted.
MOST_POINT_PAIRS = 20_000_000


class FactorizedSystem(NamedTuple):
    """System that a method factorises, with the cost of its factor.

    Attributes:
        columns: scalar columns of the factorised matrix.
        nnz_reduced: nonzeros of the reduced system; 0 without one.
        factor: cost of the factor.
        note: remark on the numbers.
        values: stored values of the reduced system: its lower triangle, or all of it if dense.
        panel_values: stored values of the factor in the fused backend's panels.
    """

    columns: int
    nnz_reduced: int
    factor: FactorCount
    note: str = ""
    values: float = 0.0
    panel_values: float = 0.0


class FactorCounter:
    """Counter of the factors of one problem; each pattern is built at most once."""

    def __init__(self, problem: Problem, options: SolveOptions, pattern: ProblemPattern) -> None:
        self._problem = problem
        self._options = options.asdict()
        self._pattern = pattern
        self._reduced: dict[str, FactorizedSystem] = {}

    def dense(self) -> FactorizedSystem:
        """Return S as a dense system."""
        reduced = self._pattern.reduced
        blocks = len(reduced.sizes)
        missing = blocks * (blocks - 1) // 2 - reduced.num_edges
        count = count_dense(reduced.num_columns, missing, blocks)
        values = float(reduced.num_columns) ** 2
        return FactorizedSystem(reduced.num_columns, reduced.nnz, count, "", values)

    def sparse(self, ordering: str) -> FactorizedSystem:
        """Return S in an elimination order of ``_core.order_blocks``."""
        reduced = self._pattern.reduced
        if ordering not in self._reduced:
            order = _core.order_blocks(*reduced, ordering)
            self._reduced[ordering] = FactorizedSystem(
                columns=reduced.num_columns,
                nnz_reduced=reduced.nnz,
                factor=count_factor(reduced, order),
                values=self._pattern.num_reduced_values,
                panel_values=_core.panel_values(*reduced, order),
            )
        return self._reduced[ordering]

    def whole(self) -> FactorizedSystem:
        """Return the information matrix of all unknowns."""
        pattern, order, points_first = _core.ordered_full_pattern(
            self._problem, self._options, MOST_ENTRIES_FOR_AMD
        )
        full = BlockPattern(*pattern)
        if not points_first:
            return FactorizedSystem(full.num_columns, 0, count_factor(full, order))
        note = (
            "counted with points first and cameras in AMD order: AMD on all "
            f"{len(full.sizes)} blocks takes long and differs by 1 to 2 %"
        )
        return FactorizedSystem(full.num_columns, 0, count_factor(full, order), note)

    def cameras_first(self) -> FactorizedSystem:
        """Return the system of the points after eliminating the cameras, or an upper bound."""
        points = self._point_pattern()
        if points is not None:
            order = _core.order_blocks(*points, "amd")
            values = (points.nnz + float((points.sizes.astype(float) ** 2).sum())) / 2
            count = count_factor(points, order)
            return FactorizedSystem(points.num_columns, points.nnz, count, "", values)
        columns = 3 * self._pattern.num_free_points
        number = self._pattern.num_free_points
        note = "upper bound: assumes that all points are covisible; an exact count takes long"
        count = count_dense(columns, number * (number - 1) // 2, number)
        return FactorizedSystem(
            columns, columns**2, count, note, float(columns) * (columns + 1) / 2
        )

    def _point_pattern(self) -> BlockPattern | None:
        """Return the pattern of covisible free points; None above MOST_POINT_PAIRS pairs."""
        blocks = _core.parameter_blocks(self._problem, self._options)
        free, image = blocks["point_is_free"], blocks["image_block"]
        block = image[self._problem.observation_image]  # block of the image or of its frame
        wanted = free[self._problem.observation_point] & (block >= 0)
        observed = np.bincount(block[wanted], minlength=1).astype(float)
        if (observed * (observed + 1) / 2).sum() > MOST_POINT_PAIRS:
            return None
        number = np.cumsum(free) - 1
        order = np.argsort(block[wanted], kind="stable")
        images = block[wanted][order]
        points = number[self._problem.observation_point[wanted][order]]
        return _cliques(np.split(points, np.flatnonzero(np.diff(images)) + 1), int(free.sum()))


def _cliques(groups: list[NDArray[np.int64]], num_points: int) -> BlockPattern:
    """Return the pattern in which each group is a clique."""
    codes = [np.arange(num_points) * (num_points + 1)]
    num_codes = 0
    for group in groups:
        members = _distinct(group)
        low, high = np.triu_indices(len(members), 1)
        codes.append(members[low] * num_points + members[high])
        num_codes += len(low)
        if num_codes > CODES_AT_A_TIME:
            codes, num_codes = [_distinct(np.concatenate(codes))], 0
    columns, rows = np.divmod(_distinct(np.concatenate(codes)), max(num_points, 1))
    begin = np.searchsorted(columns, np.arange(num_points + 1)).astype(np.int64)
    return BlockPattern(np.full(num_points, 3, np.int32), begin, rows.astype(np.int32))


def _distinct(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return sorted distinct numbers.

    Np.unique hashes since NumPy 2.3 and takes 10 times longer.
    """
    ordered = np.sort(numbers)
    is_new = np.ones(len(ordered), bool)
    is_new[1:] = ordered[1:] != ordered[:-1]
    return ordered[is_new]
