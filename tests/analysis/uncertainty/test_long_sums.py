"""Covariances of small problems, whose points are eliminated from rows and summed up long."""

import re

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


@pytest.mark.parametrize(
    ("loss", "scale"),
    [("huber", 0.5), ("soft_l1", 0.4), ("cauchy", 0.8), ("arctan", 1.5), ("tukey", 6.0)],
)
@pytest.mark.parametrize("track", [None, 3])
def test_a_sandwich_at_a_minimum_is_that_of_the_dense_form(loss, scale, track):
    """With outliers, whose curvature along their residuals is negative or zero."""
    problem = make_problem(
        num_images=5, num_points=30, seed=9, perturbation=0, noise=0.3, track=track
    )
    xy = problem.observation_xy.copy()
    xy[::17] += 4.0
    given = {"loss": loss, "loss_scale": scale}
    refine = {"refine": ("poses", "points"), "function_tolerance": 1e-12}
    problem = bundle.solve(problem.replace(observation_xy=xy), **refine, **given).problem
    dense = Dense(problem, **given)
    assert (dense.along < 0.1).any()
    basis = np.eye(len(dense.names))[:, [name[0] != "camera" for name in dense.names]]
    curvature = dense.curvature(basis)
    assert 0.1 < curvature < 0.99
    cov = bundle.covariance(problem, robust="sandwich", relative=[(1, 5)], **refine, **given)
    whole = dense.covariance(basis, sandwich=True)
    assert max(compare(Case(problem, {}, [], dense, basis, 0), whole, cov).values()) < 1e-9
    moves = np.zeros((6, len(whole)))
    first, second = (dense.column["image", i, 0] for i in (0, 4))
    moves[:, first : first + 6], moves[:, second : second + 6] = relative_moves(problem, 0, 4)
    expected = moves @ whole @ moves.T
    assert cov.relative(1, 5) == pytest.approx(expected, abs=1e-9 * expected.max())


def test_the_last_step_follows_the_curvature_of_the_loss():
    """Off the minimum, the step of H = kappa G promises 1 / kappa as much as that of G."""
    problem = make_problem(num_images=5, num_points=30, seed=9, noise=0.3, perturbation=3e-3)
    given = {"loss": "cauchy", "loss_scale": 3.0}
    dense = Dense(problem, **given)
    refined = np.eye(len(dense.names))[:, [name[0] != "camera" for name in dense.names]]
    shares = []
    for robust in ("weights", "sandwich"):
        cov = bundle.covariance(problem, robust=robust, refine=("poses", "points"), **given)
        shares += [float(share) for share in re.findall(r"([\d.]+) %", " ".join(cov.notes))]
    ratio = shares[0] / shares[1]
    assert ratio == pytest.approx(dense.curvature(refined), rel=2e-3)


def relative_moves(problem, a, b):
    """Derivatives of the pose b from a by (w, t) of each, both by left perturbations."""
    turns = [Rotation.from_quat(q).as_matrix() for q in problem.cam_from_world[[a, b], :4]]
    turn = turns[1] @ turns[0].T
    arm = np.cross(np.eye(3), turn @ problem.cam_from_world[a, 4:])
    zero = np.zeros((3, 3))
    by_a = np.block([[-turn, zero], [-arm @ turn, -turn]])
    return by_a, np.block([[np.eye(3), zero], [arm, np.eye(3)]])


@pytest.mark.parametrize("seed", [5, 11, 7, 86])
def test_losses_that_are_flat_or_concave_along_many_residuals(seed):
    """Far off a minimum: in 5 and 86 negative ones count as flat, 7 and 11 have no sandwich."""
    entries = compare_seed(seed, joins_points=False)
    entry = next(entry for entry in entries if entry.robust == "sandwich")
    assert (entry.kind == "singular") == (seed in (7, 11))
    assert entry.difference < TOLERANCE
