"""Scenes filmed in a smooth motion: drone grids, and all scenes with a rolling shutter.

An observation is the position at which the shutter reads the point (:mod:`..shutter_motion` solves
the fixed point), plus noise in both coordinates. A camera recognises a point within its reach with
the probability 0.65; surfaces do not occlude each other.

Neighbouring images share their motion: ``ties`` lists, for each image, the images before and after
it, from whose poses the twist per frame follows as Log(T_b T_a^-1) / (frame_b - frame_a).
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.interface.scene_options import MIN_TRACK_LENGTH, SceneOptions
from bundle.model.problem import Problem
from bundle.model.rigid_motions import dot, quaternion_from_matrix, quaternion_rotate, rotate
from bundle.model.rolling_shutter import RollingShutter
from bundle.model.shutter_motion import read_positions, twists_between
from bundle.synthetic.observations import check_images, components, measure
from bundle.synthetic.scene import (
    Images,
    Intrinsics,
    Pairs,
    Start,
    draw_intrinsics,
    median_distance,
)

Array = NDArray[np.float64]

_RECOGNISED = 0.65
_NEAREST = 0.3  # smallest depth of a point [m]
_MARGIN = 5.0  # pixels at the border of an image without points
_MOST_ROUNDS = 12
_DIRECTIONS = ("columns", "rows")


@dataclass(frozen=True, eq=False)
class FilmedScene:
    """A filmed scene and its start."""

    # start of a solve: measured observations, perturbed poses, points and cameras, zero twists
    problem: Problem
    ground_truth: Problem  # the same observations with the true values
    # (num_observations,) True for observations replaced by random pixels
    is_outlier: NDArray[np.bool_]
    # (num_images, 6) true twist m of each image, per height; zero for a global shutter
    twists: Array
    readout: float  # readout as a share of the frame time
    frames: NDArray[np.int64]  # (num_images,) frame number of each image
    # (num_images, 3) index of the image before and after, and the frames between them; at the ends
    # of a strip the image itself. Zero frames: no neighbour
    ties: NDArray[np.int64]
    # standard deviations of a tie, rotation [rad/frame] and translation [m/frame]
    shake: tuple[float, float]


def film(
    options: SceneOptions,
    motion: Motion | None = None,
    *,
    direction: str = "rows",
    turning: bool = True,
) -> FilmedScene:
    """Make a seeded scene of a moving camera with a rolling shutter.

    Args:
        options: options of the scene; ``rolling_shutter`` is the readout.
        motion: motion and structure; None: that of ``options.scene``, seeded by ``options.seed``.
        direction: "rows" or "columns", the order in which the sensor is read.
        turning: False removes the rotation of all twists.
    """
    layout, structure, measurement, start_seed = np.random.SeedSequence(options.seed).spawn(4)
    rng = np.random.default_rng(layout)
    if motion is None:
        motion = MOTIONS[options.scene](rng, options.num_images)
    images, cameras = _images(rng, motion, options)
    twists = motion.twists()
    shakes = np.repeat(motion.shake, 3) * rng.standard_normal(twists.shape)
    twists = options.rolling_shutter * (twists + shakes)
    if not turning:
        twists[:, :3] = 0
    axis = _DIRECTIONS.index(direction)
    points, pairs, exact = _observe(
        np.random.default_rng(structure), motion, images, twists, axis, options
    )
    sizes = images.camera_sizes[images.image_camera[pairs.image]]
    xy, is_outlier = measure(np.random.default_rng(measurement), exact, sizes, options)
    by_image = np.argsort(pairs.image, kind="stable")
    counts = np.bincount(pairs.image, minlength=options.num_images)
    keypoint = np.empty(len(pairs), np.int32)
    keypoint[by_image] = np.arange(len(pairs)) - np.repeat(np.cumsum(counts) - counts, counts)
    ties = _ties(motion)
    shutter = None
    if options.rolling_shutter:
        shutter = RollingShutter(
            direction=(direction,) * images.num_cameras,
            readout=np.full(images.num_cameras, options.rolling_shutter),
            twist=twists,
            frames=motion.frames.astype(float),
            neighbours=np.where(ties[:, 2:] > 0, ties[:, :2], -1),
        )
    truth = images.replace(
        points=points,
        point_ids=np.arange(1, len(points) + 1),
        observation_image=pairs.image,
        observation_point=pairs.point,
        observation_xy=xy,
        observation_keypoint=keypoint,
        rolling_shutter=shutter,
    )
    start = Start(start_seed, truth, cameras, median_distance(truth), options)
    return FilmedScene(
        problem=truth.replace(
            cam_from_world=start.cam_from_world,
            points=start.points(points),
            camera_params=start.camera_params,
            rolling_shutter=(
                None if shutter is None else shutter.replace(twist=np.zeros_like(twists))
            ),
        ),
        ground_truth=truth,
        is_outlier=is_outlier,
        twists=twists,
        readout=options.rolling_shutter,
        frames=motion.frames,
        ties=ties,
        shake=motion.shake,
    )


def _images(
    rng: np.random.Generator, motion: Motion, options: SceneOptions
) -> tuple[Problem, Intrinsics]:
    """Return the true images and cameras, without points."""
    count = options.num_images
    nowhere = np.zeros((count, 3))
    images = Images(
        centers=nowhere,
        rotations=np.tile(np.eye(3), (count, 1, 1)),
        focal=np.full(count, motion.focal),
        sizes=np.tile(np.array(options.image_size, np.int64), (count, 1)),
        richness=np.ones(count),
        ball_centers=nowhere,
        ball_radii=np.zeros(count),
    )
    cameras = draw_intrinsics(rng, images, options.camera_model, shared=options.has_shared_camera)
    poses = motion.poses(motion.frames.astype(float))
    names = tuple(f"frame_{frame:06d}.jpg" for frame in motion.frames.tolist())
    return cameras.problem_of(poses, names), cameras


def _observe(
    rng: np.random.Generator,
    motion: Motion,
    images: Problem,
    twists: Array,
    axis: int,
    options: SceneOptions,
) -> tuple[Array, Pairs, Array]:
    """Draw points until enough of them are observed; return points, pairs and exact pixels."""
    kept: list[tuple[Array, Pairs, Array]] = []
    found = drawn = 0
    wanted = options.num_points
    while found < wanted:
        if len(kept) == _MOST_ROUNDS:
            raise InputError(
                f"num_points: expected at most {found}, the number that is visible in "
                f"{MIN_TRACK_LENGTH} images after {drawn} draws, found {wanted}"
            )
        points = motion.draw_points(rng, 2 * (wanted - found) + 50)
        drawn += len(points)
        pairs, xy = _seen(rng, motion, images, twists, axis, points)
        good = np.flatnonzero(pairs.counts >= MIN_TRACK_LENGTH)[: wanted - found]
        chosen = np.zeros(len(points), np.bool_)
        chosen[good] = True
        kept.append((points[good], pairs.of_points(good), xy[chosen[pairs.point]]))
        found += len(good)
    pairs = Pairs.concatenate([part[1] for part in kept])
    check_images(pairs, np.ones(len(pairs), np.bool_), images.num_images)
    if np.ptp(components(pairs, images.num_images)[0]):
        raise InputError(
            "num_points: expected more points, so that common points connect all images, "
            f"found {wanted}"
        )
    return (
        np.concatenate([part[0] for part in kept]),
        pairs,
        np.concatenate([part[2] for part in kept]),
    )


def _seen(
    rng: np.random.Generator,
    motion: Motion,
    images: Problem,
    twists: Array,
    axis: int,
    points: Array,
) -> tuple[Pairs, Array]:
    """Return the recognised observations of points, and where the shutter reads them."""
    found_point, found_image, found_xy = [], [], []
    half = images.camera_sizes.astype(float) / 2
    for image in range(images.num_images):
        camera = int(images.image_camera[image])
        pose = np.broadcast_to(images.cam_from_world[image], (len(points), 7))
        local = quaternion_rotate(pose[:, :4], points) + pose[:, 4:]
        depth = local[:, 2]
        # A wide cone about the field of view; lenses and motion move points by less.
        slope = 1.5 * np.hypot(*half[camera]) / images.camera_params[camera, 0]
        near = (depth > _NEAREST) & (depth < motion.reach)
        near &= np.hypot(local[:, 0], local[:, 1]) < slope * depth
        near &= rng.random(len(points)) < _RECOGNISED
        index = np.flatnonzero(near)
        which = np.full(len(index), image)
        twist = np.broadcast_to(twists[image], (len(index), 6))
        order = np.full(len(index), axis)
        xy, _ = read_positions(images, which, local[index], twist, order)
        inside = (np.abs(xy - half[camera]) < half[camera] - _MARGIN).all(axis=1)
        found_point.append(index[inside])
        found_image.append(which[inside])
        found_xy.append(xy[inside])
    point, image_of = np.concatenate(found_point), np.concatenate(found_image)
    order = np.argsort(point, kind="stable")
    pairs = Pairs.from_sorted(
        point[order].astype(np.int32), image_of[order].astype(np.int32), len(points)
    )
    return pairs, np.concatenate(found_xy)[order]


def _ties(motion: Motion) -> NDArray[np.int64]:
    """Return the images before and after each image, and the frames between."""
    index = np.arange(len(motion.frames))
    before, after = np.maximum(index - 1, 0), np.minimum(index + 1, len(index) - 1)
    before = np.where(motion.strips[before] == motion.strips, before, index)
    after = np.where(motion.strips[after] == motion.strips, after, index)
    return np.stack([before, after, motion.frames[after] - motion.frames[before]], axis=1)


# Smooth seeded motions of a filming camera: a walk with a phone, strips of a drone, a car.
#
# A motion is a function of the time in frames (30 per second). Lengths are metres; z is up.
#
#     street      a car at 12 m/s along a street, every 3rd frame: it sways and pitches a little
#     orbit       a walk at 1 m/s around an object, every 6th frame: the phone bobs
#     drone_grid  strips at 8 m/s, 60 m above ground, every 60th frame: the gimbal swings slowly
#
# Hands, wheels and wind add a shake that differs from image to image: the twist of an image is that
# of the smooth motion plus noise (``shake``), the standard deviation of a tie between a twist and
# the poses of the neighbours.


_STEP = 0.01  # frames between the two poses whose difference is the twist


class Motion(ABC):
    """A motion with its images and its structure."""

    frames: NDArray[np.int64]  # (num_images,) frame number of each image
    # (num_images,) part of the motion; neighbours in time are neighbours in a part only
    strips: NDArray[np.int64]
    focal: float  # focal length relative to the longer side of the image
    reach: float  # largest depth at which a point is recognised [m]
    # standard deviations of the twists' rotation [rad/frame] and translation [m/frame]
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
        """Return the views; see the base class."""
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
        """Return the views; see the base class."""
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
        """Return the views; see the base class."""
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
