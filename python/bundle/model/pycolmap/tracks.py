"""COLMAP's triangulator on a problem: tracks that matches of keypoints complete, merge and add.

A track is a set of keypoints, at most a few of them wrong, that see one point. Matches say which
keypoints of two images may belong to one track. With the poses and lenses of the problem, the
triangulator

- continues tracks by matched keypoints and creates points from keypoints without a point, where
  the rays agree (``triangulate_image``, for each image, once);
- completes tracks by keypoints that are matched over several images (``complete_all_tracks``);
- merges points whose keypoints match, where one point fits both tracks (``merge_all_tracks``);
- tries pairs of images of which few matches have a point again, with a wider limit
  (``retriangulate``, once for each pair).

It never splits a track: a wrong observation leaves it through the filter after the next solve.

The reconstruction has exactly the keypoints of the database, and the ids of the problem. It is made
once and changed in place: the triangulator counts its trials.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pycolmap
from numpy.typing import NDArray

from bundle.errors import InputError, shown
from bundle.model.problem import Problem
from bundle.model.pycolmap.adjustment_objects import set_values
from bundle.model.pycolmap.problem_source import is_colmap, source_records
from bundle.model.pycolmap.reconstruction import (
    Observations,
    ids_of_points,
    pixels_of,
    positions_of,
)

FARTHEST_KEYPOINT = 0.05
"""Distance in pixels up to which an observation is a keypoint: formats round differently."""

Pair = tuple[int, int, NDArray[np.uint32]]


class Extension(NamedTuple):
    """Numbers of observations that a step of the triangulator changed."""

    triangulated: int  # observations that continued a track or made a new point
    completed: int  # observations that joined a track over several matches
    merged: int  # observations of points that became one


class TrackBuilder:
    """COLMAP's triangulator on the images of a problem.

    Args:
        problem: the problem; its observations are keypoints (:func:`on_keypoints`).
        keypoints: for each image, (n, 2) pixels.
        pairs: for each matched pair, two rows of images and (m, 2) indices of their keypoints.
        max_error: largest error of the filter in pixels, which the triangulator keeps, too.
        min_angle: smallest angle of the filter in degrees; 0: that of the triangulator.
    """

    def __init__(
        self,
        problem: Problem,
        keypoints: Sequence[NDArray[np.float64]],
        pairs: Sequence[Pair],
        max_error: float,
        min_angle: float,
    ) -> None:
        self._problem = problem
        self._reconstruction = made = _with_keypoints(problem, keypoints)
        ids = problem.image_ids.tolist()
        graph = pycolmap.CorrespondenceGraph()
        for image_id, image in made.images.items():
            graph.add_image(image_id, image.num_points2D())
        for first, second, matches in pairs:
            geometry = pycolmap.TwoViewGeometry()
            geometry.inlier_matches = matches
            graph.add_two_view_geometry(ids[first], ids[second], geometry)
        graph.finalize()
        self._manager = pycolmap.ObservationManager(made, graph)
        self._triangulator = pycolmap.IncrementalTriangulator(graph, made, self._manager)
        self._options = pycolmap.IncrementalTriangulatorOptions(
            random_seed=0,
            complete_max_reproj_error=max_error,
            merge_max_reproj_error=max_error,
            # A mapper skips images whose lenses diverged. These lenses are those of a solve.
            min_focal_length_ratio=0.0,
            max_focal_length_ratio=np.inf,
            max_extra_param=np.inf,
        )
        if min_angle > 0:
            self._options.min_angle = min_angle
        self._is_first = True

    def extend(self) -> tuple[Problem, Extension]:
        """Extend all tracks; return the problem with them, and what changed."""
        triangulator, options = self._triangulator, self._options
        ids = self._problem.image_ids.tolist() if self._is_first else []
        self._is_first = False
        triangulated = sum(triangulator.triangulate_image(options, key) for key in ids)
        completed = triangulator.complete_all_tracks(options)
        merged = triangulator.merge_all_tracks(options)
        triangulated += triangulator.retriangulate(options)
        return self._read(), Extension(triangulated, completed, merged)

    def take(self, problem: Problem, kept: NDArray[np.bool_]) -> None:
        """Take values and remaining observations of the last problem after a solve.

        ``problem``: the last problem of :meth:`extend` with other values. ``kept``: mask of its
        observations that remain; at least two of each remaining point.
        """
        every = np.ones(problem.num_images, bool), np.ones(problem.num_points, bool)
        set_values(self._reconstruction, problem, images=every[0], points=every[1])
        gone = np.flatnonzero(~kept)
        images = problem.image_ids[problem.observation_image[gone]].tolist()
        for image_id, keypoint in zip(images, _keypoints_of(problem)[gone].tolist(), strict=True):
            # The second last observation of a point deletes it, with the last one.
            if self._reconstruction.image(image_id).point2D(keypoint).has_point3D():
                self._manager.delete_observation(image_id, keypoint)
        self._problem = problem

    def colored(self, problem: Problem) -> Problem:
        """Return a problem with the colours of points that were merged.

        New points are black, as after COLMAP's triangulator.
        """
        return problem.replace(source=pycolmap.Reconstruction(self._reconstruction))

    def _read(self) -> Problem:
        """Return the problem with the points and observations of the reconstruction."""
        made = self._reconstruction
        ids = sorted(made.point3D_ids())
        point_ids = ids_of_points(ids)
        found = Observations.of([made.image(key) for key in self._problem.image_ids.tolist()])
        return self._problem.replace(
            points=positions_of([made.point3D(key) for key in ids]),
            point_ids=point_ids,
            **found.fields(point_ids),
        )


def on_keypoints(problem: Problem, keypoints: Sequence[NDArray[np.float64]], place: str) -> Problem:
    """Return the problem with the index of each observation among the keypoints of its image.

    A COLMAP model with these keypoints in this order stays as it is. Other models get them.

    ``keypoints``: for each image, (n, 2) pixels.
    """
    indices = np.empty(problem.num_observations, np.int32)
    are_same = _num_keypoints(problem) == [len(xy) for xy in keypoints]
    order = np.argsort(problem.observation_image, kind="stable")
    ends = np.cumsum(np.bincount(problem.observation_image, minlength=problem.num_images))
    for row, rows in enumerate(np.split(order, ends[:-1])):
        xy, known = problem.observation_xy[rows], keypoints[row]
        found = _keypoints_of(problem)[rows]
        if not are_same or not _are_there(xy, known, found):
            are_same, found = False, _nearest(xy, known)
        if not _are_there(xy, known, found):
            name = shown(problem.image_names[row])
            far = int((~_near(xy, known, found)).sum())
            raise InputError(
                f"{place}: expected a keypoint of image {name} within {FARTHEST_KEYPOINT:g} px of "
                f"each of its {len(rows)} observations, found {far} without one"
            )
        indices[rows] = found
    if are_same:
        return problem
    placed = problem.replace(observation_keypoint=indices)
    return placed.replace(source=_with_keypoints(placed, keypoints))


def _num_keypoints(problem: Problem) -> list[int]:
    """Return the number of keypoints of each image of a COLMAP model; [] for other sources."""
    source = vars(problem)["source"]
    if not is_colmap(source):
        return []
    records = source_records(source)
    assert records is not None  # as of all models of COLMAP
    counts = dict(zip(records.image_ids.tolist(), records.num_keypoints.tolist(), strict=True))
    return [counts.get(key, -1) for key in problem.image_ids.tolist()]


def _keypoints_of(problem: Problem) -> NDArray[np.int32]:
    found = problem.observation_keypoint
    return np.full(problem.num_observations, -1, np.int32) if found is None else found


def _near(xy: Any, known: Any, found: NDArray[np.int32]) -> NDArray[np.bool_]:
    inside = (found >= 0) & (found < len(known))
    there = np.vstack([known, [[np.inf, np.inf]]])[np.where(inside, found, -1)]
    near: NDArray[np.bool_] = np.abs(there - xy).max(axis=1, initial=0) <= FARTHEST_KEYPOINT
    return near


def _are_there(xy: Any, known: Any, found: NDArray[np.int32]) -> bool:
    return bool(_near(xy, known, found).all()) and len(np.unique(found)) == len(found)


def _nearest(xy: NDArray[np.float64], known: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return a keypoint near each observation, each keypoint once; -1 if there is none.

    Keypoints at one place (of several orientations) are taken in turn.
    """
    cells: dict[tuple[int, int], list[int]] = {}
    for index, cell in enumerate(map(tuple, np.floor(known / FARTHEST_KEYPOINT).astype(int))):
        cells.setdefault(cell, []).append(index)
    found = np.full(len(xy), -1, np.int32)
    taken: set[int] = set()
    for row, (x, y) in enumerate(np.floor(xy / FARTHEST_KEYPOINT).astype(int).tolist()):
        near = [
            index
            for cell in ((x + i, y + j) for i in (-1, 0, 1) for j in (-1, 0, 1))
            for index in cells.get(cell, ())
            if index not in taken
        ]
        if near:
            found[row] = min(near, key=lambda index: float(np.abs(known[index] - xy[row]).max()))
            taken.add(int(found[row]))
    return found


