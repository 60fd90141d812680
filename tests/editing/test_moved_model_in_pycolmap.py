"""A model moved to a global shutter, refined by pycolmap, ends at the rolling-shutter poses.

The rolling-shutter minimum is that of a Gauss-Newton method here, by sparse algebra over all
unknowns: independent of the solvers of bundle.
"""

import numpy as np
import pycolmap
import pytest
import scipy.sparse as sparse
from scipy.sparse.linalg import spsolve

import bundle
from bundle.analysis.diagnosis.shutter_modes import shutter_jacobians
from bundle.georeference.similarity import umeyama
from bundle.model.rigid_motions import (
    cross_matrices,
    multiply_poses,
    quaternion_from_vector,
    rotation_matrices,
)
from bundle.model.shutter_motion import moved
from bundle.synthetic.video_scene import film
from tests.editing.test_global_shutter import rolling_residuals


def block_rows(blocks, index, count):
    """Return the sparse (2 n, width * count) matrix of (n, 2, width) blocks in some columns."""
    n, _, width = blocks.shape
    rows = np.repeat(np.arange(2 * n), width)
    columns = width * np.repeat(index, 2 * width) + np.tile(np.arange(width), 2 * n)
    return sparse.csr_matrix((blocks.ravel(), (rows, columns)), shape=(2 * n, width * count))


def solved(problem):
    """Return the problem at its minimum with free twists, and the normal equations there."""
    images, rows = problem.num_images, np.arange(problem.num_observations)
    for _ in range(30):
        by_image, by_point, known = shutter_jacobians(problem, rows)
        assert known.all()
        jacobian = sparse.hstack(
            [
                block_rows(by_image, problem.observation_image, images),
                block_rows(by_point, problem.observation_point, problem.num_points),
            ]
        ).tocsr()
        normal = (jacobian.T @ jacobian).tocsc()
        damped = normal + sparse.diags(1e-9 * normal.diagonal())
        step = -spsolve(damped, jacobian.T @ rolling_residuals(problem).ravel())
        change = step[: 12 * images].reshape(images, 12)
        turn = quaternion_from_vector(change[:, :3])
        shift = moved(change[:, :6], np.ones(images), np.zeros((images, 3)))
        shutter = problem.rolling_shutter
        problem = problem.replace(
            cam_from_world=multiply_poses(np.hstack([turn, shift]), problem.cam_from_world),
            points=problem.points + step[12 * images :].reshape(-1, 3),
            rolling_shutter=shutter.replace(twist=shutter.twist + change[:, 6:]),
        )
        if np.abs(step).max() < 1e-7:
            return problem, normal
    raise AssertionError("the method did not converge")


def position_sigmas(problem, normal, sigma):
    """Return (num_images,) standard deviations of positions after a similarity."""
    full = normal.toarray()
    scale = 1 / np.sqrt(np.diag(full))
    values, vectors = np.linalg.eigh(full * scale[:, None] * scale)
    assert values[6] < 1e-10 < values[7]
    inverse = (vectors[:, 7:] / values[7:]) @ vectors[:, 7:].T * scale[:, None] * scale
    rotation, count = rotation_matrices(problem.cam_from_world[:, :4]), problem.num_images
    to_center = np.zeros((3 * count, len(full)))
    for k in range(count):
        to_center[3 * k : 3 * k + 3, 12 * k + 3 : 12 * k + 6] = -rotation[k].T
    centered = problem.projection_centers - problem.projection_centers.mean(axis=0)
    free = np.zeros((3 * count, 7))
    for axis in range(3):
        free[axis::3, axis] = 1
    free[:, 3:6] = cross_matrices(centered).reshape(-1, 3)
    free[:, 6] = centered.ravel()
    rest = np.eye(3 * count) - free @ np.linalg.pinv(free)
    covariance = rest @ to_center @ inverse @ to_center.T @ rest
    return sigma * np.sqrt(np.diag(covariance).reshape(count, 3).sum(axis=1))


@pytest.mark.parametrize(
    ("kind", "images", "points"), [("orbit", 8, 150), ("street", 10, 250), ("drone_grid", 8, 150)]
)
def test_pycolmap_ends_within_a_small_part_of_a_sigma(kind, images, points):
    options = bundle.SceneOptions(
        scene=kind, num_images=images, num_points=points, rolling_shutter=0.9, seed=4
    )
    truth = film(options).ground_truth
    minimum, normal = solved(truth)
    made = bundle.to_global_shutter(minimum)
    model = made.problem.to_pycolmap()
    choices = pycolmap.BundleAdjustmentOptions()
    choices.refine_focal_length = choices.refine_extra_params = False
    choices.print_summary = False
    pycolmap.bundle_adjustment(model, choices)
    found = bundle.Problem.from_pycolmap(model).projection_centers
    expected = minimum.projection_centers
    apart = np.linalg.norm(umeyama(found, expected).apply(found) - expected, axis=1)
    sigmas = position_sigmas(minimum, normal, 0.5)
    assert (apart / sigmas).max() < made.motion
    # Without the moves, the same adjustment ends elsewhere.
    raw = truth.replace(rolling_shutter=None).to_pycolmap()
    pycolmap.bundle_adjustment(raw, choices)
    wrong = bundle.Problem.from_pycolmap(raw).projection_centers
    off = np.linalg.norm(umeyama(wrong, expected).apply(wrong) - expected, axis=1)
    assert np.sqrt((off**2).mean()) > 20 * np.sqrt((apart**2).mean())
