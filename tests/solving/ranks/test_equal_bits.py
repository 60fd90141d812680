"""Hundreds of conjugate gradients end at the same bits, whoever summed up what."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import bundle
from tests.rig_scenes import rig_problem
from tests.scenes import make_problem
from tests.solving.ranks.thread_crew import alone_and_divided

ROOT = Path(__file__).parents[3]
OPTIONS = {
    "linear_solver_type": "iterative_schur",
    "preconditioner_type": "schur_jacobi",
    "max_num_iterations": 8,
}


def street(**changes):
    size = {"scene": "street", "num_images": 24, "num_points": 400, "seed": 3}
    return bundle.synthesize(**(size | changes)).problem


def solves(problem, num_ranks, **options):
    return alone_and_divided(problem, num_ranks, **(OPTIONS | options))


def assert_same_bits(alone, divided):
    for name in ("linear_solver_iterations", "step_is_successful", "trust_region_radius"):
        assert list(divided.iterations[name]) == list(alone.iterations[name])
    costs = divided.iterations["cost"], alone.iterations["cost"]
    np.testing.assert_allclose(*costs, rtol=1e-14, atol=0)  # sums of squares, in any order
    for name in ("cam_from_world", "camera_params", "points"):
        np.testing.assert_array_equal(
            getattr(divided.problem, name), getattr(alone.problem, name), err_msg=name
        )


@pytest.mark.parametrize("num_ranks", [1, 2, 3, 4])
@pytest.mark.parametrize("preconditioner", ["identity", "jacobi", "schur_jacobi", "two_level"])
def test_by_each_preconditioner(num_ranks, preconditioner):
    alone, divided = solves(street(), num_ranks, preconditioner_type=preconditioner)
    assert_same_bits(alone, divided)
    if preconditioner == "identity":
        assert max(alone.iterations["linear_solver_iterations"]) > 100


def test_with_refined_sensors():
    """The Jacobian by a sensor is multiplied by a map for each observation."""
    alone, divided = solves(
        rig_problem(num_frames=18, num_points=120),
        3,
        refine=("poses", "points", "focal", "extra", "sensor_from_rig"),
    )
    assert_same_bits(alone, divided)


@pytest.mark.parametrize("solver", ["dense_schur", "iterative_schur"])
def test_with_held_points(solver):
    options = {"refine": ("poses", "focal", "extra"), "linear_solver_type": solver}
    alone, divided = solves(street(), 3, **options)
    assert_same_bits(alone, divided)
    assert alone.iterations["cost"][-1] < 0.9 * alone.iterations["cost"][0]


def positions(problem):
    """Half a unit beside where the images are."""
    places = zip(problem.image_ids, problem.projection_centers, strict=True)
    return [
        bundle.PositionFactor(
            ("image", int(key)), np.add(centre, (0.3, -0.3, 0.2 * (-1) ** i)), np.eye(3)
        )
        for i, (key, centre) in enumerate(places)
    ]


def far_start():
    """Columns outgrow their room with the first steps."""
    return street(rotation_noise=2.0, translation_noise=0.3, point_noise=0.5)


def mixed_widths():
    problem = make_problem(num_images=24, num_points=150, model="SIMPLE_RADIAL")
    models = list(problem.camera_models)
    params = np.zeros((problem.num_cameras, 8))
    params[:, :4] = problem.camera_params
    for camera in range(0, len(models), 3):
        models[camera] = "OPENCV"
        f, cx, cy, k = problem.camera_params[camera]
        params[camera] = f, f, cx, cy, k, 0, 0, 0
    return problem.replace(camera_models=tuple(models), camera_params=params)


CASES = {
    "one camera": (lambda: street(cameras="shared"), {}),
    "blocks of nine columns": (lambda: street(camera_model="RADIAL", cameras="individual"), {}),
    "blocks of twelve columns": (lambda: street(camera_model="OPENCV", cameras="individual"), {}),
    "models of several widths": (mixed_widths, {}),
    "loss": (lambda: street(outlier_share=0.1), {"loss": "cauchy", "loss_scale": 2.0}),
    "far start": (far_start, {}),
    "held images": (street, {"fixed_image_ids": (2, 9), "fixed_point_ids": (5, 6, 77)}),
    "rig": (lambda: rig_problem(num_frames=18, num_points=120), {}),
    "two cameras as the gauge": (street, {"gauge": "two_cameras"}),
}


@pytest.mark.parametrize("case", CASES)
def test_with(case):
    make, options = CASES[case]
    assert_same_bits(*solves(make(), 3, **options))


def test_with_factors_of_images():
    """Theirs come last: they are on no grid."""
    problem = street()
    assert_same_bits(*solves(problem, 3, factors=positions(problem)))


def test_all_stop_where_the_gradient_of_everything_is_small():
    problem = street()
    factors = positions(problem)
    options = {"linear_solver_type": "dense_schur", "function_tolerance": 1e-15}
    ended = bundle.solve(problem, factors=factors, **options)
    small = 1e-2
    assert ended.iterations["gradient_max_norm"][-1] < small
    assert bundle.solve(ended.problem, **options).iterations["gradient_max_norm"][0] > small
    alone, divided = solves(ended.problem, 2, factors=factors, gradient_tolerance=small)
    assert len(alone.iterations["cost"]) == 1
    assert_same_bits(alone, divided)


def test_points_in_any_order():
    """One process gives the same bits for the same points in another order."""
    problem = street()
    order = np.random.default_rng(0).permutation(problem.num_points)
    place = np.argsort(order).astype(np.int32)
    shuffled = problem.replace(
        points=problem.points[order],
        point_ids=problem.point_ids[order],
        observation_point=place[problem.observation_point],
    )
    alone = bundle.solve(problem, **OPTIONS)
    other = bundle.solve(shuffled, **OPTIONS)
    np.testing.assert_array_equal(other.problem.cam_from_world, alone.problem.cam_from_world)
    np.testing.assert_array_equal(other.problem.points, alone.problem.points[order])


@pytest.mark.parametrize("instructions", ["baseline", "avx2"])
def test_with_other_instructions(instructions):
    """Without fused multiply-adds, products are rounded before they are added."""
    program = """
