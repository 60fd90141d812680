"""Four poses of a reference, an estimate of them in another frame, and their errors to nine digits.

The estimate is scaled by 2, turned by 90 degrees about z and moved by (1, 2, 3).
"""

import numpy as np
from scipy.spatial.transform import Rotation

from bundle.model.pose_table import PoseTable

NAMES = tuple(f"i{k}.jpg" for k in range(4))


def table(angles, centers, names=NAMES):
    """Poses of rotation vectors world_from_camera in degrees, and of centres."""
    turns = Rotation.from_rotvec(angles, degrees=True)
    return PoseTable(np.hstack([turns.as_quat(), centers]), names)


def moved(poses, scale, vector, shift):
    """A table in another world."""
    turn = Rotation.from_rotvec(vector, degrees=True)
    rotations = turn * Rotation.from_quat(poses.poses[:, :4])
    centers = scale * poses.poses[:, 4:] @ turn.as_matrix().T + shift
    return PoseTable(np.hstack([rotations.as_quat(), centers]), poses.names, poses.timestamps_ns)


REFERENCE = table(
    [(0, 0, 0), (0, 10, 0), (0, 20, 5), (-5, 30, 0)],
    [(0, 0, 0), (1, 0, 0), (2, 0.5, 0), (3, 0.5, 1)],
)
ESTIMATE = moved(
    table(
        [(1, 0, 0), (0, 12, 0), (0, 20, 9), (-5, 25, 0)],
        [(0.02, 0, 0), (1.01, 0.03, 0), (1.95, 0.52, 0.04), (3.1, 0.4, 1.05)],
    ),
    2.0,
    (0, 0, 90),
    (1.0, 2.0, 3.0),
)

SCALE = 0.491379387
APE = 0.044553504, 9.572976504
RIGID = 1.267662081
RPE = 0.142483919, 4.622184024
AUC = {
    "trapezoid": (0.0, 0.093114, 0.206665, 0.532889, 0.844296),
    "colmap": (0.0, 0.067778, 0.176520, 0.512875, 0.837625),
    "histogram": (0.0, 0.055556, 0.2, 0.516667, 0.838889),
    "integral": (0.0, 0.019560, 0.132646, 0.450917, 0.816972),
}


def path(count=40, seed=0):
    """A table of poses along a winding path in three dimensions."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 4, count)
    centers = np.column_stack([t, np.sin(2 * t), 0.5 * np.cos(3 * t)])
    turns = Rotation.from_rotvec(0.2 * rng.standard_normal((count, 3)) + [0, 0, 1])
    return PoseTable(
        np.hstack([turns.as_quat(), centers]), tuple(f"{k:04}.png" for k in range(count))
    )


def noisy(poses, length=0.01, degrees=0.5, seed=1):
    """A table with noise on centres and rotations."""
    rng = np.random.default_rng(seed)
    noise = Rotation.from_rotvec(degrees * rng.standard_normal((len(poses), 3)), degrees=True)
    turns = Rotation.from_quat(poses.poses[:, :4]) * noise
    centers = poses.poses[:, 4:] + length * rng.standard_normal((len(poses), 3))
    return PoseTable(np.hstack([turns.as_quat(), centers]), poses.names, poses.timestamps_ns)
