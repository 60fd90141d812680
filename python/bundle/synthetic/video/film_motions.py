"""Smooth seeded motions of a filming camera: a walk with a phone, strips of a drone, a car.

A motion is a function of the time in frames (30 per second). Lengths are metres; z is up.

    street      a car at 12 m/s along a street, every 3rd frame: it sways and pitches a little
    orbit       a walk at 1 m/s around an object, every 6th frame: the phone bobs
    drone_grid  strips at 8 m/s, 60 m above ground, every 60th frame: the gimbal swings slowly

Hands, wheels and wind add a shake that differs from image to image: the twist of an image is that
of the smooth motion plus noise (``shake``), the standard deviation of a tie between a twist and the
poses of the neighbours.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from bundle.model.rotations import dot, quaternion_from_matrix, rotate
from bundle.model.shutter_motion import twists_between

Array = NDArray[np.float64]

_STEP = 0.01
"""Frames between the two poses whose difference is the twist."""


class Motion(ABC):
    """A motion with its images and its structure.

    Attributes:
        frames: (num_images,) frame number of each image.
        strips: (num_images,) part of the motion; neighbours in time are neighbours in a part only.
        focal: focal length relative to the longer side of the image.
        reach: largest depth at which a point is recognised [m].
        shake: standard deviations of the twists' rotation [rad/frame] and translation [m/frame].
    """

    frames: NDArray[np.int64]
    strips: NDArray[np.int64]
    focal: float
    reach: float
    shake: tuple[float, float]

    @abstractmethod
    def views(self, times: Array) -> tuple[Array, Array, Array]:
        """Return centres, directions of view, and directions that point up in the image.

        Args:
            times: (num_images,) time of each image [frames].

        Returns:
            Three arrays (num_images, 3).
        """

    @abstractmethod
    def draw_points(self, rng: np.random.Generator, count: int) -> Array:
        """Draw points (count, 3)."""

    def poses(self, times: Array) -> Array:
        """Return cam_from_world (num_images, 7) at these times (num_images,) [frames]."""
        centers, forward, up = self.views(times)
        z = _unit(forward)
        x = _unit(np.cross(z, up))
        matrices = np.stack([x, np.cross(z, x), z], axis=1)
        return np.hstack([quaternion_from_matrix(matrices), -rotate(matrices, centers)])

    def twists(self) -> Array:
        """Return the twists (num_images, 6) per frame, rotation first, in the camera's frame."""
        before, after = (self.poses(self.frames.astype(float) + k * _STEP) for k in (-1, 1))
        return twists_between(before, after) / (2 * _STEP)


class PhoneWalk(Motion):
    """A walk around an object with a phone."""

    focal, reach, shake = 0.78, 20.0, (0.004, 0.004)

    def __init__(self, rng: np.random.Generator, num_images: int) -> None:
        self.frames = 6 * np.arange(num_images)
        self.strips = np.zeros(num_images, np.int64)
        self._bob = rng.uniform(0, 2 * np.pi, 3)
        self._start = rng.uniform(0, 2 * np.pi)
        self._speed = np.radians(rng.uniform(0.7, 1.0))  # per frame

    def views(self, times: Array) -> tuple[Array, Array, Array]:
        """Return the views; see the class of the base."""
        angle = self._start + self._speed * times
        height = 1.0 + 0.12 * np.sin(2 * np.pi * times / 70 + self._bob[0])
        distance = 2.2 + 0.1 * np.sin(times / 37 + self._bob[1])
        centers = np.stack([distance * np.cos(angle), distance * np.sin(angle), height], axis=1)
        aims = np.zeros_like(centers)
        aims[:, 0] = 0.05 * np.sin(times / 23 + self._bob[2])
        aims[:, 2] = 0.5
        return centers, aims - centers, _upward(len(times))

    def draw_points(self, rng: np.random.Generator, count: int) -> Array:
        """Draw 60 % on the object, the others in the room around it."""
        on_object = rng.normal(0.0, 0.3, (count, 3)) * [1, 1, 0.8] + [0, 0, 0.5]
        around = rng.uniform([-3, -3, -0.2], [3, 3, 2.2], (count, 3))
        return np.where(rng.random((count, 1)) < 0.6, on_object, around)


