"""IMU factors: motion between two states, and random walks of biases."""

from __future__ import annotations

import copy
import math
from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bundle.base.arrays import check_distinct, check_type, freeze
from bundle.base.records import dataclass
from bundle.graphs.factors.factors import Factor
from bundle.graphs.factors.variables import Key
from bundle.inertial.preintegration.preintegration import Preintegration, as_vector
from bundle.interface.option_fields import number
from bundle.model.sequence.calibration import ImuNoise


class _MotionFactor(Factor):
    """Base of factors of a preintegrated motion, of which they store a copy."""

    motion: Preintegration
    gravity: ArrayLike

    def __post_init__(self) -> None:
        super().__post_init__()
        check_distinct(f"{self.name}: expected different variables", self.keys)
        check_type(f"{self.name}: motion", self.motion, Preintegration)
        self._set("motion", copy.copy(self.motion))
        self._set("gravity", freeze(as_vector(f"{self.name}: gravity", self.gravity).copy()))


@dataclass(frozen=True, eq=False, repr=False)
class ImuFactor(_MotionFactor):
    """IMU measurement between two states i and j.

    Let R, p, v be the state of i (world_from_imu) and R', p', v' that of j, T seconds later. Let g
    be gravity, and dR, dp, dv the preintegrated motion corrected to the biases of i. The error is,
    in this order, Log(dR^T R^T R'), R^T (p' - p - v T - 1/2 g T^2) - dp and
    R^T (v' - v - g T) - dv.

    Attributes:
        pose_i: key of the pose world_from_imu of i, on se3; positions in metres.
        velocity_i: key of its velocity in the world, Euclidean (3,), m/s.
        bias_i: key of its biases, Euclidean (6,): gyroscope (rad/s), accelerometer (m/s^2).
        pose_j: key of the pose of j.
        velocity_j: key of the velocity of j.
        motion: a :class:`bundle.Preintegration`; the factor stores a copy.
        gravity: (3,) m/s^2 in the world.
        gravity_key: key of a gravity variable: its vector on a Euclidean (3,) variable, or a
            rotation Q of ``gravity``, Q g, on so3. If ``gravity`` is along an axis, only two
            coordinates of so3 are observable: hold the third constant. None: gravity is known.
        scale_key: key of a Euclidean (1,) variable s: positions of the poses are s p in metres, for
            camera poses without a unit. Velocities stay in m/s. None: positions are in metres.

    Raises:
        InputError: a key occurs twice, or gravity is not three finite numbers.
            :meth:`bundle.FactorGraph.add_factor` raises it if sizes do not fit the variables, or
            if the covariance of the motion is not positive definite.
    """

    pose_i: Key
    velocity_i: Key
    bias_i: Key
    pose_j: Key
    velocity_j: Key
    motion: Preintegration
    gravity: ArrayLike = field(default=(0.0, 0.0, -9.81), kw_only=True)
    gravity_key: Key | None = field(default=None, kw_only=True)
    scale_key: Key | None = field(default=None, kw_only=True)

    kind = "imu"

    @property
    def keys(self) -> tuple[Key, ...]:
        """Variables in the order of the Jacobians."""
        optional = (key for key in (self.gravity_key, self.scale_key) if key is not None)
        return (self.pose_i, self.velocity_i, self.bias_i, self.pose_j, self.velocity_j, *optional)

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:  # noqa: ARG002
        """See :meth:`Factor.core_arguments`."""
        return (
            self.motion.core_motion(),
            self.gravity,
            self.gravity_key is not None,
            self.scale_key is not None,
        )


@dataclass(frozen=True, eq=False, repr=False)
class ImageImuFactor(_MotionFactor):
    """IMU measurement between two images of a reconstruction in metres.

    The error is that of :class:`ImuFactor` for world_from_imu = cam_from_world^-1 camera_from_imu.
    """

    image_i: Key  # key of the pose cam_from_world of i, on se3; positions in metres
    velocity_i: Key  # key of its IMU's velocity in the world, Euclidean (3,), m/s
    gyro_bias_i: Key  # key of the gyroscope's bias at i, Euclidean (3,), rad/s
    accel_bias_i: Key  # key of the accelerometer's bias at i, Euclidean (3,), m/s^2
    image_j: Key  # key of the pose of j
    velocity_j: Key  # key of the velocity of j
    motion: Preintegration  # a :class:`bundle.Preintegration`; the factor stores a copy
    camera_from_imu: ArrayLike  # (7,) qx qy qz qw tx ty tz, metres; constant
    gravity: ArrayLike = field(default=(0.0, 0.0, -9.81), kw_only=True)  # (3,) m/s^2 in the world

    kind = "image_imu"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._freeze_row("camera_from_imu")

    @property
    def keys(self) -> tuple[Key, ...]:
        """Variables in the order of the Jacobians."""
        return (
            self.image_i,
            self.velocity_i,
            self.gyro_bias_i,
            self.accel_bias_i,
            self.image_j,
            self.velocity_j,
        )

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:  # noqa: ARG002
        """See :meth:`Factor.core_arguments`."""
        return self.motion.core_motion(), self.gravity, self.camera_from_imu


@dataclass(frozen=True, eq=False, repr=False)
class BiasWalkFactor(Factor):
    """Random walk of biases between two states: e = bias_j - bias_i, sigma = density sqrt(T).

    Attributes:
        bias_i: key of the biases of i, Euclidean (6,): gyroscope (rad/s), accelerometer (m/s^2).
        bias_j: key of the biases of j.
        noise: a :class:`bundle.ImuNoise` with random walks above 0.
        duration: T, seconds from i to j, above 0.

    Raises:
        InputError: a number is out of range, or both keys are the same.
    """

    bias_i: Key
    bias_j: Key
    noise: ImuNoise
    duration: float

    kind = "between"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_distinct(f"{self.name}: expected two different variables", self.keys)
        check_type(f"{self.name}: noise", self.noise, ImuNoise)
        self._set("duration", number(f"{self.name}: duration", self.duration, above=0))
        for walk in ("gyro_bias_random_walk", "accel_bias_random_walk"):
            number(f"{self.name}: {walk}", getattr(self.noise, walk), above=0)

    @property
    def keys(self) -> tuple[Key, ...]:
        """Variables in the order of the Jacobians."""
        return self.bias_i, self.bias_j

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:  # noqa: ARG002
        """See :meth:`Factor.core_arguments`."""
        walks = [self.noise.gyro_bias_random_walk] * 3 + [self.noise.accel_bias_random_walk] * 3
        sigmas = np.array(walks) * math.sqrt(self.duration)
        return np.zeros(6), np.diag(1 / sigmas**2)
