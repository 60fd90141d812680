"""Solves that several processes leave to one: its result to the bit, with a warning."""

from __future__ import annotations

import numpy as np
import pytest

import bundle
from bundle.solving.ranks.partition import reason_in_options, reason_to_be_alone
from tests.scenes import scene
from tests.solving.ranks.thread_crew import processes

QUICK = {"max_num_iterations": 3, "num_threads": 1}
POINTS = bundle.BetweenFactor(("point", 1), ("point", 2), np.zeros(3), np.eye(3))


def same_as_alone(factors=(), **options):
    alone = bundle.solve(scene(), factors=factors, **(QUICK | options))
    with processes(3):
        result = bundle.solve(scene(), factors=factors, **(QUICK | options))
    # With points that a factor couples, Ceres orders blocks by their addresses: one process, run
    # twice, differs from itself in the last digits.
    rtol = 1e-9 if factors else 0
    np.testing.assert_allclose(
        result.iterations["cost"], alone.iterations["cost"], rtol=rtol, atol=0
    )
    np.testing.assert_allclose(result.problem.points, alone.problem.points, rtol=rtol, atol=rtol)
    return alone.summary, result.summary


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"backend": "ceres"}, "backend"),
        ({"linear_solver_type": "dense_qr"}, "linear_solver_type"),
        ({"linear_solver_type": "sparse_normal_cholesky"}, "linear_solver_type"),
        (
            {"linear_solver_type": "sparse_schur", "linear_solver_ordering": "automatic"},
            "linear_solver_ordering",
        ),
        (
            {"linear_solver_type": "iterative_schur", "preconditioner_type": "cluster_jacobi"},
            "preconditioner_type",
        ),
        ({"gauge": "three_points"}, "gauge"),
        ({"refine": "points"}, "refine"),
        ({"factors": [POINTS]}, "factors"),
    ],
)
def test_what_is_not_divided(options, word):
    alone, summary = same_as_alone(**options)
    assert summary.warning_kinds == (*alone.warning_kinds, "one_process")
    assert len(summary.warnings) == len(summary.warning_kinds)
    assert f"({word})" in summary.warnings[-1]
    assert "other 2" in summary.warnings[-1]
    assert summary.num_processes == 1


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"linear_solver_type": "iterative_schur", "preconditioner_type": "jacobi"},
        # A direct solver reads no preconditioner.
        {"linear_solver_type": "dense_schur", "preconditioner_type": "cluster_jacobi"},
        {"refine": "poses"},
        {"refine": "points,focal"},
        {"backend": "fused"},
    ],
)
def test_what_is_divided(options):
    with processes(2):
        summary = bundle.solve(scene(), **(QUICK | options)).summary
    assert "one_process" not in summary.warning_kinds
    assert summary.num_processes == 2


@pytest.mark.parametrize(
    "factor",
    [
        bundle.PriorFactor(("point", 1), np.zeros(3), 1e-3 * np.eye(3)),
        bundle.BetweenFactor(("image", 1), ("image", 2), [1, 0, 0, 0, 0, 0, 0], np.eye(6)),
    ],
)
def test_factors_that_are_divided(factor):
    with processes(2):
        summary = bundle.solve(scene(), factors=[factor], **QUICK).summary
    assert "one_process" not in summary.warning_kinds
    assert summary.num_processes == 2


@pytest.mark.parametrize("fused", [False, True])
def test_reasons_need_no_settled_options(fused):
    """They are asked for before the problem is read."""
    options = bundle.SolveOptions(backend="fused" if fused else "auto", refine="points").asdict()
    assert options["gauge"] == options["cheirality"] == "auto"
    assert bool(reason_in_options(options)) is not fused
    assert reason_to_be_alone(options, None) == reason_in_options(options)
