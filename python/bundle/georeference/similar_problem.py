"""A problem moved by a similarity.

With x' = s R x + t the camera frames keep their axes and grow with the scene: a point at
R_c x + t_c before its camera is at s (R_c x + t_c) after. So

    R_c' = R_c R^T,  t_c' = s t_c - R_c' t,

and no projection changes. Frames of rigs move as cameras do, and rigs grow with the scene as well:
t_s' = s t_s for a sensor_from_rig.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.georeference.similarity import Similarity
from bundle.model.problem import Problem
from bundle.model.rig_arrays import placed
from bundle.model.rotations import (
    quaternion_from_matrix,
    quaternion_inverse,
    quaternion_multiply,
    rotation_matrices,
)

__all__ = ["moved"]


def moved(problem: Problem, similarity: Similarity) -> Problem:
    """Return the problem where the similarity puts it; observations and cameras stay."""
    changes = {"points": similarity.apply(problem.points)}
    poses = _moved_poses(problem.cam_from_world, similarity)
    if problem.num_frames:
        arms = problem.sensor_from_rig.copy()
        arms[:, 4:] *= similarity.scale
        changes["sensor_from_rig"] = arms
        changes["rig_from_world"] = _moved_poses(problem.rig_from_world, similarity)
        poses = placed(
            {name: getattr(problem, name) for name in ("image_frame", "image_sensor")}
            | {"cam_from_world": poses}
            | changes
        )
    return problem.replace(cam_from_world=poses, **changes)


def _moved_poses(poses: NDArray[np.float64], similarity: Similarity) -> NDArray[np.float64]:
    back = quaternion_inverse(quaternion_from_matrix(similarity.rotation[None]))
    quaternions = quaternion_multiply(poses[:, :4], back)
    turned = rotation_matrices(quaternions)
    translations = similarity.scale * poses[:, 4:] - turned @ similarity.translation
    return np.hstack([quaternions, translations])
