"""Motions about the vertical: directions that an IMU leaves free and closures correct.

Gravity determines roll and pitch; heading and position drift. A motion rotates about z and
translates: x -> Rz(yaw) x + t. The yaw of a rigid motion is its twist about z: the angle 2 atan2(z,
w) of the quaternion (x, y, z, w).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.arrays import Array as Declared
from bundle.base.arrays import as_declared
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.interface.option_fields import number
from bundle.model.rigid_motions import quaternion_multiply

Array = NDArray[np.float64]


def twist_about_z(quaternion: Array) -> float:
    """Return the angle about z of a rotation, in (-pi, pi]."""
    angle = 2 * math.atan2(quaternion[2], quaternion[3])
    return math.remainder(angle, 2 * math.pi)


@dataclass(frozen=True, eq=False, repr=False)
class YawMotion(Displayed):
    """Motion x -> Rz(yaw) x + translation.

    Attributes:
        yaw: angle in radians.
        translation: (3,) m.

    Raises:
        InputError: a number is not finite.
    """

    yaw: float = 0.0
    translation: ArrayLike = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "yaw", number("YawMotion: yaw", self.yaw))
        shift = as_declared("YawMotion: translation", self.translation, Declared((3,), "finite"))
        object.__setattr__(self, "translation", shift)

    @property
    def shift(self) -> Array:
        """Translation as an array."""
        return np.asarray(self.translation, np.float64)

    @staticmethod
    def between(start: Array, end: Array) -> YawMotion:
        """Return the motion between two poses, from their positions and headings.

        Args:
            start: qx qy qz qw tx ty tz, followed by any numbers.
            end: likewise.
        """
        back = np.array([-start[0], -start[1], -start[2], start[3]])
        yaw = twist_about_z(quaternion_multiply(end[None, :4], back[None])[0])
        return YawMotion(yaw, end[4:7] - _turned(yaw, start[4:7]))

    def __matmul__(self, other: YawMotion) -> YawMotion:
        """Return the composition: ``other`` first, then this motion."""
        shift = _turned(self.yaw, other.shift) + self.shift
        return YawMotion(math.remainder(self.yaw + other.yaw, 2 * math.pi), shift)

    def inverse(self) -> YawMotion:
        """Return the inverse motion."""
        return YawMotion(-self.yaw, -_turned(-self.yaw, self.shift))

    def moved(self, state: Array) -> Array:
        """Return a state (16,), or one or more poses (7,), moved with the world."""
        out = state.copy()
        x, y, z, w = state[:4].tolist()
        sine, cosine = math.sin(self.yaw / 2), math.cos(self.yaw / 2)
        out[:4] = (  # (0, 0, sine, cosine) times the state's quaternion
            cosine * x - sine * y,
            cosine * y + sine * x,
            cosine * z + sine * w,
            cosine * w - sine * z,
        )
        out[4:7] = self.place(state[4:7])
        if len(out) >= 10:
            out[7:10] = _turned(self.yaw, state[7:10])
        return out

    def place(self, position: Array) -> Array:
        """Return a position (3,) moved with the world."""
        return _turned(self.yaw, position) + self.shift

    def towards(self, target: YawMotion, position: Array, share: float) -> YawMotion:
        """Interpolate between two yaw motions as observed at `position`.

        Heading and the image of ``position`` change by this share of the target's change. A
        rotation about a distant origin therefore causes no swing.
        """
        here, there = self.place(position), target.place(position)
        yaw = self.yaw + share * math.remainder(target.yaw - self.yaw, 2 * math.pi)
        return YawMotion(yaw, here + share * (there - here) - _turned(yaw, position))

    def _display(self) -> Display:
        shift = " ".join(f"{value:.4g}" for value in self.shift)
        return Display(
            title="YawMotion",
            facts=(("yaw", f"{math.degrees(self.yaw):.4g} degrees"), ("translation", f"{shift} m")),
        )


@dataclass(frozen=True, eq=False, repr=False)
class Correction(Displayed):
    """Pose of the window's world in the graph's world at a time.

    Attributes:
        timestamp_ns: stamp of the newest keyframe in the graph.
        world_from_window: the motion.
        num_keyframes: number of keyframes in the graph.
        num_closures: number of closures in the graph.
    """

    timestamp_ns: int
    world_from_window: YawMotion
    num_keyframes: int = 0
    num_closures: int = 0

    def _display(self) -> Display:
        return Display(
            title=f"Correction of {self.timestamp_ns} ns",
            facts=(
                ("graph", f"{self.num_keyframes} keyframes, {self.num_closures} closures"),
                *self.world_from_window._display().facts,
            ),
        )


def _turned(yaw: float, vector: Array) -> Array:
    cosine, sine = math.cos(yaw), math.sin(yaw)
    x, y, z = vector.tolist()
    return np.array([cosine * x - sine * y, sine * x + cosine * y, z])
