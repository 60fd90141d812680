"""Sparsity pattern of a problem: unknowns, nonzeros, and pairs of coupled blocks.

The unknowns are the free points p and the blocks c of camera parameters: an image's pose and
intrinsics, or a shared camera's intrinsics (``cpp/core/model/parameter_layout.h``).

    J   two rows per observation, nonzero in the blocks of its point and of its image,
    H   = J^T J, the information matrix; H_pp is block diagonal,
    S   = H_cc - H_cp H_pp^-1 H_pc, the reduced camera system: two blocks are coupled if they are
        the pose and the intrinsics of one image, or if both observe a common free point.

The number of nonzeros of H and of S includes both triangles and the diagonal. The number of
nonzeros of L includes its lower triangle and its diagonal. Blocks count as dense.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem

Sizes = NDArray[np.int32]

PROFILE_BINS = 200


class BlockPattern(NamedTuple):
    """Lower triangle of a symmetric matrix of dense blocks, by block columns."""

    sizes: Sizes  # (num_blocks,) rows and columns of each diagonal block
    column_begin: NDArray[np.int64]  # (num_blocks + 1,) first entry of each block column
    rows: Sizes  # block row of each entry, ascending within a column; the diagonal comes first

    @property
    def num_columns(self) -> int:
        """Number of scalar columns."""
        return int(self.sizes.sum(dtype=np.int64))

    @property
    def num_edges(self) -> int:
        """Number of coupled pairs of different blocks."""
        return len(self.rows) - len(self.sizes)

    @property
    def edges(self) -> NDArray[np.int64]:
        """Pairs (smaller, larger) of coupled blocks, (num_edges, 2)."""
        columns = np.repeat(np.arange(len(self.sizes)), np.diff(self.column_begin))
        pairs: NDArray[np.int64] = np.stack([columns, self.rows], axis=1)[columns != self.rows]
        return pairs

    @property
    def nnz(self) -> int:
        """Nonzeros of both triangles and the diagonal."""
        sizes = self.sizes.astype(np.int64)
        columns = np.repeat(sizes, np.diff(self.column_begin))
        return int(2 * (columns * sizes[self.rows]).sum() - (sizes**2).sum())

    def sums_are_double_doubles(self, linear_solver_type: str) -> bool:
        """Return True if the fused backend sums S in double-double arithmetic."""
        return _core.sums_are_double_doubles(
            linear_solver_type.lower(), self.num_columns, len(self.sizes), len(self.rows)
        )


def pattern_of_edges(sizes: Sizes, pairs: NDArray[np.int64]) -> BlockPattern:
    """Return the lower triangle by block columns of distinct pairs (smaller, larger)."""
    diagonal = np.arange(len(sizes))
    columns = np.concatenate([diagonal, pairs[:, 0]])
    rows = np.concatenate([diagonal, pairs[:, 1]])
    by_column = np.lexsort((rows, columns))
    begin = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=len(sizes)))])
    return BlockPattern(sizes, begin.astype(np.int64), rows[by_column].astype(np.int32))


@dataclass(frozen=True, eq=False, kw_only=True)
class FactorCount:
    """Cost of a Cholesky factor L in one elimination order."""

    nnz: int  # nnz(L), including the diagonal
    fill: int  # fill-in: pairs of blocks that are nonzero in L and zero in the matrix
    # sum of c^2 + 3 c over the columns with c entries below the diagonal: updates of the remaining
    # matrix and of the right-hand side
    flops: float
    cholmod_flops: float  # sum of (c + 1)^2, as CHOLMOD's analysis prints it
    tree_height: int  # blocks on the longest path of the elimination tree
    # largest c of up to 200 equal portions of the columns, in elimination order
    profile: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class PlanSize:
    """Sizes of the fused backend's passes over the points (``bundle::PlanSize``).

    All are zero if a track is too long for the fused backend.
    """

    num_points: int = 0
    num_free_points: int = 0
    num_observations: int = 0
    num_pairs: int = 0
    num_kinds: int = 1
    num_tile_blocks: int = 0
    num_chunk_pairs: int = 0
    num_chunk_parts: int = 0
    largest_chunk_blocks: int = 0
    block_doubles: int = 0


@dataclass(frozen=True, eq=False, kw_only=True)
class ProblemPattern:
    """Counts on which the predictions are based."""

    num_observations: int  # observations of refined parameters
    num_free_points: int  # number of refined points
    reduced: BlockPattern  # pattern of S
    # nnz_jacobian, nnz_information: nonzeros of J and H
    nnz_jacobian: int
    nnz_information: int
    # block products of the elimination: pairs of camera blocks that observe a free point, summed
    # over the points, each pair once and each block with itself
    block_pairs: int
    # the same in scalars: half the sum of F^2 over the free points, where F columns of camera
    # parameters observe a point
    pair_entries: float
    longest_track: int  # largest number of observations of a point
    num_pairs: int  # pairs of observations of the same point
    # all camera blocks have the same size and each observation has one of them; Ceres then uses
    # Schur kernels of fixed size
    has_equal_blocks: bool
    plan: PlanSize  # sizes of the fused backend's passes

    @property
    def num_camera_columns(self) -> int:
        """Number of free camera parameters."""
        return self.reduced.num_columns

    @property
    def num_reduced_values(self) -> float:
        """Values stored for a sparse S: its lower triangle with full diagonal blocks."""
        squares = float((self.reduced.sizes.astype(float) ** 2).sum())
        return (self.reduced.nnz + squares) / 2

    @property
    def num_unknowns(self) -> int:
        """Total number of unknowns."""
        return self.num_camera_columns + 3 * self.num_free_points

    def without_system(self) -> ProblemPattern:
        """Return the pattern for a solver that does not form S.

        It has only the diagonal blocks of S, without pairs of images.
        """
        blocks = len(self.reduced.sizes)
        plan = replace(
            self.plan,
            num_pairs=0,
            num_tile_blocks=0,
            num_chunk_pairs=0,
            largest_chunk_blocks=min(self.plan.largest_chunk_blocks, blocks),
        )
        diagonal = BlockPattern(
            self.reduced.sizes, np.arange(blocks + 1), np.arange(blocks, dtype=np.int32)
        )
        return replace(self, plan=plan, reduced=diagonal)


def find_pattern(problem: Problem, options: SolveOptions) -> ProblemPattern:
    """Return the pattern of the free parameters; ``options`` must have a gauge and a cheirality."""
    given = options.asdict()
    blocks = _core.parameter_blocks(problem, given)
    reduced = BlockPattern(*_core.reduced_pattern(problem, given))
    tracks = np.bincount(problem.observation_point, minlength=1)
    longest_track = int(tracks.max())
    plan = PlanSize()
    if longest_track <= _core.MAX_TRACK_LENGTH:
        plan = PlanSize(**_core.elimination_plan(problem, given))
    is_free = blocks["point_is_free"]
    sizes = np.append(blocks["size"], 0).astype(np.int64)  # block -1: no block
    # Three blocks per image: pose of the image or frame, pose of the sensor, intrinsics.
    camera_block = blocks["camera_block"][problem.image_camera]
    of_image = np.stack([blocks["image_block"], blocks["sensor_block"], camera_block])
    width = sizes[of_image].sum(axis=0)[problem.observation_image]
    free = is_free[problem.observation_point]
    seen = _seen_blocks(problem, free, of_image, len(sizes) - 1)
    seen_point, seen_size = seen[0], sizes[seen[1]]
    num_seen = np.bincount(seen_point, minlength=problem.num_points).astype(float)
    columns = np.bincount(seen_point, seen_size, problem.num_points)
    pairs = np.hstack([of_image[[0, 1]], of_image[[0, 2]], of_image[[1, 2]]])
    within_images = np.unique(pairs[:, (pairs >= 0).all(axis=0)], axis=1)
    camera_parameters = int((sizes**2).sum() + 2 * sizes[within_images].prod(0).sum())
    return ProblemPattern(
        num_observations=int(np.count_nonzero(free | (width > 0))),
        num_free_points=int(is_free.sum()),
        reduced=reduced,
        nnz_jacobian=int(2 * (3 * free.sum() + width.sum())),
        nnz_information=camera_parameters + 9 * int(is_free.sum()) + 2 * int(3 * seen_size.sum()),
        block_pairs=int((num_seen * (num_seen + 1) / 2).sum()),
        pair_entries=float((columns**2).sum() / 2),
        longest_track=longest_track,
        num_pairs=int((tracks * (tracks - 1)).sum()) // 2,
        has_equal_blocks=not within_images.size and len(np.unique(blocks["size"])) == 1,
        plan=plan,
    )


def _seen_blocks(
    problem: Problem,
    free: NDArray[np.bool_],
    of_image: Sizes,
    num_blocks: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the distinct (point, block) of free points and camera blocks that observe them."""
    point = problem.observation_point[free].astype(np.int64)
    image = problem.observation_image[free]
    codes = [
        point[block >= 0] * num_blocks + block[block >= 0]
        for block in (blocks[image] for blocks in of_image)
    ]
    code = np.sort(np.concatenate(codes))
    code = code[np.diff(code, prepend=-1) != 0]
    seen_point, seen_block = np.divmod(code, max(num_blocks, 1))
    return seen_point, seen_block


