"""Inverse depths of landmarks from known poses, all of them at once.

Of a landmark with the anchor ray m = (x, y, 1), camera j sees y = A m + l t with l = 1 / z, where
A = R_j R_a^T and t is the anchor's camera in camera j. Its observation (u, v) says
y_x - u y_z = 0 and y_y - v y_z = 0: two equations linear in l,

    l (t_x - u t_z) = u (A m)_z - (A m)_x,        the same with v and y.

Least squares over all observations of the landmark, which weighs near and far ones alike since
y_z is about 1 for small motions.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bundle.inertial.vio.landmark_table import LandmarkTable
from bundle.model.rotations import rotation_matrices

__all__ = ["Triangulation", "camera_poses", "reanchored"]

Array = np.ndarray[Any, Any]


def camera_poses(states: Array, camera_from_imu: Array) -> tuple[Array, Array]:
    """Return rotations (n, 3, 3) camera_from_world and camera centres (n, 3) in the world."""
    world_from_imu = rotation_matrices(states[:, :4])
    rotation = rotation_matrices(camera_from_imu[None, :4])[0]
    offset = -rotation.T @ camera_from_imu[4:]  # the camera in the IMU's frame
    return rotation @ world_from_imu.transpose(0, 2, 1), states[:, 4:7] + world_from_imu @ offset


def _motion(rotations: Array, centres: Array, table: LandmarkTable) -> tuple[Array, Array]:
    """Return A m and t of each observation, (k, 3) both."""
    anchors = table.anchors[table.landmarks]
    rays = np.c_[table.anchor_xy, np.ones(len(table.ids))][table.landmarks]
    in_world = np.einsum("kji,kj->ki", rotations[anchors], rays)
    turned = np.einsum("kij,kj->ki", rotations[table.observers], in_world)
    baseline = centres[anchors] - centres[table.observers]
    return turned, np.einsum("kij,kj->ki", rotations[table.observers], baseline)


class Triangulation:
    """Inverse depths of the landmarks of a table, from known poses.

    Args:
        rotations: camera_from_world (n, 3, 3).
        centres: of the cameras in the world (n, 3).
        table: landmarks and observations.
        sigma: of an observation.
    """

    def __init__(
        self, rotations: Array, centres: Array, table: LandmarkTable, sigma: float
    ) -> None:
        self.table, self.sigma = table, sigma
        self.turned, self.shift = _motion(rotations, centres, table)

    def least_squares(self) -> Array:
        """Return the inverse depth of each landmark; 0, infinitely far, without parallax."""
        turned, shift, table = self.turned, self.shift, self.table
        a = shift[:, :2] - table.xy * shift[:, 2:]
        b = table.xy * turned[:, 2:] - turned[:, :2]
        count = len(table.ids)
        top = np.bincount(table.landmarks, np.sum(a * b, 1), count)
        bottom = np.bincount(table.landmarks, np.sum(a * a, 1), count)
        return np.where(bottom > 1e-12, top / np.maximum(bottom, 1e-12), 0.0)

    def costs(self, depths: Array) -> Array:
        """Return a robust cost of each landmark; infinite where a camera has it behind it."""
        table = self.table
        point = self.turned + depths[table.landmarks][:, None] * self.shift
        z = point[:, 2]
        front = z > 1e-3
        error = point[:, :2] / np.where(front, z, 1.0)[:, None] - table.xy
        each = np.log1p(np.sum(error**2, 1) / self.sigma**2)
        # Of no observation at all, bincount counts whole numbers.
        cost = np.bincount(table.landmarks, each, len(table.ids)).astype(np.float64)
        cost[table.landmarks[~front]] = np.inf
        return cost


def reanchored(
    rotations: Array, centres: Array, old: Array, xy: Array, depths: Array, new: Array
) -> Array:
    """Return inverse depths in other frames, of landmarks at xy in their old ones.

    Not positive where a landmark is behind the new camera; 0 stays 0.
    """
    rays = np.c_[xy, np.ones(len(xy))]
    in_world = np.einsum("kji,kj->ki", rotations[old], rays)
    point = in_world + depths[:, None] * (centres[old] - centres[new])  # times the inverse depth
    z = np.einsum("ki,ki->k", rotations[new][:, 2], point)
    return np.where(np.abs(z) > 1e-9, depths / np.where(z == 0, 1.0, z), -1.0)
