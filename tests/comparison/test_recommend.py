"""What is recommended, and why, of runs whose times and costs are known."""

import dataclasses
import math

import numpy as np
import pytest

from bundle.comparison import Method
from bundle.comparison.recommend import COST_TOLERANCE, recommend
from tests.comparison.fakes import (
    CERES,
    DENSE,
    ITERATIVE,
    SPARSE,
    comparison,
    done,
    failed,
    measurement,
    prediction,
)


def test_the_fastest_of_those_that_reached_the_best_cost():
    found = recommend(
        comparison(
            done(DENSE, total=3.0),
            done(SPARSE, total=2.0, cost=100 * (1 + 0.5 * COST_TOLERANCE)),
            done(ITERATIVE, total=1.0, cost=100 * (1 + 2 * COST_TOLERANCE)),
            failed(CERES),
        )
    )
    assert found.method == SPARSE
    assert "DENSE_SCHUR pays 1.50 times that" in found.reason
    assert "ITERATIVE_SCHUR pays 0.50 times that and ends 2.0e-03 above the best" in found.reason
    assert "ceres DENSE_SCHUR has no result (timed out)" in found.reason
    assert found.command == (
        "bundle refine 'scene 0.txt' -o OUTPUT --backend fused --solver sparse-schur --threads 2"
    )


def test_reason_from_the_matrix():
    sparse = done(SPARSE, prediction=prediction())
    dense = done(DENSE, total=3.1, prediction=prediction(ordering="", flops=3.3e8))
    assert recommend(comparison(sparse, dense)).reason == (
        "fused SPARSE_SCHUR: S (1000 columns) is 14 % full, AMD makes 2.1e+09 flops a step; "
        "the solve takes 1 s; DENSE_SCHUR pays 3.10 times that."
    )
    dense = done(DENSE, total=0.05, prediction=prediction(flops=3.3e8, nnz_reduced=1e6))
    assert recommend(comparison(sparse, dense)).reason == (
        "fused DENSE_SCHUR: S (1000 columns) is 100 % full, its dense factorisation makes "
        "3.3e+08 flops a step; the solve takes 50 ms; SPARSE_SCHUR pays 20 times that."
    )
    nothing = prediction(nnz_factor=0, flops=0, ordering="")
    iterative = done(ITERATIVE, total=0.5, prediction=nothing)
    assert "a factorisation would make 2.1e+09 flops a step, conjugate gradients take 4 iterat" in (
        recommend(comparison(sparse, iterative)).reason
    )


def test_reason_without_a_prediction():
    found = recommend(comparison(done(DENSE)))
    assert found.reason == (
        "fused DENSE_SCHUR: the linear solver takes 25 % of the time; the solve takes 1 s."
    )


def test_threads_and_preconditioners_are_told_apart():
    one = dataclasses.replace(ITERATIVE, num_threads=1)
    identity = dataclasses.replace(ITERATIVE, preconditioner_type="identity")
    reason = recommend(comparison(done(ITERATIVE), done(one, 1.8), done(identity, 2.5))).reason
    assert reason.endswith("; 1 thread pays 1.80 times that, IDENTITY pays 2.50 times that.")


@pytest.mark.parametrize(
    ("foreseen", "words"),
    [
        (DENSE, "fused DENSE_SCHUR on 2 threads was foreseen before any solve, which was right."),
        (SPARSE, "which was right: it takes 1.10 times as long as the fastest."),
        (ITERATIVE, "which was wrong: it takes 1.20 times as long as the fastest."),
        (CERES, "which was wrong: it did not reach the best cost."),
        (None, ""),
    ],
)
def test_verdict_on_what_was_foreseen(foreseen, words):
    runs = (done(DENSE), done(SPARSE, 1.1), done(ITERATIVE, 1.2), failed(CERES))
    verdict = recommend(comparison(*runs), [foreseen]).verdict
    assert verdict.endswith(words)
    assert bool(verdict) == bool(words)


def test_several_problems():
    runs = [
        done(DENSE, 1.0), done(SPARSE, 2.0), done(ITERATIVE, 0.5),
        done(DENSE, 9.0, problem=1), done(SPARSE, 2.0, problem=1), failed(ITERATIVE, problem=1),
        done(DENSE, 1.0, problem=2), done(SPARSE, 1.0, problem=2), done(ITERATIVE, 2, problem=2),
    ]  # fmt: skip
    found = recommend(comparison(*runs), [DENSE, SPARSE, None])
    assert found.method == SPARSE  # all solved, ratios 4 1 1; dense 2 4.5 1
    assert found.reason == (
        "fused SPARSE_SCHUR: the fastest on 2 of 3 problems, at worst 4.00 times the fastest."
    )
    assert found.command.startswith("bundle refine INPUT -o OUTPUT")
    assert found.verdict == (
        "Foreseen before any solve, and within 15 % of the fastest: 1 of 2 problems."
    )


def test_nothing_to_recommend():
    assert recommend(comparison(failed(DENSE), failed(CERES, "out_of_memory"))) is None


def test_median_repeat_counts_and_the_largest_peak():
    run = done(DENSE)
    repeats = tuple(
        measurement(total, peak_memory_in_bytes=peak)
        for total, peak in ((3.0, 7), (1.0, 9), (2.0, 8), (9.0, 1))
    )
    run = dataclasses.replace(run, measurements=repeats)
    assert run.total_time_in_seconds == 2.0
    assert run.peak_memory_in_bytes == 9


def test_time_to_a_gap_counts_accepted_states_and_what_is_built_before():
    run = dataclasses.replace(
        done(DENSE), measurements=(measurement(2.0, 100.0, build_time_in_seconds=0.25),)
    )
    compared = comparison(run, failed(CERES))
    assert compared.best_cost(0) == 100
    assert compared.time_to_gap(run, 1.0) == 1.25  # cost 200; the rejected 50 is no state
    assert compared.time_to_gap(run, 1e-5) == 2.25
    assert math.isnan(compared.time_to_gap(compared.runs[1], 1e-2))
    assert math.isnan(compared.gap(compared.runs[1]))
    assert run.measurement.num_steps == 3
    breakdown = run.measurement.breakdown
    assert breakdown == {
        "residuals": 0.0625, "Jacobians": 0.125, "linear solver": 0.25, "rest": 2.25 - 0.4375,
    }  # fmt: skip


def test_a_run_that_did_not_end_has_a_trace_too():
    unfinished = {
        "cost": np.array([9.0, 3.0]),
        "step_is_successful": np.array([False, True]),
        "cumulative_time_in_seconds": np.array([0.5, 1.5]),
    }
    run = dataclasses.replace(failed(DENSE), unfinished=unfinished)
    assert run.time_to(3.0) == 1.5
    assert math.isnan(run.time_to(2.0))
    assert not Method(backend="auto", linear_solver_type="auto", num_threads=1).is_iterative
