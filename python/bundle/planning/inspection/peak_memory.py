"""Peak memory of a solve beyond the loaded problem, as a sum of named terms.

The factor of each method is counted exactly where this is affordable.

Arrays are counted as the sources allocate them. Ceres stores a problem in many small objects; their
bytes per observation and per point were measured (glibc, Ceres 2.1) and agree within 7 % on all
real data and on synthetic scenes of 50 to 1000 images.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.base.words import SHARE_OF_FREE_MEMORY
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.planning.inspection.problem_pattern import (
    BlockPattern,
    FactorCount,
    ProblemPattern,
    count_dense,
    count_factor,
)
from bundle.solving.slices.scratch_size import RESIDENT_BYTES, scratch_bytes

Terms = dict[str, float]
"""Bytes by purpose."""

ON_DISK = ("plan of the points", "points", "sorting")
"""Terms of the fused backend that `--out-of-core` keeps in files."""

DOUBLE = 8

# Memory that libraries (such as BLAS and LAPACK) and the heap take on first use.
_PROCESS, _BLAS_PAGES = 0.9e6, 0.5e6

# OpenBLAS packs slices of 384 columns over the full width of a matrix.
_PACKED_COLUMNS = 384

# Stored values of CHOLMOD's merged supernodes relative to nnz(L).
_SUPERNODE_PADDING = 1.15

# Number of chunk buffers that each thread of the fused backend uses. A thread has three buffers. It
# uses the third only when it is two chunks ahead of the others (assembler.h): rarely on small
# problems, always on large ones.
_CHUNK_BUFFERS = 2.5

# Observations of a tile (number_chunk.cpp). Each has a Jacobian record of two rows and a factor of
# three rows.
_TILE_OBSERVATIONS = 4096

# Ceres. Per observation: cost function, residual block, Jacobian row with its cells, and pointers
# in the problem, the program and the evaluator. Per point: parameter block with state and manifold,
# and one node each in the problem's map and in the ordering's map and sets.
_CERES_OBSERVATION = 390.0
_CERES_POINT = 820.0
# Implicit Schur products store a second copy of the partitions' rows, and diagonal blocks.
_CERES_IMPLICIT_OBSERVATION = 30.0
_CERES_IMPLICIT_POINT = 120.0
# Four forms of S: cells in a hash map, triplets, compressed columns, CHOLMOD's copy.
_CERES_REDUCED_COPIES = 10.0
# J^T J with its indices, the list of products that form it, and CHOLMOD's reordered copy.
_CERES_NORMAL_COPIES = 2.7


def total(terms: Terms) -> float:
    """Return the sum in bytes."""
    return sum(terms.values())


def fused_memory(
    pattern: ProblemPattern,
    linear_solver_type: str,
    counted: FactorizedSystem | None,
    num_threads: int,
    coarse_entries: float = 0.0,
) -> Terms:
    """Return the memory of a solve by the fused backend; ``counted`` is the factorised system.

    ``coarse_entries``: entries of the factor of the coarse system (TWO_LEVEL).
    """
    plan = pattern.plan
    buffer = plan.largest_chunk_blocks * plan.block_doubles * DOUBLE
    columns = math.sqrt(plan.block_doubles)
    observations = plan.num_observations
    terms = {
        # Image, measurement, places in chunk and tile, and entries of an observation; entries of a
        # pair.
        "plan of the points": (24.0 + 2.0 * plan.num_kinds) * plan.num_observations
        + 4.0 * (plan.num_pairs + plan.num_tile_blocks)
        + 12.0 * plan.num_points
        + 4.0 * (plan.num_chunk_pairs + 2 * plan.num_chunk_parts),
        # Two states, column scales, and refined points.
        "points": 4 * 3 * DOUBLE * plan.num_points,
        # Sorting the observations comes first; its memory is reused later.
        "sorting": 2.0 * plan.num_observations,
        "tiles": DOUBLE * (5 * columns + 8) * num_threads * min(observations, _TILE_OBSERVATIONS),
        "buffers of chunks": _CHUNK_BUFFERS * num_threads * float(buffer),
        "process": _PROCESS,
    }
    if counted is None:
        terms["reduced system"] = DOUBLE * pattern.num_reduced_values
        records = DOUBLE * (2 * columns + 6) * observations
        if plan.num_pairs == 0 and records <= 2**25:  # kept for products with S without S
            terms["kept records"] = records
        if coarse_entries:
            terms["coarse system"] = _BLAS_PAGES + DOUBLE * coarse_entries
    elif linear_solver_type == "DENSE_SCHUR":
        terms["reduced system"] = DOUBLE * counted.values
        terms["BLAS"] = _BLAS_PAGES + DOUBLE * float(_PACKED_COLUMNS) * counted.columns
    else:
        # S is factorised in place.
        terms["reduced system"] = DOUBLE * counted.panel_values
        widest = max(counted.factor.profile, default=0)
        terms["BLAS"] = _BLAS_PAGES + DOUBLE * float(_PACKED_COLUMNS) * widest
    if pattern.reduced.sums_are_double_doubles(linear_solver_type):
        # Error terms of the sums in S, without the fill-in of its factor.
        is_dense = linear_solver_type == "DENSE_SCHUR"
        values = (
            float(pattern.reduced.num_columns) ** 2 / 2 if is_dense else pattern.num_reduced_values
        )
        terms["rounding of S"] = DOUBLE * values
    return terms


def ceres_memory(
    pattern: ProblemPattern, linear_solver_type: str, counted: FactorizedSystem | None
) -> Terms:
    """Return the memory of a solve by Ceres; ``counted`` is the factorised system."""
    terms = {
        "observations": _CERES_OBSERVATION * pattern.num_observations,
        "points": _CERES_POINT * pattern.num_free_points,
        "Jacobian": float(DOUBLE * pattern.nnz_jacobian),
        "process": _PROCESS + _BLAS_PAGES,
    }
    if counted is None:
        terms["implicit products"] = (
            _CERES_IMPLICIT_OBSERVATION * pattern.num_observations
            + _CERES_IMPLICIT_POINT * pattern.num_free_points
        )
    elif linear_solver_type == "DENSE_SCHUR":
        terms["reduced system"] = DOUBLE * float(counted.columns) ** 2
        terms["BLAS"] = DOUBLE * float(_PACKED_COLUMNS) * counted.columns
    elif linear_solver_type == "SPARSE_SCHUR":
        terms["reduced system"] = DOUBLE * _CERES_REDUCED_COPIES * counted.values
        terms["factor"] = DOUBLE * _SUPERNODE_PADDING * counted.factor.nnz
    else:
        terms["J^T J"] = DOUBLE * _CERES_NORMAL_COPIES * pattern.nnz_information / 2
        terms["factor"] = float(DOUBLE * counted.factor.nnz)
    return terms


# Largest number of entries of the full pattern for which AMD takes only seconds.
MOST_ENTRIES_FOR_AMD = _core.MOST_ENTRIES_FOR_AMD

# Number of pairs of points to collect before duplicates are removed.
CODES_AT_A_TIME = 1 << 22
# Largest number of pairs of covisible points for which the system of the points is counted.
MOST_POINT_PAIRS = 20_000_000


class FactorizedSystem(NamedTuple):
    """System that a method factorises, with the cost of its factor."""

    columns: int  # scalar columns of the factorised matrix
    nnz_reduced: int  # nonzeros of the reduced system; 0 without one
    factor: FactorCount  # cost of the factor
    note: str = ""  # remark on the numbers
    # stored values of the reduced system: its lower triangle, or all of it if dense
    values: float = 0.0
    panel_values: float = 0.0  # stored values of the factor in the fused backend's panels


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


# Memory and disk that a problem of given counts needs: in memory, out of core, in submaps.
#
# Per observation, a solve has the input (pixels, image, point: 24 bytes), and the plan (pixels,
# image, places in chunk, tile and list: 26 bytes, and 4 for each pair of a point, (T - 1) / 2 of
# them, with a tenth more for the lists of blocks). Per point, it has the input, two states, scales,
# the output, an id and places: 132 bytes (cpp/core/schur/elimination_plan.h). Measured: 79 bytes an
# observation in memory and 81 on disk, at T = 6 (benchmarks/large_problems.md).
#
# Images add S. Each image shares points with T - 1 others or more, so that S has at least T blocks
# per image, each with its rounding errors; with the factor, 16 bytes per number.
#
# The fused backend numbers residuals by 31 bits. A larger problem is divided into submaps. The
# images between submaps are their separator. Eliminating all else leaves a dense system of the
# separator, exactly (`refine --only-images --rest marginal`). So the memory bounds the images of a
# separator.
#
# ``schur_counts`` is the estimate of lectures and papers of the flops with and without eliminating
# the points first, for n_c cameras of 6 unknowns, n_p points of 3 unknowns and a dense S. It gives
# orders of magnitude, not instructions. A product of m x k and k x n matrices counts m k n, the
# inverse of a 3 x 3 block 3^3, a Cholesky factorisation of n columns n^3 / 3.
#
#     points    V_p^-1 for each point: 27 n_p
#     products  W_ip V_p^-1 W_jp^T for each point p and each ordered pair of cameras (i, j) that see
#               it, also for i = j: 162 = 6 3 3 + 6 3 6 per product. A point that d cameras see has
#               d^2 products; they share no factors
#     reduced   Cholesky of S: (6 n_c)^3 / 3
#     dense     Cholesky of all 6 n_c + 3 n_p unknowns at once, for comparison
#
# ``inspect`` counts the work of solvers: the pattern of S, an elimination order, one triangle.

MOST_OBSERVATIONS = (2**31 - 1) // 2
"""Observations of one solve (``RefuseTooLarge`` in cpp/core/prepare/prepare.cpp)."""

_COLUMNS = 9  # of an image with a camera of its own
_SECONDS = 0.2e-6
"""Processor time of an observation in a step out of core (benchmarks/large_problems.md)."""


@dataclass(frozen=True, kw_only=True)
class ProblemNeeds:
    """Needs of a problem."""

    num_observations: int  # number of observations
    memory_in_bytes: float  # observations and points of a solve in memory
    system_in_bytes: float  # least size of S with its factor
    num_submaps: int  # least number of solves, each within the limit of observations
    disk_in_bytes: float  # scratch files of one submap out of core
    resident_in_bytes: float  # memory of one submap out of core, with its share of S
    processor_seconds_per_step: float  # of all submaps, on the machine of the benchmark
    most_separator_images: int  # images whose dense system fits into the free memory


def needs_of(
    num_images: int, num_points: int, num_observations: int, free_memory: float
) -> ProblemNeeds:
    """Return the needs of a problem with these counts on a machine with this free memory."""
    track = num_observations / max(num_points, 1)
    submaps = max(1, math.ceil(num_observations / MOST_OBSERVATIONS))
    system = 16.0 * num_images * track * _COLUMNS**2
    return ProblemNeeds(
        num_observations=num_observations,
        memory_in_bytes=scratch_bytes(num_observations, num_points),
        system_in_bytes=system,
        num_submaps=submaps,
        disk_in_bytes=scratch_bytes(num_observations // submaps, num_points // submaps),
        resident_in_bytes=RESIDENT_BYTES + system / submaps,
        processor_seconds_per_step=_SECONDS * num_observations,
        most_separator_images=int(math.sqrt(SHARE_OF_FREE_MEMORY * free_memory / 8) / _COLUMNS),
    )


CAMERA_SIZE, POINT_SIZE = 6, 3


@dataclass(frozen=True)
class SchurCounts:
    """Textbook flops of one linear solve."""

    num_unknowns: int  # unknowns of cameras and points
    num_reduced_unknowns: int  # rows and columns of S
    num_block_products: int  # products W V^-1 W^T, one per ordered pair of cameras and point
    points: float  # flops of inverting the points' blocks
    products: float  # flops of the block products
    reduced: float  # flops of factorising S
    dense: float  # flops of factorising the dense matrix of all unknowns

    @property
    def schur(self) -> float:
        """Flops with the points eliminated first."""
        return self.points + self.products + self.reduced


def count_schur(num_cameras: int, num_points: int, track_length: int) -> SchurCounts:
    """Count flops for points that are all seen by the same number of cameras."""
    num_reduced = CAMERA_SIZE * num_cameras
    num_unknowns = num_reduced + POINT_SIZE * num_points
    num_products = track_length**2 * num_points
    product = CAMERA_SIZE * POINT_SIZE**2 + CAMERA_SIZE**2 * POINT_SIZE
    return SchurCounts(
        num_unknowns=num_unknowns,
        num_reduced_unknowns=num_reduced,
        num_block_products=num_products,
        points=float(POINT_SIZE**3 * num_points),
        products=float(product * num_products),
        reduced=num_reduced**3 / 3,
        dense=num_unknowns**3 / 3,
    )
