"""FOV near |omega| = 0.01, where COLMAP's formula jumps: no solve of either backend stays there."""

import numpy as np
import pycolmap
import pytest

import bundle
from tests import scenes

TIGHT = {
    "function_tolerance": 1e-14,
    "gradient_tolerance": 1e-12,
    "parameter_tolerance": 1e-12,
    "max_num_iterations": 200,
}


def pinholes(seed, **settings):
    return scenes.make_problem(
        **{"num_images": 5, "num_points": 60, "seed": seed, "shared": True, **settings},
        model="PINHOLE",
    )


def as_fov(problem, omega):
    """Return a problem of pinholes as one of FOV lenses; omega by camera."""
    params = np.column_stack([problem.camera_params, np.broadcast_to(omega, problem.num_cameras)])
    return problem.replace(camera_models=["FOV"] * problem.num_cameras, camera_params=params)


def omegas(result):
    return np.abs(result.problem.camera_params[:, 4])


@pytest.mark.parametrize("seed", range(6))
def test_none_ends_above_its_pinhole(solve, seed):
    problem = pinholes(seed)
    pinhole = bundle.solve(problem, **TIGHT).summary.final_cost
    found = []
    for omega in (0.3, 0.0101):
        result = solve(as_fov(problem, omega), **TIGHT)
        assert result.summary.final_cost <= pinhole * (1 + 1e-9)
        assert result.summary.termination_type == "CONVERGENCE"
        found.append(result.summary.final_cost)
    changed = solve(bundle.change_camera_model(problem, "FOV").problem, **TIGHT)
    np.testing.assert_allclose(changed.summary.final_cost, found, rtol=1e-7)


@pytest.mark.parametrize("omega", [0.0, 1e-12, 1e-6, -1e-4, 3e-3, 0.0099999, 0.01, -0.0100001])
def test_every_start_near_the_jump_leaves_it(solve, omega):
    """The lens of the scene has an omega of 0.7; pixels are COLMAP's at the end."""
    problem = scenes.make_problem(
        num_images=5, num_points=60, model="FOV", shared=True, noise=0.3, seed=3
    )
    params = problem.camera_params.copy()
    params[:, 4] = 0.7
    good = solve(problem.replace(camera_params=params), **TIGHT)
    params[:, 4] = omega
    start = problem.replace(camera_params=params)
    result = solve(start, **TIGHT)
    assert result.summary.final_cost == pytest.approx(good.summary.final_cost, rel=1e-7)
    assert omegas(result) == pytest.approx(omegas(good), rel=1e-3)
    assert "formula_jump" in result.summary.warning_kinds
    assert result.summary.initial_cost == pytest.approx(cost_by_pycolmap(start), rel=1e-9)
    assert result.summary.final_cost == pytest.approx(cost_by_pycolmap(result.problem), rel=1e-9)


def cost_by_pycolmap(problem):
    total = 0.0
    for image in range(problem.num_images):
        camera = pycolmap.Camera(
            model="FOV", width=1000, height=1000, params=problem.camera_params[0]
        )
        mine = problem.observation_image == image
        pixels = camera.img_from_cam(pycolmap_points(problem, image, mine))
        total += 0.5 * float(np.sum((pixels - problem.observation_xy[mine]) ** 2))
    return total


def pycolmap_points(problem, image, which):
    """Return points of observations in the frame of the camera."""
    pose = problem.cam_from_world[image]
    moved = pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:4]), pose[4:])
    return np.array([moved * point for point in problem.points[problem.observation_point[which]]])


@pytest.mark.parametrize("start", [0.006, 0.0, 0.0101, 0.4])
def test_a_minimum_within_the_jump_is_found(solve, start):
    """COLMAP's lens of omega = 0.006 has the other sign, as no omega beyond the jump has it."""
    problem = as_fov(pinholes(4, noise=0.0), 0.006)
    scene = as_fov(pinholes(4, noise=0.0, perturbation=0.0), 0.006)
    xy = problem.observation_xy.copy()
    for image in range(problem.num_images):
        mine = problem.observation_image == image
        moved = pycolmap_points(scene, image, mine)
        xy[mine] = bundle.project("FOV", scene.camera_params[0], moved)[0]
    params = problem.camera_params.copy()
    params[:, 4] = start
    result = solve(problem.replace(observation_xy=xy, camera_params=params), **TIGHT)
    assert result.summary.final_cost < 1e-12
    assert omegas(result) == pytest.approx(0.006, rel=1e-4)


def test_iterations_are_those_of_one_solve(solve):
    seen = []
    result = solve(
        as_fov(pinholes(2), 0.004),
        progress=lambda record: seen.append(record["iteration"]),
        **TIGHT,
    )
    numbers = result.iterations["iteration"]
    assert numbers.tolist() == list(range(len(numbers)))
    assert seen[: len(numbers)] == numbers.tolist()
    assert (np.diff(result.iterations["cumulative_time_in_seconds"]) >= 0).all()
    assert result.summary.final_cost == pytest.approx(result.iterations["cost"].min(), rel=1e-12)


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_the_limit_of_iterations_counts_all_solves(solve, count):
    problem = as_fov(pinholes(1), 0.004)
    result = solve(problem, **{**TIGHT, "max_num_iterations": count})
    assert len(result.iterations["cost"]) <= count + 1
    assert result.summary.termination_type == "NO_CONVERGENCE"
    assert result.summary.final_cost <= result.summary.initial_cost
    if count == 0:
        assert result.problem.camera_params.tolist() == problem.camera_params.tolist()


def test_what_is_held_or_bounded_stays(solve):
    problem = as_fov(pinholes(0), 0.004)
    held = solve(problem, refine="poses,points,focal")
    assert omegas(held).tolist() == [0.004]
    lower, upper = np.full(5, -np.inf), np.full(5, np.inf)
    lower[4], upper[4] = 0.003, 0.5
    bounded = solve(problem, bounds={("camera", 1): (lower, upper)}, **TIGHT)
    assert 0.003 <= omegas(bounded)[0] <= 0.5
    for result in (held, bounded):
        assert "formula_jump" not in result.summary.warning_kinds


def test_lenses_of_both_kinds_in_one_problem(solve):
    problem = pinholes(2, shared=False)
    pinhole = bundle.solve(problem, **TIGHT).summary.final_cost
    result = solve(as_fov(problem, [0.0, 0.0101, 0.3, 0.005, 0.02]), **TIGHT)
    assert result.summary.final_cost <= pinhole * (1 + 1e-9)


def test_a_solver_object_steps_over_it_again():
    problem = as_fov(pinholes(1), 0.0)
    solver = bundle.Solver(problem, **TIGHT)
    first, second = solver.solve(problem), solver.solve(problem)
    once = bundle.solve(problem, **TIGHT)
    assert first.summary.final_cost == second.summary.final_cost == once.summary.final_cost
    assert first.problem.camera_params.tolist() == once.problem.camera_params.tolist()
