"""Seeded blocks, healthy and with one deficiency each, projected by formulas of their own."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from bundle import Problem
from tests.scenes import project

PARAMS = {
    "SIMPLE_PINHOLE": [800.0, 400.0, 300.0],
    "SIMPLE_RADIAL": [800.0, 400.0, 300.0, 0.02],
    "RADIAL": [800.0, 400.0, 300.0, 0.02, -0.01],
}


def block(
    *,
    seed=0,
    num_images=8,
    num_points=60,
    model="SIMPLE_RADIAL",
    points=None,
    centers=None,
    rotations=None,
    seen=None,
    noise=0.3,
    **changes,
) -> Problem:
    """Images on an arc around a cloud, one camera; seen: (num_images, num_points)."""
    rng = np.random.default_rng(seed)
    if points is None:
        points = rng.uniform(-1, 1, (num_points, 3))
    num_points = len(points)
    if rotations is None:
        angles = np.linspace(-0.8, 0.8, num_images)
        rotations = Rotation.from_rotvec(
            np.stack([0.3 * np.sin(5 * angles), angles, 0.2 * np.cos(7 * angles)], 1)
        )
        if centers is None:
            centers = -rotations.inv().apply(
                np.stack([0.1 * angles, 0.1 * np.sin(9 * angles), 4 + 0.5 * angles], 1)
            )
    num_images = len(centers)
    translations = -rotations.apply(centers)
    if seen is None:
        seen = np.ones((num_images, num_points), bool)
    image, point = np.nonzero(seen)
    xy = np.empty((len(image), 2))
    for i in range(num_images):
        own = image == i
        in_camera = rotations[i].apply(points[point[own]]) + translations[i]
        xy[own] = project(model, PARAMS[model], in_camera)
    arrays = {
        "cam_from_world": np.hstack([rotations.as_quat(), translations]),
        "image_ids": np.arange(1, num_images + 1),
        "image_names": [f"image{i}.jpg" for i in range(num_images)],
        "image_camera": np.zeros(num_images, int),
        "camera_ids": np.array([1]),
        "camera_models": [model],
        "camera_params": np.array([PARAMS[model]]),
        "camera_sizes": np.array([[800, 600]]),
        "points": points,
        "point_ids": np.arange(1, num_points + 1),
        "observation_image": image,
        "observation_point": point,
        "observation_xy": xy + noise * rng.standard_normal(xy.shape),
        "observation_keypoint": np.full(len(image), -1),
    }
    return Problem(**{**arrays, **changes})


class Planted(NamedTuple):
    """A problem with one deficiency.

    Attributes:
        kind: its name.
        problem: that has it.
        nullity: of the reduced system.
        ids: that have to be named; of `what`.
        what: image_ids, camera_ids, points_without_parallax or collapsed.
        options: of the diagnosis.
        expected: what the gauge explains of the nullity.
    """

    kind: str
    problem: Problem
    nullity: int
    ids: tuple[int, ...] = ()
    what: str = "image_ids"
    options: dict = {}  # noqa: RUF012 (never changed)
    expected: int = 7


def component(seed):
    """Two pieces without a common point."""
    rng = np.random.default_rng(seed)
    cut = int(rng.integers(2, 5))
    seen = np.zeros((8, 60), bool)
    seen[:cut, :25] = seen[cut:, 25:] = True
    smaller = range(1, cut + 1) if cut < 4 else range(cut + 1, 9)
    return Planted("component", block(seed=seed, seen=seen), 14, tuple(smaller))


def zero_parallax(seed):
    """Points that only two images see, which stand at one place."""
    rng = np.random.default_rng(seed)
    problem = block(seed=seed, noise=0)
    centers = problem.projection_centers
    bad = np.sort(rng.choice(60, 1 + seed % 3, replace=False))
    keep = np.ones(problem.num_observations, bool)
    # Image 2 stands where image 1 does, so that their rays to a point are one.
    poses = problem.cam_from_world.copy()
    turn = Rotation.from_quat(poses[1, :4])
    poses[1, 4:] = -turn.apply(centers[0])
    for p in bad:
        keep &= (problem.observation_point != p) | (problem.observation_image < 2)
    problem = problem.replace(
        cam_from_world=poses,
        observation_image=problem.observation_image[keep],
        observation_point=problem.observation_point[keep],
        observation_xy=problem.observation_xy[keep],
        observation_keypoint=problem.observation_keypoint[keep],
    )
    ids = tuple((bad + 1).tolist())
    return Planted("points_without_parallax", problem, 7, ids, "points_without_parallax")


def pure_rotation(seed):
    """All images at one place."""
    rng = np.random.default_rng(seed)
    rotations = Rotation.from_rotvec(rng.uniform(-0.15, 0.15, (6, 3)))
    points = np.column_stack([rng.uniform(-1, 1, (60, 2)), rng.uniform(3, 6, 60)])
    centers = np.tile(rng.uniform(-0.1, 0.1, 3), (6, 1))
    problem = block(seed=seed, points=points, centers=centers, rotations=rotations)
    return Planted("pure_rotation", problem, 7)


def unobserved_parameter(seed):
    """All observations of the second camera's only image lie on its axis, or at one radius."""
    rng = np.random.default_rng(seed)
    problem = block(seed=seed)
    radius = 0.3 if seed % 2 else 0.0
    angles, depth = rng.uniform(0, 2 * np.pi, 12), rng.uniform(3.5, 4.5, 12)
    rays = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    turn = Rotation.from_quat(problem.cam_from_world[5, :4])
    in_camera = np.column_stack([rays * depth[:, None], depth])
    special = turn.inv().apply(in_camera - problem.cam_from_world[5, 4:])
    seen = np.ones((8, 72), bool)
    seen[5, :60] = False
    problem = block(seed=seed, points=np.vstack([problem.points, special]), seen=seen).replace(
        image_camera=[0, 0, 0, 0, 0, 1, 0, 0],
        camera_ids=[1, 2],
        camera_models=["SIMPLE_RADIAL"] * 2,
        camera_params=np.tile(PARAMS["SIMPLE_RADIAL"], (2, 1)),
        camera_sizes=[[800, 600]] * 2,
    )
    # On the axis neither f nor k has an effect, on a circle one combination of them. Two images
    # that are held leave nothing to the gauge.
    held = {"fixed_image_ids": (1, 6)}
    return Planted("unobserved_parameter", problem, 1 if radius else 2, (2,), "camera_ids", held, 0)


