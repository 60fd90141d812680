"""Honest problems that no reconstruction is: what do checks say of folds and rounding errors?"""

import numpy as np
from scipy.spatial.transform import Rotation

from tests import scenes

KINDS = [
    "as it is",
    "behind",
    "far from the origin",
    "huge",
    "tiny",
    "camera's centre",
    "optical axis",
    "camera's plane",
    "pole",
    "parameters",
    "far points",
    "one point",
]


def absurd_problem(rng, seed):
    """A problem, rotation offsets for it, and what it is."""
    num_images = int(rng.integers(1, 8))
    model = str(rng.choice(list(scenes.PARAMS)))
    problem = scenes.make_problem(
        num_images=num_images,
        num_points=int(rng.integers(4, 60)),
        model=model,
        shared=bool(rng.random() < 0.5),
        seed=seed,
        noise=float(rng.choice([0, 0.5, 50])),
        perturbation=float(rng.choice([0, 1e-2, 0.2, 1, 5])),
    )
    offsets = rng.standard_normal((num_images, 3)) * rng.choice([0, 1e-9, 1e-3, 0.3, 2, 20])
    kinds = rng.choice(KINDS, size=int(rng.integers(1, 4)))
    for kind in kinds:
        problem = _change(problem, kind, rng)
    return problem, offsets, (model, *kinds)


def _change(problem, kind, rng):
    points, poses = problem.points.copy(), problem.cam_from_world.copy()
    params = problem.camera_params.copy()
    rotations = Rotation.from_quat(poses[:, :4])
    if kind == "behind":
        points[rng.random(len(points)) < rng.choice([0.3, 1.0])] *= -1
        points[:, 2] -= 8 * (rng.random() < 0.7)
    elif kind == "far from the origin":
        shift = rng.standard_normal(3) * 10 ** rng.uniform(2, 14)
        points += shift
        poses[:, 4:] -= rotations.apply(np.tile(shift, (len(poses), 1)))
    elif kind in ("huge", "tiny"):
        scale = 10 ** (rng.uniform(2, 45) * (1 if kind == "huge" else -1))
        points *= scale
        poses[:, 4:] *= scale
    elif kind in SQUEEZED:
        image = int(rng.integers(len(poses)))
        in_camera = rotations[image].apply(points) + poses[image, 4:]
        in_camera[:, SQUEEZED[kind]] *= 10 ** -rng.uniform(1, 17)
        points = rotations[image].inv().apply(in_camera - poses[image, 4:])
    elif kind == "parameters":
        spread = 10 ** rng.uniform(-3, 2)
        params[:, 2:] *= 1 + spread * rng.standard_normal(params[:, 2:].shape)
    elif kind == "far points":
        points *= 10 ** rng.uniform(0, 12, (len(points), 1))
    elif kind == "one point":
        points[:] = points[0]
    return problem.replace(points=points, cam_from_world=poses, camera_params=params)


# Coordinates in the frame of a camera that come close to zero.
SQUEEZED = {
    "camera's centre": [0, 1, 2],
    "optical axis": [0, 1],
    "camera's plane": [2],
    "pole": [0, 2],
}
