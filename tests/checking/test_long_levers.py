"""Right Jacobians far from the origin, where rounding decides and rotations cross the camera."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from tests.checking.reprojection import check_few, skew


@pytest.mark.parametrize("seed", range(3))
def test_a_receiver_on_a_lever_is_decided(seed):
    """Positions are from the centre of the earth: the last digit of a residual is 1e-9 m."""
    rng = np.random.default_rng(seed)
    place = 6.37e6 * Rotation.random(random_state=rng).as_matrix()[0]
    measured = place + rng.normal(0, 1, 3)

    def function(values, factor=1.0):
        pose, lever = values
        turn = Rotation.from_quat(pose[:4]).as_matrix()
        by_pose = np.hstack([-turn @ skew(lever), turn])
        return turn @ lever + (pose[4:] - measured), [by_pose, factor * turn]

    pose = np.append(Rotation.random(random_state=rng).as_quat(), place)
    start = [pose, np.array([0.5, -0.2, 1.1])]
    settings = {"manifolds": ["se3", None], "tangent": "gtsam", "seed": seed}
    report = check_few(function, start, **settings)
    assert report.verdict == "correct", report
    wrong = check_few(lambda v: function(v, 1 + 1e-6), start, **settings)
    assert wrong.verdict == "wrong"


@pytest.mark.parametrize("seed", range(8))
def test_steps_that_cross_the_camera_leave_no_doubt(seed):
    """Distortion of high order: residuals beyond the camera's plane are 1e10 and more."""
    rng = np.random.default_rng(seed)
    turn, point = Rotation.random(random_state=rng), -2e4 + rng.normal(0, 200, 3)
    translation = [40.0, -60.0, 400.0] - turn.apply(point)
    k = np.array([0.1, 0.05, 0.01])

    def function(blocks):
        w, x, y, z = blocks[0]
        matrix = Rotation.from_quat([x, y, z, w]).as_matrix()
        seen = matrix @ point + translation
        u = seen[:2] / seen[2]
        square = u @ u
        radial = 1 + k @ square ** np.arange(1, 4)
        bend = 2 * (k @ (np.arange(1, 4) * square ** np.arange(3)))
        by_u = radial * np.eye(2) + bend * np.outer(u, u)
        by_seen = 800 * by_u @ np.array([[1, 0, -u[0]], [0, 1, -u[1]]]) / seen[2]
        turned = matrix @ point
        # Along the quaternion q: R(q + d) turns by 2 (d q^-1), and nothing moves along q itself.
        to_turn = 2 * np.array([[-x, w, -z, y], [-y, z, w, -x], [-z, -y, x, w]])
        to_turn /= blocks[0] @ blocks[0]
        return 800 * radial * u, [by_seen @ -skew(turned) @ to_turn]

    start = [np.roll(turn.as_quat(), 1)]
    report = bundle.check_gradients(function, start, ["quaternion_wxyz"], seed=seed, num_samples=3)
    assert report.verdict == "correct", report
