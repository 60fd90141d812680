"""Recommendation and reason for runs with known times and costs."""

import dataclasses
import math

import numpy as np
import pytest

from bundle.planning.comparison.measured_run import Method
from bundle.planning.comparison.recommendation import COST_TOLERANCE, recommend
from tests.planning.comparison.fakes import (
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
from tests.printed import figures


def in_order(text, parts):
    """Return whether the parts stand in a text one after the other."""
    position = 0
    for part in parts:
        position = text.find(part, position) + len(part)
        if position < len(part):
            return False
    return True


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
    assert figures(found.reason) == ["12", "2", "1.50", "0.50", "2.0e-03"]
    order = ["DENSE_SCHUR", "1.50", "ITERATIVE_SCHUR", "2.0e-03", "ceres DENSE_SCHUR", "timed out"]
    assert in_order(found.reason, order)
    assert found.command == (
        "bundle refine 'scene 0.txt' -o OUTPUT --backend fused --solver sparse-schur --threads 2"
    )


def test_reason_from_the_matrix():
    sparse = done(SPARSE, prediction=prediction())
    dense = done(DENSE, total=3.1, prediction=prediction(ordering="", flops=3.3e8))
    reason = recommend(comparison(sparse, dense)).reason
    assert figures(reason) == ["1000", "14", "2.1e+09", "1", "3.10"]
    assert in_order(reason, ["fused SPARSE_SCHUR", "AMD", "1 s", "DENSE_SCHUR"])
    dense = done(DENSE, total=0.05, prediction=prediction(flops=3.3e8, nnz_reduced=1e6))
    reason = recommend(comparison(sparse, dense)).reason
    assert figures(reason) == ["1000", "100", "3.3e+08", "50", "20"]
    assert in_order(reason, ["fused DENSE_SCHUR", "50 ms", "SPARSE_SCHUR", "20"])
    nothing = prediction(nnz_factor=0, flops=0, ordering="")
    iterative = done(ITERATIVE, total=0.5, prediction=nothing)
    reason = recommend(comparison(sparse, iterative)).reason
    # Flops of the factorisation that is not made, then conjugate gradients per step.
    assert figures(reason)[2:4] == ["2.1e+09", "4"]


def test_reason_without_a_prediction():
    found = recommend(comparison(done(DENSE)))
    assert found.reason.startswith("fused DENSE_SCHUR")
    assert figures(found.reason) == ["25", "1"]  # % in the linear solver, seconds


def test_threads_and_preconditioners_are_told_apart():
    one = dataclasses.replace(ITERATIVE, num_threads=1)
    identity = dataclasses.replace(ITERATIVE, preconditioner_type="identity")
    reason = recommend(comparison(done(ITERATIVE), done(one, 1.8), done(identity, 2.5))).reason
    assert in_order(reason, ["1 thread", "1.80", "IDENTITY", "2.50"])


@pytest.mark.parametrize(
    ("foreseen", "verdict", "ratio"),
    [
        (DENSE, "right", []),
        (SPARSE, "right", ["1.10"]),
        (ITERATIVE, "wrong", ["1.20"]),
        (CERES, "wrong", []),
    ],
)
def test_verdict_on_what_was_foreseen(foreseen, verdict, ratio):
    runs = (done(DENSE), done(SPARSE, 1.1), done(ITERATIVE, 1.2), failed(CERES))
    said = recommend(comparison(*runs), [foreseen]).verdict
    assert said.startswith(f"`bundle inspect` predicted {foreseen.name}")
    assert verdict in said
    assert figures(said) == ["2", *ratio]  # threads
    assert recommend(comparison(*runs), [None]).verdict == ""


def test_several_problems():
    runs = [
        done(DENSE, 1.0), done(SPARSE, 2.0), done(ITERATIVE, 0.5),
        done(DENSE, 9.0, problem=1), done(SPARSE, 2.0, problem=1), failed(ITERATIVE, problem=1),
        done(DENSE, 1.0, problem=2), done(SPARSE, 1.0, problem=2), done(ITERATIVE, 2, problem=2),
    ]  # fmt: skip
    found = recommend(comparison(*runs), [DENSE, SPARSE, None])
    assert found.method == SPARSE  # all solved, ratios 4 1 1; dense 2 4.5 1
    assert figures(found.reason) == ["2", "3", "4.00"]  # fastest on 2 of 3, at worst 4 times
    assert found.command.startswith("bundle refine INPUT -o OUTPUT")
    assert figures(found.verdict) == ["15", "1", "2"]  # within 15 %: 1 of 2


def test_the_mean_over_problems_is_geometric():
    """Ratios 1 8 and 3 3: geometric means 2.83 and 3, arithmetic ones 4.5 and 3, worst 8 and 3."""
    runs = [
        done(DENSE, 1.0), done(SPARSE, 3.0), done(ITERATIVE, 9.0),
        done(DENSE, 8.0, problem=1), done(SPARSE, 3.0, problem=1), done(ITERATIVE, 1, problem=1),
    ]  # fmt: skip
    assert recommend(comparison(*runs)).method == DENSE


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


def test_the_start_is_a_state_and_takes_no_time():
    run = done(DENSE, total=2.0)  # from a cost of 400
    assert run.time_to(400.0) == 0.0
    assert run.time_to(399.0) == 1.0


def test_a_best_cost_of_zero_is_measured_in_costs():
    compared = comparison(done(DENSE, cost=0.0), done(SPARSE, cost=0.25))
    assert [compared.gap(run) for run in compared.runs] == [0.0, 0.25]
