"""The reprojection residual as a user would write it, with every camera model in it."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

import bundle
from tests.scenes import PARAMS

MANIFOLDS = ["angle_axis", None, None, None]

check_few = partial(bundle.check_gradients, num_samples=3)
"""A check at as many points as a factor graph checks by default, a third of those of a function."""


class Blocks(NamedTuple):
    """Rotation vector, translation, intrinsics, world point."""

    rotation: np.ndarray
    translation: np.ndarray
    params: np.ndarray
    point: np.ndarray


def names(model):
    return ["pose", "translation", ("camera", bundle.camera_models()[model]), "point"]


def random_blocks(model, rng) -> Blocks:
    """A camera somewhere and a point that it sees."""
    params = np.array(PARAMS[model]) * (1 + 0.05 * rng.standard_normal(len(PARAMS[model])))
    rotation, translation = rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3)
    depth = rng.uniform(2, 6)
    in_camera = depth * np.array([*rng.uniform(0.1, 0.4, 2) * rng.choice([-1, 1], 2), 1])
    point = Rotation.from_rotvec(rotation).inv().apply(in_camera - translation)
    return Blocks(rotation, translation, params, point)


def skew(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def left_jacobian(w):
    angle = np.linalg.norm(w)
    k = skew(w)
    return (
        np.eye(3) + (1 - np.cos(angle)) / angle**2 * k + (angle - np.sin(angle)) / angle**3 * k @ k
    )


class Parts(NamedTuple):
    """Parts of the Jacobians."""

    residual: np.ndarray
    d_camera_point: np.ndarray
    d_params: np.ndarray
    rotation: np.ndarray
    rotated: np.ndarray
    left: np.ndarray


def parts(model, blocks) -> Parts:
    blocks = Blocks(*blocks)
    left = left_jacobian(blocks.rotation)
    rotation = np.eye(3) + skew(blocks.rotation) @ left  # Exp(w) = I + [w]x J_l(w)
    rotated = rotation @ blocks.point
    there = bundle.project(
        model, blocks.params, (rotated + blocks.translation)[None], jacobians=True
    )
    return Parts(
        there.xy[0], there.d_point[0], there.d_params[0], rotation, rotated, left
    )  # fmt: skip


def jacobians(p: Parts) -> list[np.ndarray]:
    a = p.d_camera_point
    return [-a @ skew(p.rotated) @ p.left, a, p.d_params, a @ p.rotation]


def correct(model):
    """The residual with its Jacobians."""

    def function(blocks):
        p = parts(model, blocks)
        return p.residual, jacobians(p)

    return function
