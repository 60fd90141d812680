"""Refusals before a solve, and arguments that replace nothing silently."""

import numpy as np
import pytest

import bundle
from tests import scenes


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"linear_solver_type": "cgnr", "preconditioner_type": p}, "expected identity or jacobi")
        for p in ("schur_jacobi", "cluster_jacobi", "cluster_tridiagonal")
    ]
    + [
        (
            {"linear_solver_type": s, "trust_region_strategy_type": t},
            "expected levenberg_marquardt with an iterative solver",
        )
        for s in ("cgnr", "iterative_schur")
        for t in ("dogleg", "subspace_dogleg")
    ],
)
def test_combinations_that_no_backend_can_serve(options, message):
    with pytest.raises(bundle.InputError, match=message):
        bundle.solve(scenes.make_problem(), **options)


def test_a_preconditioner_that_nobody_uses_is_said(solve):
    summary = solve(
        scenes.make_problem(), linear_solver_type="dense_schur", preconditioner_type="jacobi"
    ).summary
    assert summary.warning_kinds == ("preconditioner_not_used",)
    assert "DENSE_SCHUR" in summary.warnings[0]


def huge_problem():
    """16 million unknowns on the point side, in a few megabytes."""
    base = scenes.make_problem(num_images=2, num_points=1)
    n = 200_000
    return base.replace(
        points=np.random.default_rng(0).uniform(-1, 1, (n, 3)),
        point_ids=np.arange(n),
        observation_image=np.tile([0, 1], n),
        observation_point=np.repeat(np.arange(n), 2),
        observation_xy=np.zeros((2 * n, 2)),
        observation_keypoint=np.full(2 * n, -1),
    )


@pytest.mark.parametrize(
    "options",
    [
        {"linear_solver_type": "dense_qr"},
        {"linear_solver_type": "dense_normal_cholesky"},
        {"linear_solver_type": "dense_schur", "linear_solver_ordering": "cameras_first"},
    ],
)
def test_dense_matrices_beyond_memory_are_refused_with_their_size(options):
    message = r"needs [\d.]+ [TP]B for its dense matrices; this machine has .* free"
    with pytest.raises(bundle.InputError, match=message):
        bundle.solve(huge_problem(), **options)


def test_a_dense_reduced_system_beyond_memory_is_refused_with_its_size(solve):
    base, n = scenes.make_problem(num_images=1, num_points=30, shared=True), 60_000
    problem = base.replace(
        cam_from_world=np.tile(base.cam_from_world, (n, 1)),
        image_ids=np.arange(n),
        image_names=[""] * n,
        image_camera=np.zeros(n, int),
        observation_image=np.arange(n),
        observation_point=np.arange(n) % 30,
        observation_xy=np.zeros((n, 2)),
        observation_keypoint=np.full(n, -1),
    )
    message = r"^linear_solver_type: DENSE_SCHUR needs [\d.]+ [GT]B for its dense matrices"
    with pytest.raises(bundle.InputError, match=message):
        solve(problem, linear_solver_type="dense_schur")


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("solver", ["dense_schur", "sparse_schur", "iterative_schur"])
@pytest.mark.parametrize(
    ("refine", "ordering"),
    [
        ("poses,focal,extra", "points_first"),
        ("points", "cameras_first"),
        ("points", "points_first"),
    ],
)
def test_no_schur_solver_is_replaced_when_one_side_is_fixed(refine, ordering, solver, shared):
    """Fixed blocks never reach Ceres, so its fallback to DENSE_QR of the whole Jacobian cannot."""
    problem = scenes.make_problem(shared=shared)
    options = {"refine": refine, "linear_solver_ordering": ordering, "function_tolerance": 1e-13}
    options["backend"] = "ceres"
    summary = bundle.solve(problem, linear_solver_type=solver, **options).summary
    assert summary.linear_solver_type_used == solver.upper()
    expected = bundle.solve(problem, linear_solver_type="dense_qr", **options).summary
    assert summary.final_cost == pytest.approx(expected.final_cost, rel=1e-6)
    nothing = (refine, ordering) != ("points", "points_first")
    assert ("ordering_replaced" in summary.warning_kinds) == nothing


def test_auto_says_why(solve, backend):
    points_fixed = bundle.solve(scenes.make_problem(), refine="poses", backend="ceres").summary
    assert points_fixed.linear_solver_type_used == "SPARSE_NORMAL_CHOLESKY"
    assert points_fixed.linear_solver_choice.startswith("No point is refined")
    small = solve(scenes.make_problem()).summary
    assert small.linear_solver_type_used == "DENSE_SCHUR"
    # Five images, pose and two intrinsics each, less the seven of the gauge.
    cost = {"ceres": "milliseconds", "fused": "less than a millisecond"}[backend]
    assert small.linear_solver_choice == (
        f"The reduced camera system (33 columns) is small: its dense factorisation costs {cost}."
    )
    asked_for = solve(scenes.make_problem(), linear_solver_type="dense_schur").summary
    assert asked_for.linear_solver_choice == ""


@pytest.mark.parametrize(
    ("num_points", "track", "local", "used", "reason"),
    [(240, 2, True, "SPARSE_SCHUR", "is only"), (2400, 20, False, "DENSE_SCHUR", "% full: dense")],
)
def test_auto_looks_at_how_full_the_reduced_system_is(
    solve, backend, num_points, track, local, used, reason
):
    num_images = 150
    problem = scenes.make_problem(num_images=num_images, num_points=num_points, track=track, seed=1)
    if local:  # each point in two neighbouring images: S is tridiagonal
        first = np.arange(num_points) % (num_images - 1)
        images = np.stack([first, first + 1], 1).ravel()
        problem = problem.replace(observation_image=images)
    summary = solve(problem, max_num_iterations=1).summary
    # with AVX2 our sparse kernels are as fast on a full matrix as dense BLAS
    also = {"SPARSE_SCHUR"} if backend == "fused" else set()
    assert summary.linear_solver_type_used in {used, *also}
    expected = reason if backend == "ceres" else "columns): dense "
    assert expected in summary.linear_solver_choice


def test_two_levels_are_not_of_ceres():
    options = {"linear_solver_type": "iterative_schur", "preconditioner_type": "two_level"}
    with pytest.raises(bundle.InputError, match=r"^preconditioner_type: .* found two_level$"):
        bundle.solve(scenes.make_problem(), backend="ceres", **options)


@pytest.mark.parametrize("solver", ["auto", "iterative_schur"])
def test_a_preconditioner_that_only_ceres_has_takes_ceres(solver):
    """Also where conjugate gradients may only be chosen: the user asked for it."""
    summary = bundle.solve(
        scenes.make_problem(num_images=3, num_points=12),
        linear_solver_type=solver,
        preconditioner_type="cluster_jacobi",
        max_num_iterations=1,
    ).summary
    assert summary.backend_used == "CERES"
    assert "preconditioner_type" in summary.backend_choice
