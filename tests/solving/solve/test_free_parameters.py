"""Refined and constant parameters: subsets, fixed ids, gauges, blocks."""

import numpy as np
import pytest

import bundle
from tests import scenes
from tests.printed import warning
from tests.solving.solve.problems import cost, minimum_by_scipy

KINDS = {"focal": [0, 1], "principal_point": [2, 3], "extra": [4, 5, 6, 7]}


def moved(problem, result, name):
    """Which entries changed."""
    return getattr(result.problem, name) != getattr(problem, name)


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize(
    "refine",
    [
        ["poses"],
        ["points"],
        ["focal"],
        ["principal_point"],
        ["extra"],
        ["poses", "points"],
        ["points", "focal", "extra"],
        ["poses", "focal", "principal_point", "extra"],
        ["poses", "points", "focal", "principal_point", "extra"],
    ],
)
def test_only_what_is_asked_for_moves(solve, backend, refine, shared):
    problem = scenes.make_problem(model="OPENCV", shared=shared, seed=1, num_points=60)
    if backend == "fused" and refine == ["points"]:
        with pytest.raises(bundle.InputError, match=r"^refine: expected poses or intrinsics"):
            solve(problem, refine=refine, gauge="none")
        return
    result = solve(problem, refine=refine, gauge="none")
    assert moved(problem, result, "cam_from_world").all() == ("poses" in refine)
    assert moved(problem, result, "cam_from_world").any() == ("poses" in refine)
    assert moved(problem, result, "points").all() == ("points" in refine)
    assert moved(problem, result, "points").any() == ("points" in refine)
    for kind, columns in KINDS.items():
        params = moved(problem, result, "camera_params")[:, columns]
        assert params.all() == (kind in refine), kind
        assert params.any() == (kind in refine), kind
    assert result.summary.final_cost < result.summary.initial_cost
    assert result.summary.final_cost == pytest.approx(cost(result.problem), rel=1e-10)


def test_a_subset_reaches_the_minimum_that_scipy_finds():
    problem = scenes.make_problem(num_images=3, num_points=15, seed=2)
    result = bundle.solve(problem, refine="poses,focal", function_tolerance=1e-14)
    expected = minimum_by_scipy(problem, points=False, params=(0,))
    assert result.summary.final_cost == pytest.approx(expected, rel=1e-8)


def test_fixed_ids_stay(solve):
    problem = scenes.make_problem(seed=3)
    result = solve(
        problem,
        gauge="none",
        fixed_camera_ids=[2],
        fixed_image_ids=[1, 4],
        fixed_point_ids=[5, 6, 7],
    )
    poses = moved(problem, result, "cam_from_world")
    assert poses.any(axis=1).tolist() == [False, True, True, False, True]
    params = moved(problem, result, "camera_params")
    assert params.any(axis=1).tolist() == [True, False, True, True, True]
    points = moved(problem, result, "points").any(axis=1)
    assert np.flatnonzero(~points).tolist() == [4, 5, 6]


@pytest.mark.parametrize("what", ["camera", "image", "point"])
def test_a_fixed_id_that_does_not_exist_is_named(solve, what):
    with pytest.raises(bundle.InputError, match=f"fixed_{what}_ids: .* found 99"):
        solve(scenes.make_problem(), **{f"fixed_{what}_ids": [1, 99]})


def test_observations_with_nothing_to_refine_still_cost(solve):
    problem = scenes.make_problem(seed=4, num_images=3)
    result = solve(
        problem,
        fixed_image_ids=[1],
        fixed_camera_ids=[1],
        fixed_point_ids=range(1, 21),
        loss="huber",
        gauge="none",
    )
    assert result.summary.fixed_cost > 0
    assert result.summary.initial_cost == pytest.approx(cost(problem, "huber"), rel=1e-10)
    assert result.summary.final_cost == pytest.approx(cost(result.problem, "huber"), rel=1e-10)
    assert result.iterations["cost"][0] == pytest.approx(result.summary.initial_cost, rel=1e-12)


def test_everything_fixed_is_a_result():
    problem = scenes.make_problem(seed=5)
    result = bundle.solve(problem, refine=[])
    assert result.summary.final_cost == pytest.approx(cost(problem), rel=1e-10)
    assert result.summary.final_cost == result.summary.initial_cost
    assert result.summary.is_solution_usable


def gauge_rank_deficiency(problem, free):
    """Null directions of the Jacobian restricted to the free columns of poses and points."""
    linear = bundle.model.residuals.linearize(problem)
    n, m = problem.num_images, problem.num_points
    jacobian = np.zeros((2 * problem.num_observations, 6 * n + 3 * m))
    for k, (i, p) in enumerate(
        zip(problem.observation_image, problem.observation_point, strict=True)
    ):
        jacobian[2 * k : 2 * k + 2, 6 * i : 6 * i + 6] = linear.d_pose[k]
        columns = slice(6 * n + 3 * p, 6 * n + 3 * p + 3)
        jacobian[2 * k : 2 * k + 2, columns] = linear.d_point[k]
    jacobian = jacobian[:, free]
    values = np.linalg.svd(jacobian / np.linalg.norm(jacobian, axis=0), compute_uv=False)
    return int((values < 1e-9 * values[0]).sum())


