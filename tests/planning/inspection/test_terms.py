"""The terms of predicted memory and work, each from counts that are made up."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from bundle.planning.inspection.peak_memory import FactorizedSystem, ceres_memory, fused_memory
from bundle.planning.inspection.problem_pattern import FactorCount, PlanSize
from bundle.planning.inspection.problem_time import (
    ceres_work,
    factor_work,
    fused_work,
    products_per_step,
)

PLAN = PlanSize(
    num_points=100,
    num_observations=1000,
    num_pairs=5000,
    num_kinds=2,
    num_tile_blocks=300,
    num_chunk_pairs=40,
    num_chunk_parts=10,
    largest_chunk_blocks=7,
    block_doubles=108,
)
PATTERN = SimpleNamespace(
    plan=PLAN,
    num_observations=1000,
    num_free_points=100,
    nnz_jacobian=24_000,
    nnz_information=50_000,
    num_reduced_values=9000.0,
    reduced=SimpleNamespace(
        num_columns=60, sums_are_double_doubles=lambda solver: solver != "ITERATIVE_SCHUR"
    ),
    pair_entries=70_000.0,
    block_pairs=3000,
    has_equal_blocks=True,
)
FACTOR = FactorCount(
    nnz=6000, fill=0, flops=4e6, cholmod_flops=0, tree_height=1, profile=(30, 50, 20)
)
COUNTED = FactorizedSystem(60, 3000, FACTOR, values=3600.0, panel_values=7000.0)


def test_memory_of_the_fused_backend():
    expected = {
        "plan of the points": 28 * 1000 + 4 * (5000 + 300) + 12 * 100 + 4 * (40 + 2 * 10),
        "points": 4 * 3 * 8 * 100,  # four arrays of three doubles
        "sorting": 2 * 1000,
        "tiles": 8 * (5 * 108**0.5 + 8) * 3 * 1000,
        "buffers of chunks": 2.5 * 3 * (7 * 108 * 8),
        "process": 0.9e6,
    }
    dense = {"reduced system": 8 * 3600, "BLAS": 0.5e6 + 8 * 384 * 60, "rounding of S": 8 * 1800}
    sparse = {"reduced system": 8 * 7000, "BLAS": 0.5e6 + 8 * 384 * 50, "rounding of S": 8 * 9000}
    assert fused_memory(PATTERN, "DENSE_SCHUR", COUNTED, 3) == pytest.approx(expected | dense)
    assert fused_memory(PATTERN, "SPARSE_SCHUR", COUNTED, 3) == pytest.approx(expected | sparse)
    iterative = {"reduced system": 8 * 9000}
    assert fused_memory(PATTERN, "ITERATIVE_SCHUR", None, 3) == pytest.approx(expected | iterative)
    coarse = {**iterative, "coarse system": 0.5e6 + 8 * 500}
    found = fused_memory(PATTERN, "ITERATIVE_SCHUR", None, 3, 500)
    assert found == pytest.approx(expected | coarse)


def test_memory_of_ceres():
    expected = {
        "observations": 390 * 1000,
        "points": 820 * 100,
        "Jacobian": 8 * 24_000,
        "process": 1.4e6,
    }
    of_solver = {
        "DENSE_SCHUR": {"reduced system": 8 * 60**2, "BLAS": 8 * 384 * 60},
        "SPARSE_SCHUR": {"reduced system": 8 * 10 * 3600, "factor": 8 * 1.15 * 6000},
        "SPARSE_NORMAL_CHOLESKY": {"J^T J": 8 * 2.7 * 50_000 / 2, "factor": 8 * 6000},
    }
    for solver, terms in of_solver.items():
        assert ceres_memory(PATTERN, solver, COUNTED) == pytest.approx(expected | terms)
    implicit = {"implicit products": 30 * 1000 + 120 * 100}
    assert ceres_memory(PATTERN, "ITERATIVE_SCHUR", None) == pytest.approx(expected | implicit)


@pytest.mark.parametrize(
    ("preconditioner", "products"),
    [("SCHUR_JACOBI", 200), ("SCHUR_POWER_SERIES_EXPANSION", 1200), ("TWO_LEVEL", 80)],
)
def test_work_of_conjugate_gradients(preconditioner, products):
    coarse = 500 if preconditioner == "TWO_LEVEL" else 0
    assert products_per_step(preconditioner) == products
    fused = fused_work(PATTERN, "ITERATIVE_SCHUR", None, 1, products, coarse)
    # Each reads S and, to and fro, the coarse factor.
    assert fused["conjugate gradients"] == {"reduced_byte": products * 8 * (9000 + 2 * coarse)}
    ceres = ceres_work(PATTERN, "ITERATIVE_SCHUR", None, 1, products)
    assert ceres["conjugate gradients"] == {"ceres_product": products * 1000}  # 9 + 3 columns


def test_work_of_a_direct_step():
    assert fused_work(PATTERN, "SPARSE_SCHUR", COUNTED, 1) == {
        "observations": {"fused_observation": 1000},
        "pairs of observations": {"fused_pair": 5000},
        "other": {"fused_step": 1},
        "factorisation": {"flop": 4e6, "sparse_entry": 6000},
    }
    of_evaluation = {"evaluation": {"ceres_evaluation": 1000}, "other": {"ceres_step": 1}}
    assert ceres_work(PATTERN, "SPARSE_NORMAL_CHOLESKY", COUNTED, 1) == of_evaluation | {
        "normal equations": {"ceres_normal_entry": 70_000},
        "factorisation": {"flop": 4e6 - 6 * 70_000},
    }
    assert ceres_work(PATTERN, "SPARSE_SCHUR", COUNTED, 1) == of_evaluation | {
        "elimination": {"ceres_elimination": 1000, "ceres_pair": 3000},
        "reduced system": {"ceres_reduced_value": 3600},
        "factorisation": {"flop": 4e6, "sparse_entry": 6000},
    }
    dynamic = SimpleNamespace(**{**vars(PATTERN), "has_equal_blocks": False})
    found = ceres_work(dynamic, "DENSE_SCHUR", COUNTED, 1)
    assert found["elimination"] == {"ceres_elimination": 1000, "ceres_dynamic_pair": 3000}
    assert found["factorisation"] == {"flop": 4e6, "dense_entry": 6000}


@pytest.mark.parametrize(("megabytes", "is_scattered"), [(7.9, False), (8.1, True)])
def test_beyond_the_caches_pairs_are_scattered(megabytes, is_scattered):
    counted = COUNTED._replace(panel_values=megabytes * 1e6 / 8)
    work = fused_work(PATTERN, "SPARSE_SCHUR", counted, 1)
    expected = {"fused_scattered_pair": 40, "reduced_byte": pytest.approx(megabytes * 1e6)}
    assert work.get("adding to S") == (expected if is_scattered else None)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("columns", [999, 1000])
def test_blas_threads_pay_from_a_thousand_columns(columns, threads):
    dense = {"flop": 4e6, "dense_entry": 6000}
    threaded = {"threaded_flop": 4e6, "threaded_entry": 6000}
    is_threaded = columns == 1000 and threads == 2
    assert factor_work(True, columns, FACTOR, threads) == (threaded if is_threaded else dense)
    # Of a sparse factor the average column counts.
    wide = FactorCount(
        nnz=10, fill=0, flops=10.0 * columns, cholmod_flops=0, tree_height=1, profile=()
    )
    entries = "threaded_entry" if is_threaded else "dense_entry"
    found = factor_work(False, 1, wide, threads)
    assert found[entries if columns == 1000 else "sparse_entry"] == 10
    assert found["threaded_flop" if is_threaded else "flop"] == 10 * columns
