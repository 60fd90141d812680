"""Factor of a measured velocity: the motion of a rolling shutter's image in the world.

The core computes residual and Jacobians; ``cpp/core/factors/velocity_factor.h`` has the derivation.
"""

from __future__ import annotations

from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bundle.base.records import dataclass
from bundle.graphs.factors.factors import Factor, as_information
from bundle.graphs.factors.variables import Key


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
