"""Inner constraints leave out points without parallax, and notes say what else is off a gauge."""

import numpy as np
import pytest

import bundle
from bundle.model.rigid_motions import rotation_matrices
from tests.analysis.uncertainty.dense import scatter
from tests.scenes import make_problem

FAR = 7  # row of the point


def without_point(problem, row):
    keep = problem.observation_point != row
    names = [f"observation_{name}" for name in ("image", "point", "xy", "keypoint")]
    return problem.replace(**{name: getattr(problem, name)[keep] for name in names})


def scene(distance, num_images=5, seed=1):
    """One point far along a direction that all images see, refined but for intrinsics."""
    problem = make_problem(
        num_images=num_images, num_points=25, seed=seed, perturbation=0, noise=0.2, model="PINHOLE"
    )
    points = problem.points.copy()
    points[FAR] = distance * np.array([0.05, -0.1, 1.0])
    far = problem.replace(points=points)
    mine = far.observation_point == FAR
    xy = far.observation_xy.copy()
    errors = bundle.model.residuals.linearize(far).residual
    xy[mine] += errors[mine] + 0.1 * np.random.default_rng(seed).standard_normal((mine.sum(), 2))
    return far.replace(observation_xy=xy)


def similarities(problem):
    """Derivatives of (w, t) of images, then of points, by the similarities of the world."""
    n = np.zeros((6 * problem.num_images + 3 * problem.num_points, 7))
    for i, pose in enumerate(problem.cam_from_world):
        rotation = rotation_matrices(pose[None, :4])[0]
        n[6 * i : 6 * i + 3, 3:6] = n[6 * i + 3 : 6 * i + 6, :3] = -rotation
        n[6 * i + 3 : 6 * i + 6, 6] = pose[4:]
    for p, point in enumerate(problem.points):
        rows = slice(6 * problem.num_images + 3 * p, 6 * problem.num_images + 3 * p + 3)
        n[rows] = np.hstack([np.eye(3), np.cross(np.eye(3), point).T, point[:, None]])
    return n


def constrained_without(problem, out, *, sandwich):
    """P G P^T by dense matrices, P = I - N (E N)^T with (E N)^T N = I, E without point `out`."""
    linear = bundle.model.residuals.linearize(problem)
    of_poses, count = 6 * problem.num_images, problem.num_observations
    jacobian = np.zeros((count, 2, of_poses + 3 * problem.num_points))
    for k in range(count):
        i, p = problem.observation_image[k], problem.observation_point[k]
        jacobian[k, :, 6 * i : 6 * i + 6] = linear.d_pose[k]
        jacobian[k, :, of_poses + 3 * p : of_poses + 3 * p + 3] = linear.d_point[k]
    jacobian = jacobian.reshape(2 * count, -1)
    scale = 1 / np.linalg.norm(jacobian, axis=0)
    root = np.linalg.pinv(jacobian * scale, rcond=1e-6) * scale[:, None]
    n = similarities(problem)
    part = n.copy()
    part[of_poses + 3 * out : of_poses + 3 * out + 3] = 0
    project = np.eye(len(n)) - n @ np.linalg.solve(part.T @ n, part.T)
    of_point = np.arange(len(n)) >= of_poses
    cov = root @ root.T
    if sandwich:
        cov = scatter(jacobian, linear.residual.ravel(), root, root, n, of_point)
    return project @ cov @ project.T


@pytest.mark.parametrize("robust", ["weights", "sandwich"])
@pytest.mark.parametrize("num_images", [5, 52])
def test_a_point_at_infinity_does_not_hold_the_world(robust, num_images):
    """A dense S, and a sparse one with passes over points."""
    problem = scene(1e9, num_images)
    refine = ("poses", "points")
    cov = bundle.covariance(problem, refine=refine, robust=robust, relative=[(1, 3)])
    assert cov.null_point_ids.tolist() == [FAR + 1]
    expected = constrained_without(problem, FAR, sandwich=robust == "sandwich")
    for i in range(problem.num_images):
        block = expected[6 * i : 6 * i + 6, 6 * i : 6 * i + 6]
        assert cov.pose_covariance[i] == pytest.approx(block, abs=1e-6 * block.max())
    for p in (0, 12):
        first = 6 * problem.num_images + 3 * p
        block = expected[first : first + 3, first : first + 3]
        assert cov.point_covariance[p] == pytest.approx(block, abs=1e-6 * block.max())
    two = bundle.covariance(
        problem, refine=refine, robust=robust, relative=[(1, 3)], gauge="two_cameras"
    )
    rotation = two.relative_covariance[0, :3, :3]
    assert cov.relative_covariance[0, :3, :3] == pytest.approx(rotation, abs=1e-6 * rotation.max())
    assert cov.notes == two.notes


@pytest.mark.parametrize("robust", ["weights", "sandwich"])
def test_a_point_that_is_seen_once_says_nothing_of_the_world(robust):
    problem = make_problem(num_images=5, num_points=30, seed=1, perturbation=0, noise=0.2)
    names = [f"observation_{name}" for name in ("image", "point", "xy", "keypoint")]
    once = (problem.observation_point != FAR) | (problem.observation_image == 0)
    lonely = problem.replace(**{name: getattr(problem, name)[once] for name in names})
    xy = lonely.observation_xy.copy()
    mine = lonely.observation_point == FAR  # at the minimum, its residual is 0
    xy[mine] += bundle.model.residuals.linearize(lonely).residual[mine]
    lonely = lonely.replace(observation_xy=xy)
    cov = bundle.covariance(lonely, robust=robust)
    without = bundle.covariance(without_point(problem, FAR), robust=robust)
    scale = np.abs(without.pose_covariance).max()
    assert cov.pose_covariance == pytest.approx(without.pose_covariance, abs=1e-9 * scale)


def notes_beside(problem, **options):
    """Notes on the gauge: those that two cameras do not have."""
    settings = {"refine": ("poses", "points", "focal"), **options}
    usual = bundle.covariance(problem, **(settings | {"gauge": "two_cameras"})).notes
    return [note for note in bundle.covariance(problem, **settings).notes if note not in usual]


def test_points_that_dominate_are_named():
    """Parallax enough to be known, and so far that the world is held by their directions."""
    far = scene(2e3)
    assert len(bundle.covariance(far, refine=("poses", "points", "focal")).null_point_ids) == 0
    (note,) = notes_beside(far)
    assert str(FAR + 1) in note
    assert notes_beside(far, fixed_image_ids=(1, 2)) == []
    assert notes_beside(scene(20)) == []


def test_three_points_are_said_to_hold_too_much():
    problem = make_problem(num_images=5, num_points=25, seed=1, perturbation=0, noise=0.2)
    problem = bundle.solve(problem, refine=("poses", "points", "focal")).problem
    assert notes_beside(problem, gauge="inner") == []
    assert len(notes_beside(problem, gauge="three_points")) == 1
    for held in ({"fixed_point_ids": (1, 2, 3)}, {"fixed_image_ids": (1, 2)}):
        assert notes_beside(problem, gauge="three_points", **held) == []
    loose, tight = (bundle.covariance(problem, gauge=g) for g in ("inner", "three_points"))
    assert (tight.camera_covariance[:, 0, 0] < 0.999 * loose.camera_covariance[:, 0, 0]).all()