def _with_keypoints(
    problem: Problem, keypoints: Sequence[NDArray[np.float64]]
) -> pycolmap.Reconstruction:
    """Return the problem as a reconstruction that has these keypoints.

    Images without a pose keep the keypoints of the source.
    """
    # Without observations, whose keypoints the source may lack; the points have colours.
    bare = problem.select(observations=np.zeros(problem.num_observations, bool)).problem
    made = bare.to_pycolmap()
    ids = problem.image_ids.tolist()
    pixels = dict(zip(ids, keypoints, strict=True))
    for image_id in set(made.images) - set(ids):
        pixels[image_id] = pixels_of(made.image(image_id).points2D)
    # Copies: a view of a deleted point would show freed memory.
    colors = {key: point.color.copy() for key, point in made.points3D.items()}
    made.delete_all_points2D_and_points3D()
    for image_id, xy in pixels.items():
        image = made.image(image_id)
        image.points2D = pycolmap.Image("", xy, image.camera_id, image_id).points2D
    point_ids = problem.point_ids.tolist()
    for key, xyz in zip(point_ids, problem.points, strict=True):
        made.add_point3D_with_id(key, pycolmap.Point3D(xyz=xyz, color=colors[key]))
    images = problem.observation_image.tolist()
    seen = problem.observation_point.tolist()
    numbers = _keypoints_of(problem).tolist()
    for image, point, keypoint in zip(images, seen, numbers, strict=True):
        made.add_observation(point_ids[point], pycolmap.TrackElement(ids[image], keypoint))
    return made
