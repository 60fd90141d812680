"""Factors of the attitude of an image: a direction of the world, the rotation, the heading.

Each constrains the rotation R of one pose cam_from_world. The core computes residuals and
Jacobians; ``cpp/core/factors/attitude_factors.h`` has the derivations. Angles are radians.
"""

from __future__ import annotations

from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.graphs.factors.factors import Factor, as_information
from bundle.graphs.factors.variables import Key
from bundle.interface.option_fields import number

DOWN = (0.0, 0.0, -1.0)
"""Direction of gravity in a world whose third axis points up."""
FORWARD = (0.0, 0.0, 1.0)
"""Viewing direction of a camera in its own frame."""


@dataclass(frozen=True, eq=False, repr=False)
class _AttitudeFactor(Factor):
    """Base class of factors of the rotation of one pose."""

    key: Key

    @property
    def keys(self) -> tuple[Key, ...]:
        """Variables in the order of the Jacobians."""
        return (self.key,)

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
    change it, and a direction that is upside down does not pull.

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

    def __post_init__(self) -> None:
        super().__post_init__()
        self._freeze_direction("direction")
        self._freeze_direction("axis")
        self._set("sigma", number(f"{self.name}: sigma", self.sigma, above=0))

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:  # noqa: ARG002
        """See :meth:`Factor.core_arguments`."""
        return self.direction, self.axis, self.sigma


@dataclass(frozen=True, eq=False, repr=False)
class RotationFactor(_AttitudeFactor):
    """Measured rotation Z of cam_from_world: e = Log(Z^T R), along the axes of the world.

    Attributes:
        key: pose cam_from_world (R, t), on se3.
        rotation: (4,) quaternion qx qy qz qw of Z.
        information: (3, 3) symmetric positive definite, along the world axes, in 1 / radians
            squared, or a number.

    Raises:
        InputError: an argument is not numeric.
    """

    rotation: ArrayLike
    information: ArrayLike

    kind = "rotation"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._freeze_row("rotation")
        self._freeze_matrix("information")

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:  # noqa: ARG002
        """See :meth:`Factor.core_arguments`."""
        return self.rotation, as_information(name, np.asarray(self.information), 3)


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

    def __post_init__(self) -> None:
        super().__post_init__()
        self._freeze_direction("axis")
        self._set("heading", number(f"{self.name}: heading", self.heading))
        self._set("sigma", number(f"{self.name}: sigma", self.sigma, above=0))

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:  # noqa: ARG002
        """See :meth:`Factor.core_arguments`."""
        return self.axis, self.heading, self.sigma