class DroneGrid(Motion):
    """Parallel strips of a drone that looks down.

    Args:
        rng: source of the swings of the gimbal.
        num_images: number of images.
        relief: height of the hills [m]; 0: flat ground.
        turns: True if the drone turns for every strip, so that its readout is always parallel to
            the flight; False if it flies back without turning.
    """

    focal, reach, shake = 0.75, 1000.0, (0.0008, 0.02)
    altitude, speed, spacing = 60.0, 0.267, 32.0
    step = 60

    def __init__(
        self, rng: np.random.Generator, num_images: int, relief: float = 3.0, *, turns: bool = True
    ) -> None:
        length = max(int(np.ceil(np.sqrt(2 * num_images))), 2)
        number = np.arange(num_images)
        self.strips = number // length
        self._pause = self.step * (length + 5)  # frames from strip to strip
        self.frames = self.step * (number % length) + self._pause * self.strips
        self._middle = 0.5 * self.step * (min(length, num_images) - 1)
        self._num_strips = int(self.strips[-1]) + 1
        self._swing = rng.uniform(0, 2 * np.pi, (self._num_strips, 3))
        self._hills = rng.uniform(0, 2 * np.pi, 2)
        self._relief, self._turns = relief, turns

    def views(self, times: Array) -> tuple[Array, Array, Array]:
        """Return the views; see the class of the base."""
        strips = self.strips
        along = times - self._pause * strips
        sign = np.where(strips % 2 == 0, 1.0, -1.0)
        swing = self._swing[strips].T
        x = sign * (along - self._middle) * self.speed
        y = (strips - (self._num_strips - 1) / 2) * self.spacing
        z = self.altitude + 0.8 * np.sin(along / 40 + swing[0])
        down = np.stack(
            [
                0.015 * np.sin(along / 50 + swing[1]),
                0.02 * np.cos(along / 35 + swing[2]),
                np.full(len(times), -1.0),
            ],
            axis=1,
        )
        heading = sign if self._turns else np.ones(len(times))
        return np.stack([x, y, z], axis=1), down, heading[:, None] * np.array([1.0, 0.0, 0.0])

    def draw_points(self, rng: np.random.Generator, count: int) -> Array:
        """Draw points on the ground below the strips."""
        half = [
            self._middle * self.speed + 0.6 * self.altitude,
            (self._num_strips - 1) / 2 * self.spacing + 0.6 * self.altitude,
        ]
        xy = rng.uniform(-1, 1, (count, 2)) * half
        hills = np.sin(xy[:, 0] / 17 + self._hills[0]) * np.cos(xy[:, 1] / 13 + self._hills[1])
        z = self._relief * (hills + rng.standard_normal(count) / 3)
        return np.hstack([xy, z[:, None]])


class Car(Motion):
    """A drive along a street."""

    focal, reach, shake = 0.70, 45.0, (0.0015, 0.004)
    speed = 0.4

    def __init__(self, rng: np.random.Generator, num_images: int) -> None:
        self.frames = 3 * np.arange(num_images)
        self.strips = np.zeros(num_images, np.int64)
        self._length = self.speed * float(self.frames[-1])
        self._sway = rng.uniform(0, 2 * np.pi, 4)

    def views(self, times: Array) -> tuple[Array, Array, Array]:
        """Return the views; see the class of the base."""
        sway = self._sway
        yaw = 0.06 * np.sin(times / 30 + sway[0])
        side = 0.8 * np.sin(times / 45 + sway[1])
        height = 1.6 + 0.02 * np.sin(times / 9 + sway[2])
        pitch = -0.02 + 0.01 * np.sin(times / 11 + sway[3])
        centers = np.stack([self.speed * times, side, height], axis=1)
        return centers, np.stack([np.cos(yaw), np.sin(yaw), pitch], axis=1), _upward(len(times))

    def draw_points(self, rng: np.random.Generator, count: int) -> Array:
        """Draw points on the facades of both sides and on the road, in equal parts."""
        x = rng.uniform(2, self._length + 60, count)
        kind = rng.integers(0, 3, count)
        facade = rng.uniform(5, 9, count) * np.where(kind == 0, 1, -1)
        y = np.where(kind < 2, facade, rng.uniform(-5, 5, count))
        z = np.where(kind < 2, rng.uniform(0, 7, count), 0.05 * rng.standard_normal(count))
        return np.stack([x, y, z], axis=1)


MOTIONS = {"street": Car, "orbit": PhoneWalk, "drone_grid": DroneGrid}
"""Motion of each kind of scene."""


def _unit(vectors: Array) -> Array:
    return vectors / np.sqrt(dot(vectors, vectors))[:, None]


def _upward(count: int) -> Array:
    return np.tile([0.0, 0.0, 1.0], (count, 1))
