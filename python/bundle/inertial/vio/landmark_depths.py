"""Landmarks of a window between its solves: x, y and 1 / z in the image that anchors them.

Inverse depths follow from known poses by linear triangulation of all landmarks at once.

A landmark with the anchor ray m = (x, y, 1) is at y = A m + l t in camera j with l = 1 / z, where A
= R_j R_a^T and t is the position of the anchor's camera in camera j. Its observation (u, v) gives
y_x - u y_z = 0 and y_y - v y_z = 0, two equations linear in l:

    l (t_x - u t_z) = u (A m)_z - (A m)_x,        the same with v and y.

Least squares over all observations of the landmark gives near and far landmarks the same weight,
because y_z is about 1 for small motions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bundle.inertial.vio.landmark_table import LandmarkTable
from bundle.inertial.vio.window_frame import WindowFrame
from bundle.model.rigid_motions import rotation_matrices

Array = np.ndarray[Any, Any]


def camera_poses(states: Array, camera_from_imu: Array) -> tuple[Array, Array]:
    """Return rotations (n, 3, 3) camera_from_world and camera centres (n, 3) in the world."""
    world_from_imu = rotation_matrices(states[:, :4])
    rotation = rotation_matrices(camera_from_imu[None, :4])[0]
    offset = -rotation.T @ camera_from_imu[4:]  # position of the camera in the IMU frame
    return rotation @ world_from_imu.transpose(0, 2, 1), states[:, 4:7] + world_from_imu @ offset


def _motion(rotations: Array, centres: Array, table: LandmarkTable) -> tuple[Array, Array]:
    """Return A m and t of each observation, both (k, 3)."""
    anchors = table.anchors[table.landmarks]
    rays = np.c_[table.anchor_xy, np.ones(len(table.ids))][table.landmarks]
    in_world = np.einsum("kji,kj->ki", rotations[anchors], rays)
    turned = np.einsum("kij,kj->ki", rotations[table.observers], in_world)
    baseline = centres[anchors] - centres[table.observers]
    return turned, np.einsum("kij,kj->ki", rotations[table.observers], baseline)


class Triangulation:
    """Inverse depths of the landmarks of a table from known poses.

    ``rotations`` are camera_from_world (n, 3, 3); ``sigma`` is that of an observation.
    """

    def __init__(
        self, rotations: Array, centres: Array, table: LandmarkTable, sigma: float
    ) -> None:
        self.table, self.sigma = table, sigma
        self.turned, self.shift = _motion(rotations, centres, table)

    def least_squares(self) -> Array:
        """Return the inverse depth of each landmark; 0 (at infinity) without parallax."""
        turned, shift, table = self.turned, self.shift, self.table
        a = shift[:, :2] - table.xy * shift[:, 2:]
        b = table.xy * turned[:, 2:] - turned[:, :2]
        count = len(table.ids)
        top = np.bincount(table.landmarks, np.sum(a * b, 1), count)
        bottom = np.bincount(table.landmarks, np.sum(a * a, 1), count)
        return np.where(bottom > 1e-12, top / np.maximum(bottom, 1e-12), 0.0)

    def costs(self, depths: Array) -> Array:
        """Return a robust cost of each landmark; infinite if it is behind a camera."""
        table = self.table
        point = self.turned + depths[table.landmarks][:, None] * self.shift
        z = point[:, 2]
        front = z > 1e-3
        error = point[:, :2] / np.where(front, z, 1.0)[:, None] - table.xy
        each = np.log1p(np.sum(error**2, 1) / self.sigma**2)
        # Without any observation, bincount returns integers.
        cost = np.bincount(table.landmarks, each, len(table.ids)).astype(np.float64)
        cost[table.landmarks[~front]] = np.inf
        return cost


def reanchored(
    rotations: Array, centres: Array, old: Array, xy: Array, depths: Array, new: Array
) -> Array:
    """Return inverse depths in other frames; not positive behind the new camera; 0 stays 0."""
    rays = np.c_[xy, np.ones(len(xy))]
    in_world = np.einsum("kji,kj->ki", rotations[old], rays)
    # multiplied by the inverse depth
    point = in_world + depths[:, None] * (centres[old] - centres[new])
    z = np.einsum("ki,ki->k", rotations[new][:, 2], point)
    return np.where(np.abs(z) > 1e-9, depths / np.where(z == 0, 1.0, z), -1.0)


class LandmarkDepths:
    """Landmarks by track: stamp of the anchoring frame, and x, y, 1 / z there."""

    def __init__(self) -> None:
        self.ids = np.empty(0, np.int64)
        self.stamps = np.empty(0, np.int64)
        self.values = np.empty((0, 3))

    def of(
        self,
        table: LandmarkTable,
        frames: Sequence[WindowFrame],
        camera_from_imu: Array,
        sigma: float,
    ) -> tuple[LandmarkTable, Array]:
        """Return the landmarks in front of all cameras, with x, y, 1 / z of each.

        The solve's last estimate or a triangulation from the current poses is used, whichever is
        better. With the last estimate alone, a landmark without parallax so far would be
        rejected as an outlier as soon as it gets parallax.
        """
        rotations, centres = camera_poses(np.array([f.state for f in frames]), camera_from_imu)
        stamps = np.array([f.stamp for f in frames], np.int64)
        points = np.c_[table.anchor_xy, np.zeros(len(table.ids))]
        if len(self.ids):
            at = np.minimum(np.searchsorted(self.ids, table.ids), len(self.ids) - 1)
            known = (self.ids[at] == table.ids) & (self.stamps[at] == stamps[table.anchors])
            points[known] = self.values[at[known]]
        triangulation = Triangulation(rotations, centres, table, sigma)
        found = triangulation.least_squares()
        old, new = triangulation.costs(points[:, 2]), triangulation.costs(found)
        better = new < old
        points[better] = np.c_[table.anchor_xy, found][better]
        valid = np.minimum(old, new) < np.inf
        if np.all(valid):
            return table, points
        return table.only(valid), points[valid]

    def put(self, table: LandmarkTable, frames: Sequence[WindowFrame], points: Array) -> None:
        """Store the result of a solve."""
        stamps = np.array([f.stamp for f in frames], np.int64)
        self.ids, self.stamps, self.values = table.ids, stamps[table.anchors], points

    def forget(self, ids: Array) -> None:
        """Drop tracks."""
        self._keep(~np.isin(self.ids, ids, assume_unique=True))

    def leave(
        self, frame: WindowFrame, rest: Sequence[WindowFrame], camera_from_imu: Array
    ) -> None:
        """Move the landmarks of an anchoring frame to the next frame that observes them."""
        mine = np.flatnonzero(self.stamps == frame.stamp)
        if not len(mine):
            return
        rotations, centres = camera_poses(
            np.array([f.state for f in (frame, *rest)]), camera_from_imu
        )
        target = np.zeros(len(mine), int)
        for place in range(len(rest), 0, -1):
            target[np.isin(self.ids[mine], rest[place - 1].tracks.ids)] = place
        gone = target == 0
        at = np.searchsorted(frame.tracks.ids, self.ids[mine])
        at = np.minimum(at, len(frame.tracks.ids) - 1)
        stays = ~gone & (frame.tracks.ids[at] == self.ids[mine])
        moved = mine[stays]
        self.values = self.values.copy()
        self.stamps = self.stamps.copy()
        self.values[moved, 2] = reanchored(
            rotations,
            centres,
            np.zeros(len(moved), int),
            frame.tracks.xy[at[stays]],
            self.values[moved, 2],
            target[stays],
        )
        for place in np.unique(target[stays]):
            tracks, mine_there = rest[place - 1].tracks, moved[target[stays] == place]
            there = np.searchsorted(tracks.ids, self.ids[mine_there])
            self.values[mine_there, :2] = tracks.xy[there]
        self.stamps[moved] = np.array([f.stamp for f in rest])[target[stays] - 1]
        kept = np.ones(len(self.ids), bool)
        kept[mine[~stays]] = False
        self._keep(kept)

    def _keep(self, kept: Array) -> None:
        self.ids, self.stamps, self.values = self.ids[kept], self.stamps[kept], self.values[kept]
