"""Observations of the frames of a window, by landmark, and consecutive numbers of tracks.

The observations of a frame are three arrays with one row per track: ids (ascending), normalised
image coordinates, and their velocities. Stacked and sorted by track and frame they become
landmarks, each anchored in the first frame that observed it.

Tracks get numbers by time and position of their first observation, independent of their ids.

Sums run over landmarks in the order of their numbers, and rounding errors depend on this order. If
the order were that of the ids, the same tracks with other ids would give other results.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from bundle.base.arrays import refuse_row
from bundle.errors import InputError

Array = np.ndarray[Any, Any]


class FrameTracks(NamedTuple):
    """Tracks of one image: ids (n,) ascending, xy (n, 2), velocity (n, 2) per second."""

    ids: Array
    xy: Array
    velocity: Array

    def check(self, where: str) -> None:
        """Refuse wrong shapes, ids that are not ascending, and values that are not finite.

        Raises:
            InputError: the message begins with ``where``.
        """
        ids, xy, velocity = np.asarray(self.ids), np.asarray(self.xy), np.asarray(self.velocity)
        if ids.ndim != 1 or xy.shape != (len(ids), 2) or velocity.shape != xy.shape:
            raise InputError(
                f"{where}: expected ids (n,), xy and velocity (n, 2), found {ids.shape}, "
                f"{xy.shape}, {velocity.shape}"
            )
        refuse_row(
            ids[1:] <= ids[:-1],
            lambda k: f"{where}: expected ascending ids, found {ids[k + 1]} after {ids[k]}",
        )
        if not (np.isfinite(xy).all() and np.isfinite(velocity).all()):
            raise InputError(f"{where}: expected finite coordinates")

    def without(self, ids: Array) -> FrameTracks:
        """Return the remaining tracks; `ids` are ascending."""
        if not len(ids):
            return self
        at = np.minimum(np.searchsorted(ids, self.ids), len(ids) - 1)
        kept = ids[at] != self.ids
        return FrameTracks(self.ids[kept], self.xy[kept], self.velocity[kept])


class LandmarkTable(NamedTuple):
    """Landmarks (m) and their observations (k) except anchors, sorted by landmark and frame."""

    ids: Array
    anchors: Array  # frame of each landmark
    anchor_xy: Array
    anchor_velocity: Array
    landmarks: Array  # landmark of each observation
    observers: Array  # frame of each observation
    xy: Array
    velocity: Array

    @property
    def begin(self) -> Array:
        """First observation of each landmark."""
        return np.searchsorted(self.landmarks, np.arange(len(self.ids)))

    def only(self, kept: Array) -> LandmarkTable:
        """Return the flagged landmarks with their observations."""
        rows = kept[self.landmarks]
        renumbered = np.cumsum(kept) - 1
        return LandmarkTable(
            self.ids[kept],
            self.anchors[kept],
            self.anchor_xy[kept],
            self.anchor_velocity[kept],
            renumbered[self.landmarks[rows]].astype(np.int32),
            self.observers[rows],
            self.xy[rows],
            self.velocity[rows],
        )

    def parallax(self) -> Array:
        """Return the largest distance from the anchor, per landmark; 0 without observations."""
        distance = np.linalg.norm(self.xy - self.anchor_xy[self.landmarks], axis=1)
        largest = np.zeros(len(self.ids))
        np.maximum.at(largest, self.landmarks, distance)
        return largest


def landmark_table(frames: Sequence[FrameTracks]) -> LandmarkTable:
    """Return the tracks that at least two frames observe."""
    ids = np.concatenate([f.ids for f in frames]) if frames else np.empty(0, np.int64)
    at = np.repeat(np.arange(len(frames), dtype=np.int32), [len(f.ids) for f in frames])
    xy = np.concatenate([f.xy for f in frames]) if frames else np.empty((0, 2))
    velocity = np.concatenate([f.velocity for f in frames]) if frames else np.empty((0, 2))
    order = np.argsort(ids, kind="stable")  # keeps the order of frames
    ids, at, xy, velocity = ids[order], at[order], xy[order], velocity[order]
    is_first = np.empty(len(ids), bool)
    is_first[:1] = True
    np.not_equal(ids[1:], ids[:-1], out=is_first[1:])
    track = np.cumsum(is_first) - 1
    is_seen_again = np.bincount(track, minlength=1)[track] > 1 if len(ids) else is_first
    first, later = is_first & is_seen_again, ~is_first
    renumbered = np.cumsum(first) - 1  # rows of a track follow its first
    return LandmarkTable(
        ids[first],
        at[first],
        xy[first],
        velocity[first],
        renumbered[later].astype(np.int32),
        at[later],
        xy[later],
        velocity[later],
    )


def sight_numbers(image: Array, ids: Array, xy: Array) -> Array:
    """Return each observation's track number: by its first image, then x, then y."""
    _, first, track = np.unique(ids, return_index=True, return_inverse=True)
    order = np.lexsort((xy[first, 1], xy[first, 0], image[first]))
    numbers = np.empty(len(first), np.int64)
    numbers[order] = np.arange(len(first))
    found: Array = numbers[track]
    return found


class TrackNumbers:
    """Renumbering of tracks in the order of their appearance."""

    def __init__(self) -> None:
        self._number_of: dict[int, int] = {}
        self._next = 0

    def of(self, tracks: FrameTracks) -> FrameTracks:
        """Return the tracks of a frame under their numbers, ascending."""
        known = self._number_of
        for row in np.lexsort((tracks.xy[:, 1], tracks.xy[:, 0])).tolist():
            if known.setdefault(int(tracks.ids[row]), self._next) == self._next:
                self._next += 1
        numbers = np.array([known[int(track)] for track in tracks.ids], np.int64)
        order = np.argsort(numbers)
        return FrameTracks(numbers[order], tracks.xy[order], tracks.velocity[order])

    def keep(self, numbers: Array) -> None:
        """Discard all other tracks; a discarded track gets a new number if it returns."""
        kept = set(numbers.tolist())
        self._number_of = {track: n for track, n in self._number_of.items() if n in kept}
