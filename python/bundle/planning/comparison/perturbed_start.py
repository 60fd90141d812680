"""Perturbed start of a comparison.

At a minimum, every method stops after a step, and their times say nothing. A seeded perturbation of
relative size s gives a start from which all methods must work. With n standard normal:

    centre of a pose    c + s D n,  D: median distance of its observed points
    rotation of a pose  Exp(s n) R, about its centre
    point               p + s d n,  d: distance of its nearest camera
    focal lengths       (1 + s n) f, at least f / 2; one n per camera

All sizes are relative to distances, so that the image moves by about s f pixels whatever the scale
of the scene. Values that the options hold constant, and poses of rigs' sensors, stay.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.interface.options import SolveOptions
from bundle.model.cameras import camera_models
from bundle.model.problem import Problem
from bundle.model.rotations import (
    quaternion_from_vector,
    quaternion_inverse,
    quaternion_multiply,
    quaternion_rotate,
)

Array = NDArray[np.float64]

_FOCAL = ("f", "fx", "fy")


def perturbed(problem: Problem, options: SolveOptions, size: float, seed: int) -> Problem:
    """Return the problem with perturbed values of everything that a solve refines.

    Args:
        problem: the problem.
        options: refined and constant parameters.
        size: relative size s.
        seed: seed of the random numbers.
    """
    seeds = np.random.SeedSequence(seed).spawn(3)
    of_poses, of_points, of_cameras = map(np.random.default_rng, seeds)
    image, point = problem.observation_image, problem.observation_point
    distance = np.linalg.norm(problem.points[point] - problem.projection_centers[image], axis=1)
    changes: dict[str, Array] = {}
    if "poses" in options.refine:
        changes |= _poses(problem, options, size, of_poses, distance)
    if "points" in options.refine:
        fixed = np.isin(problem.point_ids, options.fixed_point_ids)
        nearest = _quantile_by(point, distance, problem.num_points, 0.0)
        moved = np.where(fixed | np.isnan(nearest), 0.0, nearest)
        step = size * moved[:, None] * of_points.standard_normal((len(moved), 3))
        changes["points"] = problem.points + step
    if "focal" in options.refine:
        changes["camera_params"] = _focal(problem, options, size, of_cameras)
    return problem.replace(**changes)


def _poses(
    problem: Problem,
    options: SolveOptions,
    size: float,
    rng: np.random.Generator,
    distance: Array,
) -> dict[str, Array]:
    """Return new poses of frames, and of images without a frame.

    Frames come first, then one unit per image; units of images with a frame are not used.
    """
    count = problem.num_frames
    own = np.full(problem.num_images, -1)
    if count:
        own = problem.image_frame
    unit = np.where(own >= 0, own, count + np.arange(problem.num_images))
    poses = np.concatenate([problem.rig_from_world, problem.cam_from_world])
    scale = _quantile_by(unit[problem.observation_image], distance, len(poses), 0.5)
    scale[unit[np.isin(problem.image_ids, options.fixed_image_ids)]] = np.nan
    moves = np.isfinite(scale)  # NaN: constant, or without observations
    noise = size * rng.standard_normal((2, len(poses), 3))
    rotation = poses[moves, :4] / np.linalg.norm(poses[moves, :4], axis=1, keepdims=True)
    centre = -quaternion_rotate(quaternion_inverse(rotation), poses[moves, 4:])
    centre = centre + scale[moves, None] * noise[0, moves]
    turned = quaternion_multiply(quaternion_from_vector(noise[1, moves]), rotation)
    poses[moves] = np.concatenate([turned, -quaternion_rotate(turned, centre)], axis=1)
    if not count:
        return {"cam_from_world": poses}
    frames, images = problem.replace(rig_from_world=poses[:count]), poses[count:]
    alone = (own < 0)[:, None]
    return {
        "rig_from_world": frames.rig_from_world,
        "cam_from_world": np.where(alone, images, frames.cam_from_world),
    }


def _focal(problem: Problem, options: SolveOptions, size: float, rng: np.random.Generator) -> Array:
    params = problem.camera_params.copy()
    factor = np.maximum(1.0 + size * rng.standard_normal(len(params)), 0.5)
    factor[np.isin(problem.camera_ids, options.fixed_camera_ids)] = 1.0
    names = camera_models()
    models = np.array(problem.camera_models)
    for model in dict.fromkeys(problem.camera_models):
        columns = [k for k, name in enumerate(names[model]) if name in _FOCAL]
        rows = np.flatnonzero(models == model)
        params[rows[:, None], columns] *= factor[rows, None]
    return params


def _quantile_by(group: NDArray[np.integer], values: Array, count: int, share: float) -> Array:
    """Return a quantile of the values of each group, (count,); NaN for empty groups."""
    order = np.lexsort((values, group))
    sizes = np.bincount(group, minlength=count)
    first = np.cumsum(sizes) - sizes
    found = np.full(count, np.nan)
    filled = sizes > 0
    at = first[filled] + (share * (sizes[filled] - 1)).astype(np.int64)
    found[filled] = values[order][at]
    return found
