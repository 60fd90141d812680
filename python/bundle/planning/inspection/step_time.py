"""Time of a trust region step as a sum of named terms: counts multiplied by measured rates."""

from __future__ import annotations

import math

from bundle.planning.inspection.counts import FactorizedSystem
from bundle.planning.inspection.peak_memory import Terms
from bundle.planning.inspection.problem_pattern import FactorCount, ProblemPattern
from bundle.planning.inspection.rates import FactorRate, Rates

PRODUCTS_PER_STEP, PRODUCTS_WITH_TWO_LEVELS = 200, 80
"""Assumed products with S per step by conjugate gradients. Measurements range from 2 to 500,
most of them in late steps; with two levels from 2 to 100 (cpp/core/prepare/choose_solver.cpp).
"""

# Coarse system of TWO_LEVEL: seconds to form it per value of S and thread, and nnz of its factor
# relative to nnz(L). Both as in choose_solver.cpp.
_SECONDS_PER_COARSE_VALUE, COARSE_FACTOR_SHARE = 10e-9, 0.05

_MOST_PASSES, _PASSES_OF_FULL_SYSTEM = 240.0, 30.0
"""Assumed passes over the observations per step without S, as in choose_solver.cpp."""
_TIME_OF_A_PASS = 2.5
"""Time of such a pass relative to that of linearising and evaluating the observations (measured
with 72,000 observations of 900 images)."""

POWER_SERIES_PRODUCTS = 6
"""Products of one iteration with the power series as preconditioner."""

# Blocks that the rates assume: 9 camera parameters, 9 x 12 doubles in chunks.
_COLUMNS, _BLOCK_DOUBLES = 9, 108

# Size from which S does not fit into the caches.
_CACHED_BYTES = 8e6

# Size from which factorisations use BLAS threads: columns of a dense matrix, or entries of the
# average column of a sparse factor (cpp/core/parallel/blas.h, linear/direct_solvers.cpp).
_COLUMNS_WORTH_THREADS = 1000


def factor_rate(rates: Rates, is_dense: bool, num_columns: int, count: FactorCount) -> FactorRate:
    """Return the rate of a factorisation of this kind and size."""
    if is_dense:
        return rates.dense_threaded if num_columns >= _COLUMNS_WORTH_THREADS else rates.dense
    wide = count.flops >= _COLUMNS_WORTH_THREADS * count.nnz
    return rates.dense_threaded if wide else rates.sparse


def fused_time(
    pattern: ProblemPattern,
    linear_solver_type: str,
    preconditioner: str,
    counted: FactorizedSystem | None,
    rates: Rates,
    coarse_entries: float = 0.0,
) -> Terms:
    """Return the time of a step by the fused backend; ``counted`` is the factorised system.

    ``coarse_entries``: entries of the factor of the coarse system (TWO_LEVEL).
    """
    plan = pattern.plan
    block = plan.block_doubles / _BLOCK_DOUBLES
    is_dense = linear_solver_type == "DENSE_SCHUR"
    if counted is None:
        values = pattern.num_reduced_values
    else:
        values = counted.values if is_dense else counted.panel_values
    terms = {
        "observations": rates.fused_observation * math.sqrt(block) * plan.num_observations,
        "pairs of observations": rates.fused_pair * block * plan.num_pairs,
        "other": rates.fused_step,
    }
    if 8 * values > _CACHED_BYTES:
        terms["adding to S"] = rates.fused_scattered_pair * block * plan.num_chunk_pairs
        terms["adding to S"] += 8 * values / rates.reduced_bytes_per_second  # zeroing S
    if counted is not None:
        rate = factor_rate(rates, is_dense, counted.columns, counted.factor)
        terms["factorisation"] = rate.seconds(counted.factor.flops, counted.factor.nnz)
    else:
        read = 8 * (values + 2 * coarse_entries)
        terms["conjugate gradients"] = (
            products_per_step(preconditioner) * read / rates.reduced_bytes_per_second
        )
        if coarse_entries:
            seconds = _SECONDS_PER_COARSE_VALUE * values / rates.num_threads
            terms["coarse system"] = seconds
    return terms


def implicit_time(pattern: ProblemPattern, rates: Rates) -> Terms:
    """Return the time of a step by conjugate gradients without S."""
    plan = pattern.plan
    block = plan.block_doubles / _BLOCK_DOUBLES
    linearise = rates.fused_observation * math.sqrt(block) * plan.num_observations
    return {
        "observations": linearise,
        "conjugate gradients": passes_per_step(pattern) * _TIME_OF_A_PASS * linearise,
        "other": rates.fused_step,
    }


def ceres_time(
    pattern: ProblemPattern,
    linear_solver_type: str,
    preconditioner: str,
    counted: FactorizedSystem | None,
    rates: Rates,
) -> Terms:
    """Return the time of a step by Ceres; ``counted`` is the factorised system or None."""
    observations = pattern.num_observations
    width = (pattern.nnz_jacobian / (2 * max(observations, 1))) / (3 + _COLUMNS)
    terms = {
        "evaluation": rates.ceres_evaluation * width * observations,
        "other": rates.ceres_step,
    }
    if counted is not None and linear_solver_type == "SPARSE_NORMAL_CHOLESKY":
        terms["normal equations"] = rates.ceres_normal_entry * pattern.pair_entries
        updates = 3 * 2 * pattern.pair_entries  # the rate above includes the points' columns
        flops = max(counted.factor.flops - updates, 0.0)
        terms["factorisation"] = flops / rates.sparse.flops_per_second
        return terms
    pair = rates.ceres_pair if pattern.has_equal_blocks else rates.ceres_dynamic_pair
    terms["elimination"] = (
        rates.ceres_elimination * width * observations + pair * pattern.block_pairs
    )
    if counted is None:
        products = products_per_step(preconditioner) * observations
        terms["conjugate gradients"] = rates.ceres_product * width * products
        return terms
    if linear_solver_type == "SPARSE_SCHUR":
        terms["reduced system"] = rates.ceres_reduced_value * counted.values
    is_dense = linear_solver_type == "DENSE_SCHUR"
    rate = factor_rate(rates, is_dense, counted.columns, counted.factor)
    terms["factorisation"] = rate.seconds(counted.factor.flops, counted.factor.nnz)
    return terms


def passes_per_step(pattern: ProblemPattern) -> float:
    """Return the assumed number of products without S per step, as ``choose_solver.cpp``."""
    columns = float(max(pattern.num_camera_columns, 1))
    density = min(2 * pattern.num_reduced_values / columns**2, 1.0)
    return min(_MOST_PASSES, _PASSES_OF_FULL_SYSTEM / density)


def products_per_step(preconditioner: str) -> int:
    """Return the assumed number of products with S per step."""
    if preconditioner == "TWO_LEVEL":
        return PRODUCTS_WITH_TWO_LEVELS
    is_series = preconditioner == "SCHUR_POWER_SERIES_EXPANSION"
    return PRODUCTS_PER_STEP * (POWER_SERIES_PRODUCTS if is_series else 1)
