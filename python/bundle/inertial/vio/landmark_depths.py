"""Landmarks of a window, between its solves: x, y and 1 / z in the image that anchors them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bundle.inertial.vio.landmark_table import LandmarkTable
from bundle.inertial.vio.triangulation import Triangulation, camera_poses, reanchored
from bundle.inertial.vio.window_frame import WindowFrame

__all__ = ["LandmarkDepths"]

Array = np.ndarray[Any, Any]


class LandmarkDepths:
    """By track: the frame that anchors it, by its stamp, and x, y, 1 / z there."""

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
        """Return the landmarks that all cameras have before them, with x, y, 1 / z of each.

        Each is the better of the last solve's and of a triangulation with the poses as they are: a
        landmark that had no parallax before would else be taken for an outlier when it gets some.
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
        """Keep what a solve found."""
        stamps = np.array([f.stamp for f in frames], np.int64)
        self.ids, self.stamps, self.values = table.ids, stamps[table.anchors], points

    def forget(self, ids: Array) -> None:
        """Drop tracks."""
        self._keep(~np.isin(self.ids, ids, assume_unique=True))

    def leave(
        self, frame: WindowFrame, rest: Sequence[WindowFrame], camera_from_imu: Array
    ) -> None:
        """Move landmarks that a frame anchors to the next one that sees them."""
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