from tests.solving.ranks import test_equal_bits as tests
tests.test_points_in_any_order()
for case in ("one camera", "blocks of twelve columns", "loss"):
    tests.test_with(case)
"""
    subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"BUNDLE_INSTRUCTION_SET": instructions},
        cwd=ROOT,
        check=True,
    )


def test_a_solver_that_is_used_again():
    """It has no grid of the solve before, here that of residuals ten thousand times as large."""
    noisy, exact = street(), street(pixel_noise=0.0)
    exact = bundle.solve(exact, function_tolerance=1e-15).problem
    solver = bundle.Solver(noisy, num_threads=1, **OPTIONS)
    assert solver.solve(noisy).summary.final_cost > 1
    again, once = solver.solve(exact), bundle.solve(exact, num_threads=1, **OPTIONS)
    assert once.summary.initial_cost < 1e-8
    np.testing.assert_array_equal(again.iterations["cost"], once.iterations["cost"])
    np.testing.assert_array_equal(again.problem.points, once.problem.points)


def test_a_grid_changes_little():
    """Its spacing is far below what conjugate gradients leave: costs stay those of Ceres."""
    problem = street(num_images=14, num_points=300)
    options = {"max_num_iterations": 4, "preconditioner_type": "schur_jacobi"}
    ours = bundle.solve(problem, **(OPTIONS | options))
    ceres = bundle.solve(problem, backend="ceres", **(OPTIONS | options))
    np.testing.assert_allclose(ours.iterations["cost"], ceres.iterations["cost"], rtol=1e-6)


def test_however_many_cores_openblas_has():
    """A launcher may bind a process to one; the factor of a coarse space is OpenBLAS'."""
    program = """
import bundle
problem = bundle.synthesize(
    scene="photo-collection", num_images=100, num_points=2000, seed=3
).problem
summary = bundle.solve(
    problem, linear_solver_type="iterative_schur", preconditioner_type="two_level",
    num_threads=2, max_num_iterations=4,
)
print(summary.problem.points.tobytes().hex())
"""
    points = [
        subprocess.run(
            [sys.executable, "-c", program],
            env=os.environ | {"OPENBLAS_NUM_THREADS": str(count)},
            capture_output=True,
            check=True,
        ).stdout
        for count in (1, 4)
    ]
    assert len(points[0]) > 2000 * 3 * 16
    assert points[0] == points[1]
