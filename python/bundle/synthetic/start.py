"""Start values of a scene: the true problem with perturbed poses, points and cameras.

All random numbers come from one stream: first for images, then for points, then for cameras. If
points come in blocks, cameras are needed before the last point. Therefore two generators read the
stream, and the generator for the cameras skips the numbers of the points.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.interface.scene_options import SceneOptions
from bundle.model.problem import Problem
from bundle.model.rigid_motions import (
    dot,
    quaternion_from_vector,
    quaternion_inverse,
    quaternion_multiply,
    quaternion_rotate,
)
from bundle.synthetic.scene import FOCAL_PARAMS, RADIAL_PARAMS, TANGENTIAL_PARAMS, Intrinsics

Array = NDArray[np.float64]

# Number of random numbers to draw and discard at a time.
_SKIPPED = 1 << 20


class Start:
    """Perturbed images and cameras, and perturbation of points block by block.

    Rotation noise rotates about the projection centre, so that rotation and translation noise are
    independent.

    Args:
        seed: seed of the stream.
        truth: true images and cameras; its points are not used.
        cameras: true cameras.
        scale: scale of the scene, see ``median_distance``.
        options: amount of noise.

    Attributes:
        cam_from_world: (num_images, 7) perturbed poses.
        camera_params: (num_cameras, num_params) perturbed parameters.
    """

    def __init__(
        self,
        seed: np.random.SeedSequence,
        truth: Problem,
        cameras: Intrinsics,
        scale: float,
        options: SceneOptions,
    ) -> None:
        rng = np.random.default_rng(seed)
        rotations, translations = truth.cam_from_world[:, :4], truth.cam_from_world[:, 4:]
        centers = -quaternion_rotate(quaternion_inverse(rotations), translations)
        turn = np.radians(options.rotation_noise) * rng.standard_normal(centers.shape)
        turned = quaternion_multiply(quaternion_from_vector(turn), rotations)
        moved = centers + options.translation_noise * scale * rng.standard_normal(centers.shape)
        self.cam_from_world = np.concatenate([turned, -quaternion_rotate(turned, moved)], axis=1)
        self._point_sigma = options.point_noise * scale
        self._of_points = np.random.default_rng(seed)
        _skip(self._of_points, 2 * centers.size)
        _skip(rng, 3 * options.num_points)
        self.camera_params = _perturbed_params(rng, cameras, options)

    def points(self, true_points: Array) -> Array:
        """Return the start values of the scene's next points (n, 3); call it in order."""
        shift: Array = self._point_sigma * self._of_points.standard_normal(true_points.shape)
        return true_points + shift


def median_distance(problem: Problem) -> float:
    """Return the scale of a scene: the median distance of points from their observing cameras."""
    rotations, translations = problem.cam_from_world[:, :4], problem.cam_from_world[:, 4:]
    centers = -quaternion_rotate(quaternion_inverse(rotations), translations)
    to_point = problem.points[problem.observation_point] - centers[problem.observation_image]
    return float(np.median(np.sqrt(dot(to_point, to_point))))


def _skip(rng: np.random.Generator, count: int) -> None:
    for first in range(0, count, _SKIPPED):
        rng.standard_normal(min(_SKIPPED, count - first))


def _perturbed_params(
    rng: np.random.Generator, cameras: Intrinsics, options: SceneOptions
) -> Array:
    """Return start values (num_cameras, num_params) of the camera parameters.

    All focal lengths of a camera are multiplied by the same factor, which is at least 0.5.
    """
    params = cameras.params.copy()
    count = len(params)
    factor = np.maximum(1.0 + options.focal_noise * rng.standard_normal((count, 1)), 0.5)
    params[:, cameras.columns(FOCAL_PARAMS)] *= factor
    for names, sigma in (
        (RADIAL_PARAMS, options.distortion_noise),
        (TANGENTIAL_PARAMS, 0.1 * options.distortion_noise),
    ):
        columns = cameras.columns(names)
        params[:, columns] += sigma * rng.standard_normal((count, len(columns)))
    return params
