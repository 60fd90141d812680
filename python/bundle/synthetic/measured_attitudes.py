"""Measured attitudes of synthetic images: directions of gravity and orientations, with noise.

The noise follows the models of the factors (``cpp/core/factors/attitude_factors.h``). A direction
of gravity m = Exp(n) R (0, 0, -1) is turned by n ~ N(0, sigma^2 I) in the camera's frame, of which
the two components perpendicular to m have an effect. An orientation Z = R Exp(-e) has
e = Log(Z^T R) ~ N(0, sigma^2 I) along the axes of the world.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bundle.georeference.attitude_priors import AttitudePrior, GravityPrior, OrientationPrior
from bundle.interface.scene_options import SceneOptions
from bundle.model.problem import Problem
from bundle.model.rotations import (
    quaternion_from_vector,
    quaternion_multiply,
    rotation_matrices,
)

Array = NDArray[np.float64]

STREAM = 0x617474
"""Second word of the seed, which keeps these numbers apart from those of the scene."""


def measured_attitudes(truth: Problem, options: SceneOptions) -> tuple[AttitudePrior, ...]:
    """Return the priors of gravity, then of orientations, that the options request.

    Args:
        truth: images at their true poses, in a world with z up.
        options: options of the scene.
    """
    gravity, orientation = np.random.SeedSequence([options.seed, STREAM]).spawn(2)
    found: list[AttitudePrior] = []
    if options.gravity_sigma:
        noise = _noise(gravity, truth, options.gravity_sigma)
        down = rotation_matrices(truth.cam_from_world[:, :4])[:, :, 2]
        turned = -np.einsum("nij,nj->ni", rotation_matrices(noise), down)
        found += [
            GravityPrior(image, direction, options.gravity_sigma)
            for image, direction in zip(truth.image_ids.tolist(), turned, strict=True)
        ]
    if options.orientation_sigma:
        noise = _noise(orientation, truth, options.orientation_sigma)
        rotations = quaternion_multiply(truth.cam_from_world[:, :4], noise)
        found += [
            OrientationPrior(image, rotation, options.orientation_sigma)
            for image, rotation in zip(truth.image_ids.tolist(), rotations, strict=True)
        ]
    return tuple(found)


def _noise(seed: np.random.SeedSequence, truth: Problem, degrees: float) -> Array:
    vectors = np.random.default_rng(seed).normal(size=(truth.num_images, 3))
    return quaternion_from_vector(math.radians(degrees) * vectors)
