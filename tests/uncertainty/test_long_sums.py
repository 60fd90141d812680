"""Covariances of small problems, whose points are eliminated from rows and summed up long."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from tests.campaigns.covariance import TOLERANCE, compare_seed
from tests.scenes import make_problem
from tests.uncertainty.test_point_passes import OBSERVATIONS


@pytest.mark.parametrize(
    ("seed", "robust"), [(69, "weights"), (169, "sandwich"), (198, "sandwich")]
)
def test_small_problems_lose_nothing_by_sums_of_squares(seed, robust):
    """These would: rounded as sums of squares, 1e-8 and more of a sigma."""
    entry = next(entry for entry in compare_seed(seed) if entry.robust == robust)
    assert entry.rounding > 5 * TOLERANCE
    assert entry.difference < 2e-9


@pytest.mark.parametrize("robust", ["weights", "sandwich"])
def test_a_ray_along_an_axis_leaves_its_point_out(robust):
    """Of a point that one image sees, the derivative along the ray is zero, whatever its axis."""
    problem = make_problem(num_images=4, num_points=20, seed=7, perturbation=0, noise=0.3)
    seen_once = (problem.observation_point == 3) & (problem.observation_image != 0)
    kept = {name: getattr(problem, name)[~seen_once] for name in OBSERVATIONS}
    problem = bundle.solve(problem.replace(**kept), function_tolerance=1e-15).problem
    poses = problem.cam_from_world.copy()
    turn = Rotation.from_quat(poses[0, :4])
    ray = problem.points[3] + turn.inv().apply(poses[0, 4:])
    to_axis, _ = Rotation.align_vectors([1, 0, 0], ray)
    poses[:, :4] = (Rotation.from_quat(poses[:, :4]) * to_axis.inv()).as_quat()
    turned = problem.replace(points=to_axis.apply(problem.points.copy()), cam_from_world=poses)
    expected = bundle.covariance(problem, robust=robust)
    found = bundle.covariance(turned, robust=robust)
    assert expected.null_point_ids == found.null_point_ids == [problem.point_ids[3]]
    scale = np.abs(expected.pose_covariance).max()
    assert found.pose_covariance == pytest.approx(expected.pose_covariance, abs=1e-9 * scale)