@pytest.mark.parametrize(
    ("gauge", "fixed_poses", "fixed_points"),
    [("none", 0, 0), ("two_cameras", 7, 0), ("three_points", 0, 9)],
)
def test_gauges_take_out_the_seven_free_degrees(solve, gauge, fixed_poses, fixed_points):
    problem = scenes.make_problem(seed=6, noise=0.3, num_points=15)
    result = solve(
        problem, refine="poses,points", gauge=gauge, function_tolerance=1e-15, num_threads=1
    )
    poses = result.problem.cam_from_world != problem.cam_from_world
    points = result.problem.points != problem.points
    # A fixed rotation keeps all four entries of its quaternion.
    degrees = 3 * poses[:, :4].any(axis=1)[:, None] * np.array([[1, 0, 0, 0]])
    num_free_pose = int(degrees.sum() + poses[:, 4:].sum())
    assert num_free_pose == 6 * problem.num_images - fixed_poses
    assert points.sum() == points.size - fixed_points
    rotation_free = np.repeat(poses[:, :4].any(axis=1)[:, None], 3, axis=1)
    free = np.concatenate([np.hstack([rotation_free, poses[:, 4:]]).ravel(), points.ravel()])
    assert gauge_rank_deficiency(problem, free) == (7 if gauge == "none" else 0)
    assert result.summary.warning_kinds == ()


def test_the_gauge_does_not_change_the_minimum(solve):
    problem = scenes.make_problem(seed=7)
    costs = [
        solve(problem, gauge=gauge, function_tolerance=1e-14).summary.final_cost
        for gauge in ("none", "two_cameras")
    ]
    assert costs[0] == pytest.approx(costs[1], rel=1e-9)


@pytest.mark.parametrize("gauge", ["two_cameras", "three_points"])
def test_what_is_fixed_already_holds_the_gauge(solve, gauge):
    problem = scenes.make_problem(seed=8)
    result = solve(problem, gauge=gauge, fixed_image_ids=[2, 5])
    poses = (result.problem.cam_from_world != problem.cam_from_world).any(axis=1)
    assert poses.tolist() == [True, False, True, True, False]
    assert (result.problem.points != problem.points).all()


def test_a_gauge_that_cannot_be_held_is_said(solve):
    one_image = scenes.make_problem(num_images=2, seed=9)
    poses = one_image.cam_from_world.copy()
    poses[1] = poses[0]
    result = solve(one_image.replace(cam_from_world=poses), gauge="two_cameras")
    assert "two_cameras" in warning(result.summary, "gauge_not_held")
    flat = scenes.make_problem(num_points=2, seed=9)
    result = solve(flat, gauge="three_points")
    assert "three_points" in warning(result.summary, "gauge_not_held")


@pytest.mark.parametrize(
    ("model", "shared", "refine", "structure", "ordering"),
    [
        ("RADIAL", False, "poses,points,focal,extra", "2,3,9", (40, 5)),
        ("SIMPLE_RADIAL", False, "poses,points", "2,3,6", (40, 5)),
        ("SIMPLE_RADIAL", True, "poses,points", "2,3,6", (40, 5)),
        ("SIMPLE_RADIAL", True, "poses,points,focal,extra", "2,3,d", (40, 6)),
        ("SIMPLE_RADIAL", False, "poses,points,focal,extra", "2,3,8", (40, 5)),
    ],
)
@pytest.mark.parametrize("solver", ["dense_schur", "sparse_schur", "iterative_schur"])
def test_blocks_are_merged_so_that_a_backend_can_specialise(
    solve, backend, model, shared, refine, structure, ordering, solver
):
    problem = scenes.make_problem(model=model, shared=shared, seed=10)
    summary = solve(problem, linear_solver_type=solver, refine=refine, gauge="none").summary
    assert summary.schur_structure_given == structure
    # Ceres has kernels of its own for blocks of 2, 3, 4, 6 and 9.
    dynamic = backend == "ceres" and structure == "2,3,8"
    assert summary.schur_structure_used == ("2,3,d" if dynamic else structure)
    assert summary.linear_solver_ordering_given == ordering
    assert summary.linear_solver_ordering_used == ordering
    assert summary.linear_solver_type_used == summary.linear_solver_type_given == solver.upper()


def test_cameras_first_eliminates_the_images():
    for shared in (False, True):
        problem = scenes.make_problem(shared=shared, seed=11)
        summary = bundle.solve(
            problem, linear_solver_type="sparse_schur", linear_solver_ordering="cameras_first"
        ).summary
        # The first image is held by the gauge: with a camera of its own its block still has
        # intrinsics, with a shared one nothing is left of it.
        assert summary.linear_solver_ordering_used == ((4, 41) if shared else (5, 40))


def test_points_that_nobody_sees_stay(solve):
    problem = scenes.make_problem(seed=12)
    points = np.vstack([problem.points, [[1.0, 2.0, 3.0]]])
    problem = problem.replace(points=points, point_ids=np.arange(1, 42))
    result = solve(problem)
    assert result.problem.points[40].tolist() == [1, 2, 3]
    assert result.summary.linear_solver_ordering_used == (40, 5)


def test_auto_with_cameras_first_looks_at_the_points():
    """400 points are 1200 columns, nearly full: no dense matrix, and no flag is blamed for one."""
    problem = scenes.make_problem(num_images=5, num_points=400, noise=0.3)
    result = bundle.solve(problem, linear_solver_ordering="cameras_first")
    assert result.summary.linear_solver_type_used == "ITERATIVE_SCHUR"
    assert "points (1200 columns)" in result.summary.linear_solver_choice
    expected = bundle.solve(problem)
    assert result.summary.final_cost == pytest.approx(expected.summary.final_cost, rel=1e-4)
    few = bundle.solve(scenes.make_problem(num_points=30), linear_solver_ordering="cameras_first")
    assert few.summary.linear_solver_type_used == "DENSE_SCHUR"
