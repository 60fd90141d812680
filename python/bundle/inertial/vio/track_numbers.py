"""Numbers of tracks that do not depend on their ids: by where and when they were first seen.

Sums run over landmarks in the order of their numbers, and rounding follows that order: by ids, the
same tracks under other ids would end elsewhere.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bundle.inertial.vio.landmark_table import FrameTracks

__all__ = ["TrackNumbers", "sight_numbers"]

Array = np.ndarray[Any, Any]


def sight_numbers(image: Array, ids: Array, xy: Array) -> Array:
    """Return the number of each observation's track, from 0: by its first image, then x, then y.

    Observations are sorted by image.
    """
    _, first, track = np.unique(ids, return_index=True, return_inverse=True)
    order = np.lexsort((xy[first, 1], xy[first, 0], image[first]))
    numbers = np.empty(len(first), np.int64)
    numbers[order] = np.arange(len(first))
    found: Array = numbers[track]
    return found


class TrackNumbers:
    """Tracks of one frame after another, renumbered as they appear."""

    def __init__(self) -> None:
        self._number_of: dict[int, int] = {}
        self._next = 0

    def of(self, tracks: FrameTracks) -> FrameTracks:
        """Return a frame's tracks under their numbers, ascending."""
        known = self._number_of
        for row in np.lexsort((tracks.xy[:, 1], tracks.xy[:, 0])).tolist():
            if known.setdefault(int(tracks.ids[row]), self._next) == self._next:
                self._next += 1
        numbers = np.array([known[int(track)] for track in tracks.ids], np.int64)
        order = np.argsort(numbers)
        return FrameTracks(numbers[order], tracks.xy[order], tracks.velocity[order])

    def keep(self, numbers: Array) -> None:
        """Forget all others: a track that comes back begins anew."""
        kept = set(numbers.tolist())
        self._number_of = {track: n for track, n in self._number_of.items() if n in kept}
