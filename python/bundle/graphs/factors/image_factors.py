"""Factors of an image: attitude, and motion during the readout of a rolling shutter."""

from __future__ import annotations

import math
from collections.abc import Set
from dataclasses import field

import numpy as np
from numpy.typing import ArrayLike

from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.graphs.factors.factors import MeasuredFactor, WeightedFactor
from bundle.graphs.factors.variables import Key
from bundle.interface.option_fields import number
from bundle.model.problem import Problem

# Factors of the attitude of an image: a direction of the world, the rotation, the heading.
#
# Each constrains the rotation R of one pose cam_from_world. The core computes residuals and
# Jacobians; ``cpp/core/factors/attitude_factors.h`` has the derivations. Angles are radians.

DOWN = (0.0, 0.0, -1.0)  # direction of gravity in a world whose third axis points up
FORWARD = (0.0, 0.0, 1.0)  # viewing direction of a camera in its own frame


@dataclass(frozen=True, eq=False, repr=False)
class _AttitudeFactor(MeasuredFactor):
    """Base class of factors of the rotation of one pose."""

    key: Key

    def _freeze_direction(self, attribute: str) -> None:
        self._freeze_row(attribute)
        vector = np.asarray(getattr(self, attribute))
        if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
            raise InputError(
                f"{self.name}: {attribute}: expected 3 numbers that are not all zero, "
                f"found {brief(vector.tolist())}"
            )


@dataclass(frozen=True, eq=False, repr=False)
class DirectionFactor(_AttitudeFactor):
    """Measured direction of an axis of the world in the camera's frame, such as gravity's.

    e = R ``axis`` - ``direction``, for unit vectors: the chord on the sphere, whose length at an
    angle x is 2 sin(x / 2). Two of its three numbers are independent. Turns about the axis do not
    change it, and a direction that is upside down has no gradient.

    Attributes:
        key: pose cam_from_world (R, t), on se3.
        direction: (3,) measured direction in the camera's frame, of any length.
        sigma: standard deviation in radians, about each axis perpendicular to the direction.
        axis: (3,) direction in the world, of any length; by default down, where z is up.

    Raises:
        InputError: an argument is not numeric, a direction is zero, or sigma is not above 0.
    """

    direction: ArrayLike
    sigma: float
    axis: ArrayLike = field(default=DOWN, kw_only=True)

    kind = "direction"
    dependent_residuals = 1
    _given = ("direction", "axis", "sigma")

    def __post_init__(self) -> None:
        super().__post_init__()
        self._freeze_direction("direction")
        self._freeze_direction("axis")
        self._set("sigma", number(f"{self.name}: sigma", self.sigma, above=0))


@dataclass(frozen=True, eq=False, repr=False)
class RotationFactor(WeightedFactor, _AttitudeFactor):
    """Measured rotation Z of cam_from_world: e = Log(Z^T R), along the axes of the world.

    Attributes:
        key: pose cam_from_world (R, t), on se3.
        rotation: (4,) quaternion qx qy qz qw of Z.
        information: (3, 3) symmetric positive definite, along the world axes, in 1 / radians
            squared, or its diagonal (3,), or a number.

    Raises:
        InputError: an argument is not numeric.
    """

    rotation: ArrayLike
    information: ArrayLike | None = None

    kind = "rotation"
    _rows, _given, _size = ("rotation",), ("rotation", "information"), 3


@dataclass(frozen=True, eq=False, repr=False)
class HeadingFactor(_AttitudeFactor):
    """Measured heading of an axis of the camera, clockwise from north.

    The axes of the world are east, north, up. The residual is the difference of the angles, at most
    half a turn, divided by ``sigma``.

    Attributes:
        key: pose cam_from_world (R, t), on se3.
        heading: measured heading in radians; north is 0, east pi / 2.
        sigma: standard deviation in radians.
        axis: (3,) axis in the camera's frame; by default the viewing direction. A vertical axis
            has no heading.

    Raises:
        InputError: an argument is not numeric, the axis is zero, or sigma is not above 0.
    """

    heading: float
    sigma: float
    axis: ArrayLike = field(default=FORWARD, kw_only=True)

    kind = "heading"
    _given = ("axis", "heading", "sigma")

    def __post_init__(self) -> None:
        super().__post_init__()
        self._freeze_direction("axis")
        self._set("heading", number(f"{self.name}: heading", self.heading))
        self._set("sigma", number(f"{self.name}: sigma", self.sigma, above=0))


# Factors of a rolling shutter's twists: ties to neighbours in a video, and measured velocities.
#
# ``cpp/core/factors/twist_tie.h`` derives the residual (m - readout * xi) / sigma: m is the twist
# of an image, xi the motion per frame from one neighbour to the other.
# ``cpp/core/factors/velocity_factor.h`` derives that of a velocity.


@dataclass(frozen=True, eq=False, repr=False)
class TwistTieFactor(MeasuredFactor):
    """Tie of an image's twist m to the poses of two images of the same video."""

    twist: Key  # key of the twist, ``("twist", image_id)``
    readout: Key  # key of the readout, ``("readout", camera_id)``
    before: Key  # key of the earlier image, ``("image", image_id)``
    after: Key  # key of the later image
    num_frames: float  # frame times from the earlier to the later image, above 0
    sigma_w: float  # standard deviation of the angular part of m, radians
    # standard deviation of the other part, in the length unit; inf: only the angular part is tied
    sigma_v: float

    kind = "twist_tie"
    _keys = ("twist", "readout", "before", "after")
    _given = ("num_frames", "sigma_w", "sigma_v")

    @property
    def dependent_residuals(self) -> int:  # type: ignore[override]
        """Number of residuals without information."""
        return 3 if math.isinf(self.sigma_v) else 0


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
class VelocityFactor(WeightedFactor):
    """Measured velocity of an antenna on a camera with a rolling shutter.

    e = -R^T (v + w x lever_arm) / readout - velocity, with the twist (w, v) of the image.
    """

    pose: Key  # key of the pose cam_from_world (R, t), on se3
    twist: Key  # key of the twist, ``("twist", image_id)``
    readout: Key  # key of the readout, ``("readout", camera_id)``; above 0
    velocity: ArrayLike  # (3,) velocity of the antenna in the world frame, length units per frame
    # (3, 3) symmetric positive definite, along the world axes, or its diagonal (3,), or a number
    information: ArrayLike | None = None
    # (3,) position of the antenna in the camera frame; zeros: the projection centre
    lever_arm: ArrayLike = field(default=(0.0, 0.0, 0.0), kw_only=True)

    kind = "velocity"
    _keys, _rows = ("pose", "twist", "readout"), ("velocity", "lever_arm")
    _given, _size = ("velocity", "lever_arm", "information"), 3
