"""Counts of equations and unknowns per component, which show undetermined components.

An observation gives two equations. A point seen by two images has three unknowns, an image six, a
camera one per refined parameter. Seven unknowns of a component belong to the gauge. If there are
fewer equations than other unknowns, the current positions of the images are not determined. Two
images that merely happen to have the same position are then not a panorama.
"""

from __future__ import annotations

import numpy as np

from bundle.analysis.diagnosis.diagnosis_result import WeakMode
from bundle.analysis.diagnosis.track_table import TrackTable
from bundle.analysis.diagnosis.unknowns import Unknowns
from bundle.base.records import dataclass
from bundle.base.words import named, plural, sorted_ids

_GAUGE = 7


@dataclass(frozen=True)
class _Count:
    equations: int
    unknowns: int
    points: int


class EquationCounts:
    """Counts that tell which components have fewer equations than unknowns.

    Components with frames of rigs, or with a camera of another component, are left out.
    """

    def __init__(self, unknowns: Unknowns, tracks: TrackTable) -> None:
        self._unknowns, self._pieces = unknowns, tracks.pieces
        self._short: dict[int, _Count] = {}
        problem = unknowns.problem
        if problem.num_frames or not problem.num_images:
            return
        size = int(tracks.pieces.max(initial=-1)) + 1
        counted = tracks.lengths[tracks.points] > 1
        images = tracks.images[counted]
        equations = 2 * np.bincount(tracks.pieces[images], minlength=size)
        firsts = np.flatnonzero(np.diff(tracks.points[counted], prepend=-1))
        points = np.bincount(tracks.pieces[images[firsts]], minlength=size)
        poses = unknowns.index[unknowns.of_pose]
        free = 3 * points + np.bincount(tracks.pieces[poses], minlength=size)[:size]
        for camera in np.unique(unknowns.index[unknowns.of_camera]).tolist():
            used = np.unique(tracks.pieces[unknowns.images_of_cameras([camera])])
            own = used[used >= 0]
            if len(own) == 1:
                free[own[0]] += int((unknowns.of_camera & (unknowns.index == camera)).sum())
        for piece in np.flatnonzero(equations < free - _GAUGE).tolist():
            self._short[piece] = _Count(
                int(equations[piece]), int(free[piece]) - _GAUGE, int(points[piece])
            )

    def mode(self, images: np.ndarray, dimension: int) -> WeakMode | None:
        """Return the mode of a deficiency of these images if their component has too few equations.

        Otherwise return None.
        """
        pieces = np.unique(self._pieces[images])
        if len(pieces) != 1 or int(pieces[0]) not in self._short:
            return None
        count = self._short[int(pieces[0])]
        ids = sorted_ids(
            self._unknowns.problem.image_ids, np.flatnonzero(self._pieces == pieces[0])
        )
        return WeakMode(
            kind="underdetermined",
            sentence=f"Underdetermined: {named('image', ids)} with "
            f"{plural(count.points, 'common point')} give {count.equations} equations for "
            f"{count.unknowns} unknowns beyond the gauge. Match more points, or hold intrinsics "
            "(--refine poses,points).",
            image_ids=ids,
            camera_ids=(),
            eigenvalue=0.0,
            dimension=dimension,
        )
