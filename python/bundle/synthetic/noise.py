"""Measurements and starting values: what is wrong with them, as asked for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.problem import Problem
from bundle.rotations import (
    dot,
    quaternion_from_vector,
    quaternion_inverse,
    quaternion_multiply,
    quaternion_rotate,
)
from bundle.synthetic.intrinsics import FOCAL_PARAMS, RADIAL_PARAMS, TANGENTIAL_PARAMS, Intrinsics
from bundle.synthetic.scene_options import SceneOptions

__all__ = ["measure", "perturb"]

Array = NDArray[np.float64]


def measure(
    rng: np.random.Generator, xy: Array, sizes: NDArray[np.int64], options: SceneOptions
) -> tuple[Array, NDArray[np.bool_]]:
    """Return measured positions (M, 2) in pixels, and which of them are outliers (M,).

    Noise that would lead out of the image is taken the other way, which keeps its magnitude.

    Args:
        rng: source of noise and outliers.
        xy: (M, 2) exact positions.
        sizes: (M, 2) width and height of the image of each observation.
        options: how much of it.
    """
    noise = options.pixel_noise * rng.standard_normal(xy.shape)
    measured = xy + noise
    measured = np.where((measured < 0) | (measured > sizes), xy - noise, measured)
    outliers = rng.permutation(len(xy))[: round(options.outlier_share * len(xy))]
    measured[outliers] = rng.random((len(outliers), 2)) * sizes[outliers]
    is_outlier = np.zeros(len(xy), dtype=np.bool_)
    is_outlier[outliers] = True
    return measured, is_outlier


def perturb(
    rng: np.random.Generator, truth: Problem, cameras: Intrinsics, options: SceneOptions
) -> Problem:
    """Return the start: the true problem with its poses, points and cameras perturbed.

    Rotations turn about the camera centre, so that rotation and translation noise are independent.
    """
    rotations, translations = truth.cam_from_world[:, :4], truth.cam_from_world[:, 4:]
    centers = -quaternion_rotate(quaternion_inverse(rotations), translations)
    scale = _median_distance(truth, centers)
    turn = np.radians(options.rotation_noise) * rng.standard_normal(centers.shape)
    turned = quaternion_multiply(quaternion_from_vector(turn), rotations)
    moved = centers + options.translation_noise * scale * rng.standard_normal(centers.shape)
    point_shift = options.point_noise * scale * rng.standard_normal(truth.points.shape)
    return truth.replace(
        cam_from_world=np.concatenate([turned, -quaternion_rotate(turned, moved)], axis=1),
        points=truth.points + point_shift,
        camera_params=_perturbed_params(rng, cameras, options),
    )


def _median_distance(problem: Problem, centers: Array) -> float:
    """Return the scale of a scene: the median distance of a point from the cameras that see it."""
    to_point = problem.points[problem.observation_point] - centers[problem.observation_image]
    return float(np.median(np.sqrt(dot(to_point, to_point))))


def _perturbed_params(
    rng: np.random.Generator, cameras: Intrinsics, options: SceneOptions
) -> Array:
    """Return starting values (num_cameras, num_params) of the cameras' parameters.

    All focal lengths of a camera change by the same factor, which is never below a half.
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
