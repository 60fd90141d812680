"""A problem moved by a similarity.

With x' = s R x + t the camera frames keep their axes and grow with the scene: a point at
R_c x + t_c before its camera is at s (R_c x + t_c) after. So

    R_c' = R_c R^T,  t_c' = s t_c - R_c' t,

and no projection changes.
"""

from __future__ import annotations

import numpy as np

from bundle.georeference.similarity import Similarity
from bundle.problem import Problem
from bundle.rotations import (
    quaternion_from_matrix,
    quaternion_inverse,
    quaternion_multiply,
    rotation_matrices,
)

__all__ = ["moved"]


def moved(problem: Problem, similarity: Similarity) -> Problem:
    """Return the problem where the similarity puts it; observations and cameras stay."""
    back = quaternion_inverse(quaternion_from_matrix(similarity.rotation[None]))
    quaternions = quaternion_multiply(problem.cam_from_world[:, :4], back)
    turned = rotation_matrices(quaternions)
    translations = similarity.scale * problem.cam_from_world[:, 4:]
    translations = translations - turned @ similarity.translation
    return problem.replace(
        cam_from_world=np.hstack([quaternions, translations]),
        points=similarity.apply(problem.points),
    )
