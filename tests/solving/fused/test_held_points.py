"""Poses and intrinsics beside known points: the steps of Ceres, of any number of threads."""

import numpy as np
import pytest

import bundle
from tests import rolling, scenes
from tests.rig_scenes import FIVE, STEREO, rig_problem

LENS = ("poses", "focal", "extra")
OPTIONS = {"refine": LENS, "function_tolerance": 1e-12, "num_threads": 1}


def priors(problem):
    centers = problem.projection_centers + 0.01
    return [bundle.PositionPrior(i + 1, centers[i], (0.01, 0.02, 0.05)) for i in range(4)]


def shared():
    return scenes.make_problem(num_images=12, num_points=80, shared=True, noise=0.5)


def behind(problem):
    """The first point at the centre of an image, a little behind it."""
    points = problem.points.copy()
    toward = points[0] - problem.projection_centers[0]
    points[0] = problem.projection_centers[0] - 0.01 * toward
    return problem.replace(points=points)


CASES = {
    "one camera": (shared, {}),
    "poses alone": (shared, {"refine": "poses"}),
    "intrinsics alone": (shared, {"refine": ("focal", "extra")}),
    "constant images": (shared, {"fixed_image_ids": range(1, 5)}),
    "huber": (shared, {"loss": "huber", "loss_scale": 0.3}),
    "cauchy": (shared, {"loss": "cauchy", "loss_scale": 0.3}),
    "dogleg": (shared, {"trust_region_strategy_type": "dogleg"}),
    "behind": (lambda: behind(shared()), {"cheirality": "zero"}),
    "sensors": (
        lambda: rig_problem(rigs=(STEREO, FIVE[:2]), num_alone=1),
        {"refine": ("poses", "sensor_from_rig")},
    ),
    "twists": (
        lambda: rolling.filmed(
            scenes.make_problem(num_images=5, num_points=60, seed=2), ties=True, seed=3
        ),
        {},
    ),
}


def both(problem, **options):
    return [bundle.solve(problem, backend=b, **OPTIONS | options) for b in ("ceres", "fused")]


def assert_equal(ceres, fused):
    assert fused.summary.backend_used == "FUSED"
    assert fused.summary.num_parameters == ceres.summary.num_parameters
    assert fused.summary.num_residuals_reduced == ceres.summary.num_residuals_reduced
    for one in ("num_successful_steps", "num_unsuccessful_steps"):
        assert getattr(fused.summary, one) == getattr(ceres.summary, one)
    assert fused.summary.final_cost == pytest.approx(ceres.summary.final_cost, rel=1e-11)
    for one in ("cam_from_world", "camera_params"):
        np.testing.assert_allclose(
            getattr(fused.problem, one), getattr(ceres.problem, one), rtol=1e-7, atol=1e-7
        )
    assert (fused.problem.points == ceres.problem.points).all()


@pytest.mark.parametrize("name", CASES)
def test_steps_are_those_of_ceres(name):
    make, options = CASES[name]
    assert_equal(*both(make(), **options))


def test_points_that_are_all_named_are_held():
    problem = shared()
    found = both(problem, refine=(*LENS, "points"), fixed_point_ids=problem.point_ids.tolist())
    assert_equal(*found)
    kinds = bundle.solve(problem, backend="fused", **OPTIONS).problem
    np.testing.assert_array_equal(found[1].problem.cam_from_world, kinds.cam_from_world)


def test_positions_have_their_weight():
    problem = shared()
    held = both(problem, priors=priors(problem), align=False)
    assert_equal(*held)
    moved = np.abs(held[1].problem.projection_centers - problem.projection_centers - 0.01)
    free = bundle.solve(problem, backend="fused", **OPTIONS).problem.projection_centers
    assert moved[:4].max() < np.abs(free - problem.projection_centers - 0.01)[:4].max()


@pytest.mark.parametrize("solver", ["dense_schur", "sparse_schur", "iterative_schur"])
def test_any_solver_and_number_of_threads_finds_the_minimum(solver):
    problem = scenes.make_problem(num_images=30, num_points=300, track=6, noise=0.5)
    expected, _ = both(problem)
    options = OPTIONS | {"linear_solver_type": solver, "backend": "fused"}
    found = bundle.solve(problem, **options | {"num_threads": 3})
    assert found.summary.final_cost == pytest.approx(expected.summary.final_cost, rel=1e-11)
    again = bundle.solve(problem, **options | {"num_threads": 1})
    np.testing.assert_array_equal(again.problem.cam_from_world, found.problem.cam_from_world)


def test_images_that_share_nothing_are_solved_each_by_itself():
    """S is block-diagonal: the poses of a few images are those among many."""
    problem = scenes.make_problem(num_images=20, num_points=50, noise=0.5)
    of = {"refine": "poses", "backend": "fused", "function_tolerance": 0, "max_num_iterations": 30}
    whole = bundle.solve(problem, **of).problem
    some = bundle.solve(problem, **of, fixed_image_ids=range(4, 21)).problem
    np.testing.assert_allclose(some.cam_from_world[:3], whole.cam_from_world[:3], atol=1e-9)
    assert (some.cam_from_world[3:] == problem.cam_from_world[3:]).all()


def test_inspection_counts_the_system_of_the_cameras():
    problem = shared()
    inspection = bundle.inspect(problem, refine=LENS, num_threads=1)
    assert inspection.num_free_points == 0
    summary = bundle.solve(problem, backend="fused", **OPTIONS).summary
    row = next(
        one
        for one in inspection.methods
        if one.backend == "FUSED" and one.linear_solver_type == summary.linear_solver_type_used
    )
    assert row.num_unknowns == summary.num_parameters
    assert row.nnz_information == summary.num_information_nonzeros
    assert row.nnz_factor == summary.num_factor_nonzeros
