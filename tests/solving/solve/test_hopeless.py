"""Legal problems without a good answer: they end with a result, never a crash."""

import numpy as np
import pytest

import bundle
from tests import scenes
from tests.printed import figures, warning
from tests.solving.solve.problems import FUSED_SOLVERS

# Where there is nothing to eliminate, "auto" is Ceres.
SOLVERS = [
    *(("ceres", solver) for solver in (*FUSED_SOLVERS, "sparse_normal_cholesky", "cgnr")),
    *(("auto", solver) for solver in FUSED_SOLVERS),
]


def turned_away():
    """Every point behind every camera."""
    problem = scenes.make_problem()
    poses = problem.cam_from_world.copy()
    poses[:, 6] -= 50
    return problem.replace(cam_from_world=poses)


def disconnected():
    """Two pairs of images that share no point."""
    problem = scenes.make_problem(num_images=4, num_points=40)
    keep = (problem.observation_image < 2) == (problem.observation_point < 20)
    return restricted(problem, keep)


def restricted(problem, keep):
    return problem.replace(
        observation_image=problem.observation_image[keep],
        observation_point=problem.observation_point[keep],
        observation_xy=problem.observation_xy[keep],
        observation_keypoint=problem.observation_keypoint[keep],
    )


def seen_once():
    problem = scenes.make_problem()
    return restricted(problem, problem.observation_image == problem.observation_point % 5)


def duplicated():
    problem = scenes.make_problem()
    return restricted(problem, np.repeat(np.arange(problem.num_observations), 3))


def huge_coordinates():
    problem = scenes.make_problem()
    poses = problem.cam_from_world.copy()
    poses[:, 4:] *= 1e12
    return problem.replace(points=problem.points * 1e12, cam_from_world=poses)


def overflowing():
    """Distortion that leaves the range of doubles."""
    problem = scenes.make_problem()
    params = problem.camera_params.copy()
    params[0, 3] = 1e200
    points = problem.points.copy()
    points[0] *= 1e100
    return problem.replace(camera_params=params, points=points)


PROBLEMS = {
    "no observations": lambda: scenes.make_problem(num_points=0),
    "one image": lambda: scenes.make_problem(num_images=1),
    "one point": lambda: scenes.make_problem(num_points=1),
    "one observation": lambda: scenes.make_problem(num_images=1, num_points=1),
    "all behind": turned_away,
    "disconnected": disconnected,
    "points seen once": seen_once,
    "duplicated observations": duplicated,
    "huge coordinates": huge_coordinates,
    "overflowing": overflowing,
    "one camera for all": lambda: scenes.make_problem(shared=True, num_points=4),
    "nonsense measurements": lambda: scenes.make_problem(noise=1e6),
    "gigantic measurements": lambda: scenes.make_problem(noise=1e160),
}


@pytest.mark.parametrize("cheirality", ["zero", "algebraic"])
@pytest.mark.parametrize(("backend", "solver"), SOLVERS)
@pytest.mark.parametrize("name", PROBLEMS)
def test_ends_with_a_result(name, backend, solver, cheirality, capfd):
    problem = PROBLEMS[name]()
    result = bundle.solve(
        problem,
        backend=backend,
        linear_solver_type=solver,
        cheirality=cheirality,
        max_num_iterations=30,
    )
    summary = result.summary
    assert summary.message
    assert np.isfinite(result.problem.points).all()
    assert np.isfinite(result.problem.cam_from_world).all()
    if summary.is_solution_usable:
        assert summary.final_cost <= summary.initial_cost
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["overflowing", "gigantic measurements"])
def test_a_start_that_cannot_be_evaluated_is_not_usable_and_says_where(solve, name):
    summary = solve(PROBLEMS[name](), cheirality="algebraic").summary
    assert not summary.is_solution_usable
    assert "image 1, point 1" in warning(summary, "residual_not_finite")


def test_points_seen_once_are_counted(solve):
    problem = seen_once()
    assert figures(warning(solve(problem).summary, "points_seen_once")) == ["40", "1"]
    assert "points_seen_once" not in bundle.solve(problem, refine="poses").summary.warning_kinds


def test_points_of_one_image_each_are_no_reconstruction(solve):
    problem = seen_once()
    summary = (result := solve(problem)).summary
    assert "no_tracks" in summary.warning_kinds
    assert not summary.is_solution_usable
    assert "Converged" not in str(result)
    two = restricted(problem, np.r_[0, np.arange(problem.num_observations)])  # one seen twice
    others = (
        bundle.solve(two, max_num_iterations=2),
        *(
            bundle.solve(problem, max_num_iterations=2, **held)
            for held in (
                {"refine": "poses"},
                {"fixed_point_ids": problem.point_ids[:1].tolist()},
                {"constraints": ["cameras *: f prior 2 %"]},
                {"factors": [bundle.PriorFactor(("point", 1), problem.points[0], 0.1)]},
            )
        ),
    )
    for other in others:
        assert "no_tracks" not in other.summary.warning_kinds


def test_a_solution_that_is_no_reconstruction_is_dropped(solve):
    problem = turned_away()
    result = solve(problem, cheirality="algebraic", max_num_iterations=30)
    assert not result.summary.is_solution_usable
    assert "focal length f, found -" in warning(result.summary, "invalid_solution")
    assert (result.problem.camera_params == problem.camera_params).all()
    assert (result.problem.points == problem.points).all()
