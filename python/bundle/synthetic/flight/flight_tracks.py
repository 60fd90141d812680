"""Tracks of a camera that flies past points.

Every image keeps the tracks of the previous image that are still in view and have not reached their
length, and adds random points that are not tracked. A lost point returns under another id, as with
any real tracker.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.model.rigid_motions import inverse_poses, multiply_poses
from bundle.model.rotations import rotation_matrices
from bundle.synthetic.flight.motions import Surroundings

__all__ = ["Pinhole", "Tracked", "follow"]

Array = NDArray[np.float64]

CHUNK = 64  # number of images to project at once


class Pinhole(NamedTuple):
    """Pinhole camera: focal length, principal point and size in pixels."""

    focal: float
    center: tuple[float, float]
    size: tuple[int, int]


class Tracked(NamedTuple):
    """Observations sorted by image, then id.

    Attributes:
        image: (m,) index of the image.
        track: (m,) id of the track.
        point: (m,) index of the point.
        xy: (m, 2) pixels without noise.
    """

    image: NDArray[np.int64]
    track: NDArray[np.int64]
    point: NDArray[np.int64]
    xy: Array


def follow(
    poses: Array,
    camera_from_imu: Array,
    lens: Pinhole,
    around: Surroundings,
    num_tracks: int,
    track_length: float,
    rng: np.random.Generator,
) -> Tracked:
    """Return the tracks along poses (n, 7), world_from_imu.

    Args:
        poses: poses of the images.
        camera_from_imu: (7,).
        lens: camera.
        around: points in the world.
        num_tracks: tracks wanted per image.
        track_length: mean number of images of a track.
        rng: source of points and lengths.
    """
    mount = np.tile(camera_from_imu, (len(poses), 1))
    cameras = multiply_poses(mount, inverse_poses(poses))
    turns, shifts = rotation_matrices(cameras[:, :4]), cameras[:, 4:]
    x = around.points[:, 0]
    ids = points = left = np.zeros(0, np.int64)  # active tracks
    next_id = 0
    parts: list[tuple[NDArray[np.int64], ...]] = []
    coordinates: list[Array] = []
    for begin in range(0, len(poses), CHUNK):
        chunk = slice(begin, min(begin + CHUNK, len(poses)))
        ahead = poses[chunk, 4]
        low = int(np.searchsorted(x, ahead.min() - around.far))
        near = around.points[low : int(np.searchsorted(x, ahead.max() + around.far))]
        local = np.einsum("fij,pj->fpi", turns[chunk], near) + shifts[chunk][:, None]
        depth = np.maximum(local[..., 2:], 1e-9)
        pixels = lens.focal * local[..., :2] / depth + np.array(lens.center)
        inside = (pixels >= 0) & (pixels < np.array(lens.size))
        seen = inside.all(axis=2) & (local[..., 2] > around.near) & (local[..., 2] < around.far)
        for row, visible in enumerate(seen):
            place = points - low
            known = (place >= 0) & (place < len(near)) & (left > 0)
            known[known] = visible[place[known]]
            ids, points, left = ids[known], points[known], left[known] - 1
            wanted = num_tracks - len(ids)
            if wanted > 0:
                free = visible.copy()
                free[points - low] = False
                fresh = rng.permutation(np.flatnonzero(free))[:wanted]
                ids = np.append(ids, next_id + np.arange(len(fresh)))
                points = np.append(points, fresh + low)
                left = np.append(left, rng.geometric(1 / track_length, len(fresh)) - 1)
                next_id += len(fresh)
            parts.append((np.full(len(ids), begin + row), ids, points))
            coordinates.append(pixels[row, points - low])
    image, track, point = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Tracked(image, track, point, np.concatenate(coordinates))