def count_factor(pattern: BlockPattern, order: Sizes) -> FactorCount:
    """Return the exact cost of the factor for this elimination order of the blocks."""
    counts: dict[str, Any] = _core.count_factor(*pattern, order)
    return FactorCount(
        nnz=round(counts["entries"]),
        fill=counts["fill_edges"],
        flops=counts["flops"],
        cholmod_flops=counts["cholmod_flops"],
        tree_height=counts["tree_height"],
        profile=_profile(counts["rows_below"], pattern.sizes[order].astype(np.int64)),
    )


def _profile(rows_below: NDArray[np.int64], sizes: NDArray[np.int64]) -> tuple[int, ...]:
    """Return the largest column counts of equal portions, from blocks in elimination order.

    The k-th scalar column of a block of size m has the rows below the block and m - 1 - k rows
    within it. The largest count of a portion is therefore that of its first column, or of the first
    column of a block.
    """
    ends = np.cumsum(sizes)
    num_columns = int(ends[-1]) if len(ends) else 0
    if num_columns == 0:
        return ()
    bins = min(PROFILE_BINS, num_columns)
    first = np.arange(bins) * num_columns // bins
    block = np.searchsorted(ends, first, side="right")
    profile = rows_below[block] + ends[block] - 1 - first
    starts = ends - sizes
    portion = np.searchsorted(first, starts, side="right") - 1
    np.maximum.at(profile, portion, rows_below + sizes - 1)
    return tuple(profile.tolist())


def count_dense(num_columns: int, num_missing: int, num_blocks: int) -> FactorCount:
    """Return the cost of a dense factor; ``num_missing`` pairs of blocks are fill-in."""
    n = float(num_columns)
    bins = min(PROFILE_BINS, num_columns)
    return FactorCount(
        nnz=num_columns * (num_columns + 1) // 2,
        fill=num_missing,
        flops=(n - 1) * n * (2 * n - 1) / 6 + 3 * n * (n - 1) / 2,
        cholmod_flops=n * (n + 1) * (2 * n + 1) / 6,
        tree_height=num_blocks,
        profile=tuple(num_columns - 1 - k * num_columns // bins for k in range(bins)),
    )
