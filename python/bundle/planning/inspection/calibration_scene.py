"""Small problems of a chosen shape, to time the solvers on."""

from __future__ import annotations

import numpy as np

from bundle.model.problem import Problem

__all__ = ["make_scene"]

_FOCAL, _DEPTH, _NOISE = 500.0, 10.0, 0.5


def make_scene(
    num_images: int,
    num_points: int,
    track_length: int,
    *,
    scattered: bool = False,
    shared_camera: bool = False,
    seed: int = 0,
) -> Problem:
    """Return photographs along a line of points in front of them, with half a pixel of noise.

    Args:
        num_images: images in all.
        num_points: points in all.
        track_length: images that see a point: near each other, or ``scattered`` over all.
        scattered: every image sees something in common with most others, in no order.
        shared_camera: one camera for all images, in place of one each.
        seed: of the noise and of who sees what.
    """
    rng = np.random.default_rng(seed)
    if scattered:
        # Random steps around the ring of images: distinct as long as they do not add up to it.
        steps = rng.integers(1, max(num_images // track_length, 2), (num_points, track_length))
        images = (rng.integers(num_images, size=(num_points, 1)) + steps.cumsum(1)) % num_images
    else:
        # Out of one and a half times as many neighbours, and the points in no order.
        reach = min(track_length + track_length // 2, num_images)
        chosen = rng.random((num_points, reach)).argsort(axis=1)[:, :track_length]
        images = rng.integers(num_images - reach + 1, size=(num_points, 1)) + chosen
    images = np.sort(images, axis=1)
    position = np.zeros((num_images, 3))
    position[:, 0] = np.linspace(0.0, 2.0, num_images) if scattered else np.arange(num_images)
    points = np.empty((num_points, 3))
    points[:, 0] = position[images, 0].mean(1) + rng.uniform(-1.0, 1.0, num_points)
    points[:, 1] = rng.uniform(-2.0, 2.0, num_points)
    points[:, 2] = rng.uniform(_DEPTH, 2.0 * _DEPTH, num_points)
    image, point = images.ravel(), np.repeat(np.arange(num_points, dtype=np.int32), track_length)
    seen = points[point] - position[image]
    xy = _FOCAL * seen[:, :2] / seen[:, 2:] + rng.normal(0.0, _NOISE, (len(image), 2))
    poses = np.zeros((num_images, 7))
    poses[:, 3] = 1.0
    poses[:, 4:] = -position
    num_cameras = 1 if shared_camera else num_images
    return Problem(
        cam_from_world=poses,
        image_ids=np.arange(num_images),
        image_names=("",) * num_images,
        image_camera=np.zeros(num_images, np.int32)
        if shared_camera
        else np.arange(num_images, dtype=np.int32),
        camera_ids=np.arange(num_cameras),
        camera_models=("RADIAL",) * num_cameras,
        camera_params=np.tile([_FOCAL, 0.0, 0.0, 0.0, 0.0], (num_cameras, 1)),
        camera_sizes=np.zeros((num_cameras, 2), int),
        points=points,
        point_ids=np.arange(num_points),
        observation_image=image,
        observation_point=point,
        observation_xy=xy,
        observation_keypoint=np.full(len(image), -1),
    )
