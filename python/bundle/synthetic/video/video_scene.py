"""Synthesis of a filmed scene: images of a smooth motion, read by a rolling shutter.

An observation is the position at which the shutter reads the point (:mod:`..shutter_motion` solves
the fixed point), plus noise in both coordinates. A camera recognises a point within its reach with
the probability 0.65; surfaces do not occlude each other.

Neighbouring images share their motion: ``ties`` lists, for each image, the images before and after
it, from whose poses the twist per frame follows as Log(T_b T_a^-1) / (frame_b - frame_a).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.interface.scene_options import MIN_TRACK_LENGTH, SceneOptions
from bundle.model.problem import Problem
from bundle.model.rolling_shutter import RollingShutter
from bundle.model.rotations import quaternion_rotate
from bundle.model.shutter_motion import read_positions
from bundle.synthetic.intrinsics import Intrinsics, draw_intrinsics
from bundle.synthetic.pixel_noise import measure
from bundle.synthetic.scene import Images, Pairs
from bundle.synthetic.start import Start, median_distance
from bundle.synthetic.tracks import check_images, components
from bundle.synthetic.video.film_motions import MOTIONS, Motion

Array = NDArray[np.float64]

_RECOGNISED = 0.65
_NEAREST = 0.3  # smallest depth of a point [m]
_MARGIN = 5.0  # pixels at the border of an image without points
_MOST_ROUNDS = 12
_DIRECTIONS = ("columns", "rows")


@dataclass(frozen=True, eq=False)
class FilmedScene:
    """A filmed scene and its start.

    Attributes:
        problem: start of a solve: measured observations, perturbed poses, points and cameras, zero
            twists.
        ground_truth: the same observations with the true values.
        is_outlier: (num_observations,) True for observations replaced by random pixels.
        twists: (num_images, 6) true twist m of each image, per height; zero for a global shutter.
        readout: readout as a share of the frame time.
        frames: (num_images,) frame number of each image.
        ties: (num_images, 3) index of the image before and after, and the frames between them; at
            the ends of a strip the image itself. Zero frames: no neighbour.
        shake: standard deviations of a tie, rotation [rad/frame] and translation [m/frame].
    """

    problem: Problem
    ground_truth: Problem
    is_outlier: NDArray[np.bool_]
    twists: Array
    readout: float
    frames: NDArray[np.int64]
    ties: NDArray[np.int64]
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

    Raises:
        InputError: too few points are visible.
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
