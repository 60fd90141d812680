"""Predictions before a comparison, and their methods."""

import dataclasses
import math

import bundle
from bundle.base.tables import render
from bundle.base.words import number
from bundle.interface.options import SolveOptions
from bundle.planning.comparison.compare_methods import compare
from bundle.planning.comparison.measured_run import expand
from bundle.planning.comparison.work import foresee, predict, taken_by_auto
from bundle.reports.terminal.compare import compared
from bundle.reports.terminal.screen import laid_out
from tests.planning.comparison.fakes import CERES, DENSE, ITERATIVE, SPARSE, prediction
from tests.scenes import make_problem

PROBLEM = make_problem(num_images=8, num_points=100, model="RADIAL")
OPTIONS = SolveOptions()
METHODS = expand(
    solvers=["dense_schur", "sparse_schur", "iterative_schur", "dense_qr"],
    preconditioners=["auto", "jacobi"],
    orderings=["points_first", "cameras_first", "automatic"],
    threads=[1],
)


def test_each_method_has_its_own_prediction():
    found = {method.name: known for method, known in predict(PROBLEM, OPTIONS, METHODS).items()}
    inspected = {
        (one.backend.lower(), one.name): one
        for one in bundle.inspect(PROBLEM, OPTIONS, num_threads=1).methods
    }
    for name, key in {
        "fused DENSE_SCHUR": ("fused", "DENSE_SCHUR natural"),
        "ceres DENSE_SCHUR": ("ceres", "DENSE_SCHUR natural"),
        "ceres SPARSE_SCHUR": ("ceres", "SPARSE_SCHUR amd"),
        "ceres SPARSE_SCHUR cameras first": ("ceres", "SPARSE_SCHUR cameras_first"),
        "fused ITERATIVE_SCHUR": ("fused", "ITERATIVE_SCHUR two_level"),
        "ceres ITERATIVE_SCHUR JACOBI": ("ceres", "ITERATIVE_SCHUR jacobi"),
    }.items():
        assert found[name].time_per_step_in_seconds == inspected[key].time_per_step_in_seconds
        assert found[name].nnz_factor == inspected[key].nnz_factor
        assert found[name].memory_in_bytes == inspected[key].memory_in_bytes
    (taken,) = (
        one
        for (backend, name), one in inspected.items()
        if backend == "fused" and name.startswith("SPARSE_SCHUR") and one.is_taken
    )
    assert found["fused SPARSE_SCHUR"].flops == taken.flops
    assert found["fused SPARSE_SCHUR"].ordering == taken.ordering
    assert not any("DENSE_QR" in name or "automatic" in name for name in found)
    dense = found["fused DENSE_SCHUR"]
    assert dense.num_unknowns == 8 * 6 + 8 * 3 - 7  # two cameras hold the gauge
    assert 0 < dense.nnz_reduced <= dense.num_unknowns**2


def test_options_that_inspection_refuses_leave_no_prediction():
    assert predict(PROBLEM, OPTIONS.replace(refine=()), METHODS) == {}


def test_predicted_stands_beside_measured():
    comparison = compare(
        PROBLEM, solvers=["dense_schur"], backends=["fused"], threads=[1], repeat=1,
        trust_regions=["levenberg_marquardt"],
    )  # fmt: skip
    (run,) = comparison.runs
    rows = [line.split() for line in render(*laid_out(compared(comparison), True)).splitlines()]
    nnz, flops = number(run.prediction.nnz_factor), number(run.prediction.flops)
    # After the two words of the name: L, flops, time and memory, each predicted and measured.
    (row,) = (row for row in rows if row[2:4] == [nnz, flops])
    assert row[4:6] == [
        number(run.prediction.time_per_step_in_seconds),
        number(run.measurement.time_per_step_in_seconds),
    ]
    assert row[6] == number(run.prediction.memory_in_bytes / 1e6)
    assert comparison.recommendation.foreseen == (run.method,)
    assert "right" in comparison.recommendation.verdict


def test_least_predicted_time_that_fits_is_foreseen():
    methods = (DENSE, SPARSE, ITERATIVE, CERES)
    predictions = {
        DENSE: prediction(time_per_step_in_seconds=2.0),
        SPARSE: prediction(time_per_step_in_seconds=1.0, fits_in_memory=False),
        ITERATIVE: prediction(time_per_step_in_seconds=math.nan),
        CERES: prediction(time_per_step_in_seconds=3.0),
    }
    assert foresee(PROBLEM, OPTIONS, methods, predictions) == DENSE
    assert foresee(PROBLEM, OPTIONS, (SPARSE, CERES), predictions) == CERES
    predictions[DENSE] = prediction(time_per_step_in_seconds=2.0, memory_in_bytes=9e6)
    assert foresee(PROBLEM, OPTIONS, methods, predictions, 8_500_000) == CERES
    assert foresee(PROBLEM, OPTIONS, methods, predictions, 9_000_000) == DENSE


def test_without_predictions_auto_is_asked():
    one, ceres = (dataclasses.replace(method, num_threads=1) for method in (DENSE, CERES))
    assert taken_by_auto(PROBLEM, OPTIONS, 1) == one
    assert foresee(PROBLEM, OPTIONS, (ceres, one), {}) == one
    assert foresee(PROBLEM, OPTIONS, (one, DENSE, ceres), {}) == DENSE  # with the most threads
    assert foresee(PROBLEM, OPTIONS, (ceres,), {}) is None
    assert taken_by_auto(PROBLEM, OPTIONS.replace(fixed_image_ids=(99,)), 1) is None
