"""Factor counts of a solve equal the prediction, and elimination by definition."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import bundle
from bundle import SolveOptions, _core
from bundle.solving.layout import resolve_defaults
from tests.planning.inspection.dense_oracle import (
    drive,
    eliminate_first,
    factor_pattern,
    jacobian_pattern,
    scalar_order,
)
from tests.scenes import make_problem, with_observations

OWN = make_problem(num_images=12, num_points=30, track=3)
SHARED = make_problem(num_images=12, num_points=30, track=3, shared=True)
UNEVEN = with_observations(
    OWN, (OWN.observation_point % 2 == 0) | (np.arange(OWN.num_observations) % 3 > 0)
)
HALVES = OWN.replace(image_camera=np.array([0, 0, 0, 0, 1, 1, 1, 1, 2, 3, 4, 5]))

CASES = {
    "own": (OWN, {}),
    "shared": (SHARED, {}),
    "halves": (HALVES, {}),
    "halves-no-gauge": (HALVES, {"gauge": "none"}),
    "poses-points": (SHARED, {"refine": ("poses", "points")}),
    "focal-points": (HALVES, {"refine": ("focal", "points")}),
    "fixed": (OWN, {"fixed_image_ids": (2, 6), "fixed_camera_ids": (5,), "fixed_point_ids": (1,)}),
    "fixed-points": (UNEVEN, {"fixed_point_ids": (2, 4, 8, 11, 12, 20)}),
    "drive": (drive(40, 200, 4), {}),
}
DIRECT = ("dense_schur", "sparse_schur")


def summary_of(problem, backend, solver, **options):
    return bundle.solve(
        problem, backend=backend, linear_solver_type=solver, max_num_iterations=1, **options
    ).summary


def predicted(problem, summary, **options):
    """The row of `inspect` for what was solved."""
    (row,) = (
        method
        for method in bundle.inspect(problem, **options).methods
        if method.backend == summary.backend_used
        and method.linear_solver_type == summary.linear_solver_type_used
        and method.is_taken
        and not method.preconditioner
        and method.ordering != "cameras_first"
    )
    return row


@pytest.mark.parametrize("solver", [*DIRECT, "sparse_normal_cholesky"])
@pytest.mark.parametrize("name", CASES)
def test_the_factor_is_the_predicted_one(name, solver, backend):
    problem, options = CASES[name]
    if (backend, solver) == ("fused", "sparse_normal_cholesky"):
        pytest.skip("the fused backend always eliminates the points")
    summary = summary_of(problem, backend, solver, **options)
    row = predicted(problem, summary, **options)
    assert summary.num_information_nonzeros == row.nnz_information
    assert summary.num_factor_nonzeros == row.nnz_factor
    assert summary.factor_flops == pytest.approx(row.flops, rel=1e-12)
    assert summary.factor_ordering == row.ordering
    assert summary.symbolic_time_in_seconds >= 0
    n = summary.num_factor_columns
    if solver == "sparse_normal_cholesky":
        assert (n, summary.num_reduced_nonzeros) == (row.num_unknowns, None)
    elif solver == "dense_schur":
        assert summary.num_reduced_nonzeros == n**2 >= row.nnz_reduced
        assert summary.num_factor_nonzeros == n * (n + 1) // 2
    else:
        assert summary.num_reduced_nonzeros == row.nnz_reduced
    assert not summary.warnings


@pytest.mark.parametrize("name", CASES)
def test_the_factor_is_that_of_elimination_by_definition(name, backend):
    problem, options = CASES[name]
    given = resolve_defaults(problem, SolveOptions(**options)).asdict()
    blocks = _core.parameter_blocks(problem, given)
    sizes, is_free = blocks["size"], blocks["point_is_free"]
    jacobian = jacobian_pattern(
        problem, sizes, blocks["image_block"], blocks["camera_block"], is_free
    )
    information = jacobian.T @ jacobian
    reduced = eliminate_first(information, 3 * is_free.sum())

    summary = summary_of(problem, backend, "sparse_schur", **options)
    order = _core.order_blocks(*_core.reduced_pattern(problem, given), summary.factor_ordering)
    factor = factor_pattern(reduced, scalar_order(order, sizes))
    below = factor.sum(0) - 1
    assert summary.num_information_nonzeros == information.sum()
    assert summary.num_factor_columns == len(reduced)
    assert summary.num_reduced_nonzeros == reduced.sum()
    assert summary.num_factor_nonzeros == factor.sum()
    assert summary.factor_flops == (below**2 + 3 * below).sum()


def test_what_auto_takes_is_counted_as_if_it_were_asked_for(backend):
    chosen = summary_of(OWN, backend, "auto")
    asked = summary_of(OWN, backend, chosen.linear_solver_type_used.lower())
    fields = [f.name for f in dataclasses.fields(asked) if "nonzeros" in f.name]
    fields += ["num_factor_columns", "factor_flops", "factor_ordering"]
    for field in fields:
        assert getattr(chosen, field) == getattr(asked, field), field


def assert_no_factor(summary):
    assert summary.num_factor_columns is summary.num_factor_nonzeros is None
    assert summary.factor_flops is None
    assert summary.factor_ordering == ""
    assert summary.num_information_nonzeros > 0


def test_conjugate_gradients_have_no_factor(backend):
    summary = summary_of(SHARED, backend, "iterative_schur")
    assert_no_factor(summary)
    expected = summary_of(SHARED, "fused", "sparse_schur").num_reduced_nonzeros
    assert summary.num_reduced_nonzeros == (expected if backend == "fused" else None)


@pytest.mark.parametrize("solver", ["cgnr", "dense_qr"])
def test_solvers_without_a_cholesky_factor(solver):
    assert_no_factor(summary_of(SHARED, "ceres", solver))


def test_the_whole_matrix_dense():
    summary = summary_of(SHARED, "ceres", "dense_normal_cholesky")
    n = summary.num_factor_columns
    assert n == summary.num_parameters_reduced
    assert summary.num_factor_nonzeros == n * (n + 1) // 2
    assert summary.num_reduced_nonzeros is None


@pytest.mark.parametrize(("problem", "left"), [(OWN, 90), (SHARED, 90 + 2)])
@pytest.mark.parametrize("solver", DIRECT)
def test_cameras_first_leaves_the_points_and_what_images_share(problem, left, solver):
    summary = summary_of(problem, "ceres", solver, linear_solver_ordering="cameras_first")
    assert summary.num_factor_columns == left
    dense = solver == "dense_schur"
    assert summary.num_factor_nonzeros == (left * (left + 1) // 2 if dense else None)


@pytest.mark.parametrize("solver", DIRECT)
def test_what_ceres_chose_to_eliminate_is_not_guessed(solver):
    assert_no_factor(summary_of(OWN, "ceres", solver, linear_solver_ordering="automatic"))
    assert_no_factor(summary_of(OWN, "ceres", solver, refine=("poses", "focal")))


@pytest.mark.parametrize("name", ["bal/problem-49-7776-pre.txt.bz2", "colmap/batmo_rigs"])
@pytest.mark.parametrize("solver", DIRECT)
def test_real_data(bundle_data, name, solver):
    problem = bundle.load(bundle_data / name)
    summary = summary_of(problem, "fused", solver)
    row = predicted(problem, summary)
    assert summary.num_information_nonzeros == row.nnz_information
    assert summary.num_factor_nonzeros == row.nnz_factor
    assert summary.factor_ordering == row.ordering
