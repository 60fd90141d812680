"""A small scene with noise, made of nothing but NumPy: cameras on an arc look at a ball of points."""

from __future__ import annotations

from typing import Any

import numpy as np

from bundle.problem import Problem


def rotation_y(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def scene(
    num_images: int = 4,
    num_points: int = 30,
    *,
    kind: str = "bal",
    shared_camera: bool = False,
    noise: float = 0.5,
    seed: int = 1,
    **changes: Any,
) -> Problem:
    """Every point in every image; pixels have `noise`, the start is off by a hundredth or so."""
    rng = np.random.default_rng(seed)
    num_cameras = 1 if shared_camera else num_images
    points = rng.normal(size=(num_points, 3))
    angles = np.linspace(-0.6, 0.6, num_images)
    poses = np.zeros((num_images, 7))
    poses[:, 1], poses[:, 3] = np.sin(angles / 2), np.cos(angles / 2)
    poses[:, 6] = 6.0
    focal, k1, k2 = 500.0, -0.05, 0.01
    pixels = []
    for angle in angles:
        seen = points @ rotation_y(angle).T + [0, 0, 6]
        u = seen[:, :2] / seen[:, 2:]
        square = (u**2).sum(1, keepdims=True)
        pixels.append(focal * u * (1 + k1 * square + k2 * square**2))
    xy = np.concatenate([np.zeros((0, 2)), *pixels])
    poses[:, 4:] += rng.normal(scale=0.02, size=(num_images, 3))
    values: dict[str, Any] = {
        "cam_from_world": poses,
        "image_ids": np.arange(num_images),
        "image_names": ("",) * num_images,
        "image_camera": np.zeros(num_images) if shared_camera else np.arange(num_images),
        "camera_ids": np.arange(num_cameras),
        "camera_models": ("RADIAL",) * num_cameras,
        "camera_params": np.tile([focal + 3, 0, 0, 0, 0], (num_cameras, 1)),
        "camera_sizes": np.zeros((num_cameras, 2)),
        "points": points + rng.normal(scale=0.02, size=points.shape),
        "point_ids": np.arange(num_points),
        "observation_image": np.repeat(np.arange(num_images), num_points),
        "observation_point": np.tile(np.arange(num_points), num_images),
        "observation_xy": xy + rng.normal(scale=noise, size=xy.shape),
        "observation_keypoint": np.full(len(xy), -1),
        "format": kind,
    }
    return Problem(**{**values, **changes})