def _looking_down(seed, centers, relief, turns):
    """Images that look along -z, turned about it, at a scene five below."""
    rng = np.random.default_rng(seed)
    down = Rotation.from_rotvec([np.pi, 0, 0])
    rotations = Rotation.from_rotvec(np.outer(turns, [0, 0, 1])) * down
    points = np.column_stack([rng.uniform(-2, 2, (80, 2)), -5 + relief * rng.uniform(-1, 1, 80)])
    return block(seed=seed, points=points, centers=centers, rotations=rotations)


def flat_scene(seed):
    """Images that look straight down at a flat scene."""
    rng = np.random.default_rng(seed)
    centers = np.column_stack([rng.uniform(-2, 2, (7, 2)), rng.uniform(-0.3, 0.3, 7)])
    problem = _looking_down(seed, centers, 0.15, rng.uniform(-3, 3, 7))
    return Planted("flat_scene", problem, 8, (1,), "camera_ids")


def forward_motion(seed):
    """Images that go straight on."""
    rng = np.random.default_rng(seed)
    centers = np.column_stack([0.02 * rng.standard_normal((7, 2)), np.linspace(0, 2, 7)])
    problem = _looking_down(seed, centers, 1.5, np.zeros(7))
    return Planted("forward_motion", problem, 8, (1,), "camera_ids")


def collapsed_scale(seed):
    """Two images and the points that they alone see, shrunk to a millionth."""
    rng = np.random.default_rng(seed)
    own = np.sort(rng.choice(60, 12, replace=False))
    seen = np.ones((8, 60), bool)
    seen[2:, own] = False
    problem = block(seed=seed, seen=seen)
    centers = problem.projection_centers
    poses, points = problem.cam_from_world.copy(), problem.points.copy()
    moved = centers[0] + 1e-6 * (centers[1] - centers[0])
    poses[1, 4:] = -Rotation.from_quat(poses[1, :4]).apply(moved)
    points[own] = centers[0] + 1e-6 * (points[own] - centers[0])
    problem = problem.replace(cam_from_world=poses, points=points)
    return Planted("collapsed_scale", problem, -1, tuple((own + 1).tolist()), "collapsed")


PLANTED: list[tuple[Callable[[int], Planted], int]] = [
    *((component, seed) for seed in range(6)),
    *((zero_parallax, seed) for seed in range(6)),
    *((pure_rotation, seed) for seed in range(4)),
    *((unobserved_parameter, seed) for seed in range(4)),
    *((flat_scene, seed) for seed in range(4)),
    *((forward_motion, seed) for seed in range(3)),
    *((collapsed_scale, seed) for seed in range(3)),
]
"""Thirty."""
