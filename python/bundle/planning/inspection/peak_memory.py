"""Peak memory of a solve beyond the loaded problem, as a sum of named terms.

Arrays are counted as the sources make them. What is not an array but many small objects, which is
how Ceres keeps a problem, was measured (glibc, Ceres 2.1): bytes per observation and per point, the
same on all real data and on synthetic scenes of 50 to 1000 images to 7 per cent.
"""

from __future__ import annotations

from bundle.planning.inspection.counts import FactorizedSystem
from bundle.planning.inspection.problem_pattern import ProblemPattern

__all__ = ["Terms", "ceres_memory", "fused_memory", "total"]

Terms = dict[str, float]
"""Bytes by what they are for."""

DOUBLE = 8

# Pages of libraries that run for the first time, and the heap's own; BLAS and LAPACK among them.
_PROCESS, _BLAS_PAGES = 0.9e6, 0.5e6

# OpenBLAS packs slices of 384 columns of a matrix, as wide as the matrix.
_PACKED_COLUMNS = 384

# Zeros that CHOLMOD's supernodes store besides the entries of L, merged where it pays.
_SUPERNODE_PADDING = 1.15

# Buffers of chunks that each thread of the fused backend fills. It has three, and takes the last of
# them only when it is two chunks ahead of the others (assembler.h): small problems seldom, large
# ones always.
_CHUNK_BUFFERS = 2.5

# Ceres. An observation: the cost function and its residual block, the row of the Jacobian with its
# cells, pointers in the problem, the program and the evaluator. A point: its parameter block with
# state and manifold, and a node each in the problem's map and in the ordering's map and sets.
_CERES_OBSERVATION = 390.0
_CERES_POINT = 820.0
# Implicit Schur products keep a row of the partitions a second time, and blocks of the diagonal.
_CERES_IMPLICIT_OBSERVATION = 30.0
_CERES_IMPLICIT_POINT = 120.0
# S by cells behind a hash map, then as triplets, as compressed columns, and as CHOLMOD's copy.
_CERES_REDUCED_COPIES = 10.0
# J^T J with its indices, the list of products that make it, and CHOLMOD's copy in its order.
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
    """Return what a solve by the fused backend takes; ``counted`` is what it factorises.

    ``coarse_entries``: of the factor of a second level.
    """
    plan = pattern.plan
    buffer = plan.largest_chunk_blocks * plan.block_doubles * DOUBLE
    terms = {
        # Image, measurement and place in the chunk of an observation; place of a pair's block.
        "plan of the points": 22.0 * plan.num_observations
        + 2.0 * plan.num_pairs
        + 12.0 * plan.num_points
        + 4.0 * (plan.num_chunk_pairs + 2 * plan.num_chunk_images),
        # Two states, the scale of their columns, and the refined points.
        "points": 4 * 3 * DOUBLE * plan.num_points,
        # Sorting the points' observations comes first; later the same memory holds other things.
        "sorting": 2.0 * plan.num_observations,
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
        # S becomes its factor where it is.
        terms["reduced system"] = DOUBLE * counted.panel_values
        widest = max(counted.factor.profile, default=0)
        terms["BLAS"] = _BLAS_PAGES + DOUBLE * float(_PACKED_COLUMNS) * widest
    if pattern.reduced.sums_are_twofold(linear_solver_type):
        # What rounding takes from each number of S, without the fill of its factor.
        is_dense = linear_solver_type == "DENSE_SCHUR"
        values = (
            float(pattern.reduced.num_columns) ** 2 / 2 if is_dense else pattern.num_reduced_values
        )
        terms["rounding of S"] = DOUBLE * values
    return terms


def ceres_memory(
    pattern: ProblemPattern, linear_solver_type: str, counted: FactorizedSystem | None
) -> Terms:
    """Return what a solve by Ceres takes; ``counted`` is what it factorises."""
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
