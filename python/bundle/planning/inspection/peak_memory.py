"""Peak memory of a solve beyond the loaded problem, as a sum of named terms.

Arrays are counted as the sources allocate them. Ceres stores a problem in many small objects; their
bytes per observation and per point were measured (glibc, Ceres 2.1) and agree within 7 % on all
real data and on synthetic scenes of 50 to 1000 images.
"""

from __future__ import annotations

import math

from bundle.planning.inspection.counts import FactorizedSystem
from bundle.planning.inspection.problem_pattern import ProblemPattern

Terms = dict[str, float]
"""Bytes by purpose."""

ON_DISK = ("plan of the points", "points", "sorting")
"""Terms of the fused backend that `--out-of-core` keeps in files."""

DOUBLE = 8

# Pages of libraries on first use (BLAS and LAPACK among them), and of the heap.
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
