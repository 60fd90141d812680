"""Covariances of small problems, whose points are eliminated from rows and summed up long."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from tests.analysis.uncertainty.dense import Dense
from tests.analysis.uncertainty.random_problems import Case
from tests.analysis.uncertainty.test_covariance import compare
from tests.analysis.uncertainty.test_point_passes import OBSERVATIONS
from tests.campaigns.covariance import TOLERANCE, compare_seed
from tests.scenes import make_problem


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
    """The derivative of a point with one observation along its ray is zero for any axis."""
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


def test_observations_that_count_negatively_along_their_residual():
    """Observations beyond the scale of a Cauchy loss leave the sandwich without rows."""
    problem = make_problem(num_images=4, num_points=30, seed=9, perturbation=0, noise=0.3)
    xy = problem.observation_xy.copy()
    xy[::17] += 8.0
    loss = {"loss": "cauchy", "loss_scale": 2.0}
    problem = bundle.solve(
        problem.replace(observation_xy=xy), refine=("poses", "points"), **loss
    ).problem
    dense = Dense(problem, **loss)
    refined = [name[0] != "camera" for name in dense.names]
    jacobian = dense.jacobian[:, refined]
    shares = (jacobian * dense.residual[:, None]).reshape(-1, 2, sum(refined)).sum(axis=1)
    weighted = (dense.residual.reshape(-1, 2) ** 2).sum(axis=1)
    along = 1 - 2 / loss["loss_scale"] ** 2 * weighted
    assert (along < -0.1).any()
    hessian = jacobian.T @ jacobian - 2 / loss["loss_scale"] ** 2 * shares.T @ shares
    scale = 1 / np.sqrt(np.diag(hessian))
    null, _ = np.linalg.qr(dense.similarities()[refined])
    held, _ = np.linalg.qr(null / scale[:, None])
    inverse = np.linalg.inv(hessian * scale * scale[:, None] + held @ held.T)
    project = np.eye(len(scale)) - null @ null.T
    inverse = project @ (inverse * scale * scale[:, None]) @ project.T
    scatter = inverse @ (shares.T @ shares) @ inverse
    cov = bundle.covariance(problem, robust="sandwich", refine=("poses", "points"), **loss)
    expected = np.zeros((len(dense.names), len(dense.names)))
    expected[np.ix_(refined, refined)] = scatter
    case = Case(problem, {}, [], dense, np.eye(len(dense.names))[:, refined], 0)
    assert max(compare(case, expected, cov).values()) < 1e-8
