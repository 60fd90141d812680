"""Robust turn of the world that a set of attitude measurements agrees on.

Let Q be a turn of the world, and phi_i(Q) the further turn that measurement i asks for, along the
axes of the turned world: Log of the rotation for an orientation, the shortest turn of the measured
direction to down for gravity, and a turn about the vertical for a heading. With sigma_i its
standard deviation, of each axis or of all, the lengths a_i = |phi_i / sigma_i| are compared:

1. The start is the measurement whose own turn has the least sum of a_i over all others. More than
   half of the measurements may be wrong by any angle if the wrong ones do not agree.
2. Steps Q <- Exp(mean of phi_i) Q follow, with Tukey's weights (1 - (a_i / (4.685 s))^2)^2 /
   sigma_i^2, where s is the larger of 1 and the median of a_i over its value for noise.

The median of a_i for noise is that of the chi distribution: 0.6745, 1.1774 and 1.5382 for one, two
and three numbers (Holland and Welsch 1977 for the constant 4.685).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.rotations import (
    quaternion_from_matrix,
    quaternion_from_vector,
    rotation_matrices,
    vector_from_quaternion,
)

Array = NDArray[np.float64]

MEDIAN = {1: 0.6744897501960817, 2: 1.1774100225154747, 3: 1.5381722544550522}
"""Median length of a standard normal vector, by its number of coordinates."""
TUKEY = 4.685
MOST_STARTS, MOST_JUDGES = 64, 2000
MOST_STEPS = 100
STEP = 1e-13
"""Turn in radians at which the steps end."""


@dataclass(frozen=True)
class Agreement:
    """Turn that the measurements agree on.

    Attributes:
        rotation: (3, 3) turn Q of the world.
        lengths: (n,) remaining turn of each measurement in standard deviations.
        weights: (n,) Tukey's weights between 0 and 1; 0: the measurement disagrees.
    """

    rotation: Array
    lengths: Array
    weights: Array


def agree(
    turns: Callable[[Array], Array],
    own: Callable[[int], Array],
    sigmas: Array,
    size: int,
) -> Agreement:
    """Return the turn that most measurements agree on.

    Args:
        turns: function that returns the (n, 3) turns phi_i that remain after a turn Q (3, 3).
        own: function that returns the turn Q (3, 3) with phi_i = 0 for measurement i.
        sigmas: (n, 1) or (n, 3) standard deviations in radians, of each axis of the turned world.
        size: number of coordinates of a turn: 1, 2 or 3.
    """
    rotation = _best_start(turns, own, sigmas)
    for _ in range(MOST_STEPS):
        phi = turns(rotation)
        _, weights = _weigh(phi, sigmas, size)
        strength = weights[:, None] / sigmas**2
        step = (strength * phi).sum(axis=0) / strength.sum(axis=0)
        rotation = exp(step) @ rotation
        if np.linalg.norm(step) < STEP:
            break
    lengths, weights = _weigh(turns(rotation), sigmas, size)
    return Agreement(rotation, lengths, weights)


def exp(vector: Array) -> Array:
    """Return the rotation matrix of a rotation vector (3,)."""
    matrix: Array = rotation_matrices(quaternion_from_vector(vector[None]))[0]
    return matrix


def log(matrices: Array) -> Array:
    """Return the rotation vectors (n, 3) of rotation matrices (n, 3, 3)."""
    return vector_from_quaternion(quaternion_from_matrix(matrices))


def _best_start(
    turns: Callable[[Array], Array], own: Callable[[int], Array], sigmas: Array
) -> Array:
    count = int(sigmas.shape[0])
    tried = np.unique(np.linspace(0, count - 1, min(count, MOST_STARTS)).astype(int))
    judges = np.unique(np.linspace(0, count - 1, min(count, MOST_JUDGES)).astype(int))
    best, least = np.eye(3), np.inf
    for index in tried.tolist():
        rotation = own(index)
        lengths = np.linalg.norm((turns(rotation) / sigmas)[judges], axis=1)
        if (total := float(lengths.sum())) < least:
            best, least = rotation, total
    return best


def _weigh(phi: Array, sigmas: Array, size: int) -> tuple[Array, Array]:
    lengths = np.linalg.norm(phi / sigmas, axis=1)
    scale = max(1.0, float(np.median(lengths)) / MEDIAN[size])
    share = np.minimum(lengths / (TUKEY * scale), 1.0)
    return lengths, (1 - share**2) ** 2
