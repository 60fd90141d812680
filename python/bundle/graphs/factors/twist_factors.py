"""Factors of a rolling shutter's twists: ties to neighbours in a video, and measured velocities.

``cpp/core/factors/twist_tie.h`` derives the residual (m - readout * xi) / sigma: m is the twist of
an image, xi the motion per frame from one neighbour to the other.
``cpp/core/factors/velocity_factor.h`` derives that of a velocity.
"""

from __future__ import annotations

import math
from collections.abc import Set
from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.graphs.factors.factors import Factor, as_information
from bundle.graphs.factors.variables import Key
from bundle.model.problem import Problem


@dataclass(frozen=True, eq=False, repr=False)
class TwistTieFactor(Factor):
    """Tie of an image's twist m to the poses of two images of the same video.

    Attributes:
        twist: key of the twist, ``("twist", image_id)``.
        readout: key of the readout, ``("readout", camera_id)``.
        before: key of the earlier image, ``("image", image_id)``.
        after: key of the later image.
        num_frames: frame times from the earlier to the later image, above 0.
        sigma_w: standard deviation of the angular part of m, radians.
        sigma_v: standard deviation of the other part, in the length unit; inf: only the angular
            part is tied.

    Raises:
        InputError: a number is not above 0 (once the factor is added to a problem).
    """

    twist: Key
    readout: Key
    before: Key
    after: Key
    num_frames: float
    sigma_w: float
    sigma_v: float

    kind = "twist_tie"

    @property
    def dependent_residuals(self) -> int:  # type: ignore[override]
        """Number of residuals without information."""
        return 3 if math.isinf(self.sigma_v) else 0

    @property
    def keys(self) -> tuple[Key, ...]:
        """Variables in the order of the Jacobians."""
        return self.twist, self.readout, self.before, self.after

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:  # noqa: ARG002
        """See :meth:`Factor.core_arguments`."""
        return self.num_frames, self.sigma_w, self.sigma_v


def twist_ties(
    problem: Problem, sigma: tuple[float, ...], turning: Set[Key] = frozenset()
) -> tuple[TwistTieFactor, ...]:
    """Return a tie for each image with known neighbours."""
    shutter = problem.rolling_shutter
    if shutter is None:
        raise InputError("twists: tied is valid only with rolling shutters")
    shutter.check_tied(problem)
    sigma_w, sigma_v = sigma
    images, frames, neighbours = problem.image_ids, shutter.frames, shutter.neighbours
    assert frames is not None
    assert neighbours is not None
    ties = []
    for image in np.flatnonzero(shutter.tied(problem)).tolist():
        a, b = neighbours[image].tolist()
        ties.append(
            TwistTieFactor(
                ("twist", int(images[image])),
                ("readout", int(problem.camera_ids[problem.image_camera[image]])),
                ("image", int(images[a])),
                ("image", int(images[b])),
                float(frames[b] - frames[a]),
                sigma_w,
                math.inf if ("twist", int(images[image])) in turning else sigma_v,
            )
        )
    return tuple(ties)


@dataclass(frozen=True, eq=False, repr=False)
class VelocityFactor(Factor):
    """Measured velocity of an antenna on a camera with a rolling shutter.

    e = -R^T (v + w x lever_arm) / readout - velocity, with the twist (w, v) of the image.

    Attributes:
        pose: key of the pose cam_from_world (R, t), on se3.
        twist: key of the twist, ``("twist", image_id)``.
        readout: key of the readout, ``("readout", camera_id)``; above 0.
        velocity: (3,) velocity of the antenna in the world frame, length units per frame.
        information: (3, 3) symmetric positive definite, along the world axes, or a number.
        lever_arm: (3,) position of the antenna in the camera frame; zeros: the projection centre.

    Raises:
        InputError: an argument is not numeric.
    """

    pose: Key
    twist: Key
    readout: Key
    velocity: ArrayLike
    information: ArrayLike
    lever_arm: ArrayLike = field(default=(0.0, 0.0, 0.0), kw_only=True)

    kind = "velocity"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._freeze_row("velocity", "lever_arm")
        self._freeze_matrix("information")

    @property
    def keys(self) -> tuple[Key, ...]:
        """Variables in the order of the Jacobians."""
        return self.pose, self.twist, self.readout

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:  # noqa: ARG002
        """See :meth:`Factor.core_arguments`."""
        information = as_information(name, np.asarray(self.information), 3)
        return self.velocity, self.lever_arm, information
