"""Memory and disk that a problem of given counts needs: in memory, out of core, in submaps.

Per observation, a solve has the input (pixels, image, point: 24 bytes), and the plan (pixels,
image, places in chunk, tile and list: 26 bytes, and 4 for each pair of a point, (T - 1) / 2 of
them, with a tenth more for the lists of blocks). Per point, it has the input, two states, scales,
the output, an id and places: 132 bytes (cpp/core/schur/elimination_plan.h). Measured: 79 bytes an
observation in memory and 81 on disk, at T = 6 (benchmarks/large_problems.md).

Images add S. Each image shares points with T - 1 others or more, so that S has at least T blocks
per image, each with its rounding errors; with the factor, 16 bytes per number.

The fused backend numbers residuals by 31 bits. A larger problem is divided into submaps. The images
between submaps are their separator. Eliminating all else leaves a dense system of the separator,
exactly (`refine --only-images --rest marginal`). So the memory bounds the images of a separator.

``schur_counts`` is the estimate of lectures and papers of the flops with and without eliminating
the points first, for n_c cameras of 6 unknowns, n_p points of 3 unknowns and a dense S. It gives
orders of magnitude, not instructions. A product of m x k and k x n matrices counts m k n, the
inverse of a 3 x 3 block 3^3, a Cholesky factorisation of n columns n^3 / 3.

    points    V_p^-1 for each point: 27 n_p
    products  W_ip V_p^-1 W_jp^T for each point p and each ordered pair of cameras (i, j) that see
              it, also for i = j: 162 = 6 3 3 + 6 3 6 per product. A point that d cameras see has
              d^2 products; they share no factors
    reduced   Cholesky of S: (6 n_c)^3 / 3
    dense     Cholesky of all 6 n_c + 3 n_p unknowns at once, for comparison

``inspect`` counts the work of solvers: the pattern of S, an elimination order, one triangle.
"""

from __future__ import annotations

import math

from bundle.base.records import dataclass
from bundle.base.words import SHARE_OF_FREE_MEMORY
from bundle.solving.slices.scratch_size import RESIDENT_BYTES, scratch_bytes

MOST_OBSERVATIONS = (2**31 - 1) // 2
"""Observations of one solve (``RefuseTooLarge`` in cpp/core/prepare/prepare.cpp)."""

_COLUMNS = 9  # of an image with a camera of its own
_SECONDS = 0.2e-6
"""Processor time of an observation in a step out of core (benchmarks/large_problems.md)."""


@dataclass(frozen=True, kw_only=True)
class ProblemNeeds:
    """Needs of a problem.

    Attributes:
        num_observations: number of observations.
        memory_in_bytes: observations and points of a solve in memory.
        system_in_bytes: least size of S with its factor.
        num_submaps: least number of solves, each within the limit of observations.
        disk_in_bytes: scratch files of one submap out of core.
        resident_in_bytes: memory of one submap out of core, with its share of S.
        processor_seconds_per_step: of all submaps, on the machine of the benchmark.
        most_separator_images: images whose dense system fits into the free memory.
    """

    num_observations: int
    memory_in_bytes: float
    system_in_bytes: float
    num_submaps: int
    disk_in_bytes: float
    resident_in_bytes: float
    processor_seconds_per_step: float
    most_separator_images: int


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
    """Textbook flops of one linear solve.

    Attributes:
        num_unknowns: unknowns of cameras and points.
        num_reduced_unknowns: rows and columns of S.
        num_block_products: products W V^-1 W^T, one per ordered pair of cameras and point.
        points: flops of inverting the points' blocks.
        products: flops of the block products.
        reduced: flops of factorising S.
        dense: flops of factorising the dense matrix of all unknowns.
    """

    num_unknowns: int
    num_reduced_unknowns: int
    num_block_products: int
    points: float
    products: float
    reduced: float
    dense: float

    @property
    def schur(self) -> float:
        """Flops with the points eliminated first."""
        return self.points + self.products + self.reduced


def count_schur(num_cameras: int, num_points: int, track_length: int) -> SchurCounts:
    """Count flops for points that are seen by the same number of cameras each."""
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
