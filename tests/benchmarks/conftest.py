from __future__ import annotations

import numpy as np
import pytest

from benchmarks import bal


@pytest.fixture
def scene() -> bal.Bal:
    """Five cameras on an arc, 40 points seen by all, half a pixel of noise, a perturbed start."""
    rng = np.random.default_rng(7)
    num_cameras, num_points = 5, 40
    angles = np.linspace(-0.4, 0.4, num_cameras)
    cameras = np.zeros((num_cameras, 9))
    cameras[:, 1] = angles
    cameras[:, :3] += rng.normal(0.0, 0.02, (num_cameras, 3))
    cameras[:, 5] = -10.0  # BAL cameras look along -z
    cameras[:, 6:] = [800.0, -0.05, 0.01]
    points = rng.uniform(-2.0, 2.0, (num_points, 3))
    camera_index = np.repeat(np.arange(num_cameras), num_points)
    point_index = np.tile(np.arange(num_points), num_cameras)
    exact = bal.Bal(camera_index, point_index, np.zeros((len(camera_index), 2)), cameras, points)
    xy = bal.residuals(exact) + rng.normal(0.0, 0.5, (len(camera_index), 2))
    return bal.Bal(
        camera_index,
        point_index,
        xy,
        cameras + rng.normal(0.0, 1e-3, cameras.shape),
        points + rng.normal(0.0, 1e-2, points.shape),
    )
