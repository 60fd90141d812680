"""Landmarks between solves: triangulated, kept, moved to another anchor, against true geometry."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bundle.inertial.vio.landmark_depths import (
    LandmarkDepths,
    Triangulation,
    camera_poses,
    reanchored,
)
from bundle.inertial.vio.landmark_table import FrameTracks, landmark_table
from bundle.inertial.vio.window_frame import WindowFrame
from tests.inertial.vio.window_scenes import CAMERA, FOCAL, Flight, seen_from

SIGMA = 1.0 / FOCAL


@pytest.fixture(scope="module")
def flight() -> Flight:
    return Flight(5, 21, landmarks=40)


def frames_of(flight: Flight) -> list[WindowFrame]:
    return [
        WindowFrame(int(stamp), state, seen)
        for stamp, state, seen in zip(flight.stamps, flight.states, flight.tracks(), strict=True)
    ]


def truth(flight: Flight, ids: Any, anchors: Any) -> Any:
    """x, y, 1 / z of landmarks in their anchors."""
    seen = np.array(
        [
            seen_from(flight.states[anchor], CAMERA, flight.points[[landmark]])[0]
            for landmark, anchor in zip(ids, anchors, strict=True)
        ]
    )
    return np.c_[seen[:, :2] / seen[:, 2:], 1 / seen[:, 2]]


def test_new_landmarks_are_triangulated(flight: Flight) -> None:
    frames = frames_of(flight)
    table, points = LandmarkDepths().of(
        landmark_table([f.tracks for f in frames]), frames, CAMERA, SIGMA
    )
    assert len(table.ids) > 20
    np.testing.assert_allclose(points, truth(flight, table.ids, table.anchors), atol=1e-9)


def test_the_better_of_memory_and_triangulation_counts(flight: Flight) -> None:
    """A remembered depth wins where the poses are wrong by less than it tells, and the reverse."""
    frames = frames_of(flight)
    table = landmark_table([f.tracks for f in frames])
    right = truth(flight, table.ids, table.anchors)
    wrong = right * [1, 1, 3]
    depths = LandmarkDepths()
    depths.put(table, frames, wrong)
    np.testing.assert_allclose(depths.of(table, frames, CAMERA, SIGMA)[1], right, atol=1e-9)
    # One observation of each is far off: least squares follows it, the memory does not.
    off = table.xy.copy()
    off[table.begin] += 40 * SIGMA
    noisy = table._replace(xy=off)
    depths.put(table, frames, right)
    kept, points = depths.of(noisy, frames, CAMERA, SIGMA)
    remembered = np.abs(points - truth(flight, kept.ids, kept.anchors)).max(axis=1) < 1e-12
    assert remembered.mean() > 0.7


def test_landmarks_move_to_the_next_frame_that_sees_them(flight: Flight) -> None:
    frames = frames_of(flight)
    table = landmark_table([f.tracks for f in frames])
    depths = LandmarkDepths()
    depths.put(table, frames, truth(flight, table.ids, table.anchors))
    depths.leave(frames[0], frames[1:], CAMERA)
    stamps = [f.stamp for f in frames]
    anchors = [stamps.index(int(stamp)) for stamp in depths.stamps]
    assert min(anchors) == 1
    np.testing.assert_allclose(depths.values, truth(flight, depths.ids, anchors), atol=1e-9)
    for landmark, anchor in zip(depths.ids, anchors, strict=True):
        assert landmark in frames[anchor].tracks.ids


def test_a_landmark_at_infinity_stays_there(flight: Flight) -> None:
    rotations, centres = camera_poses(flight.states, CAMERA)
    first, last = np.array([0]), np.array([4])
    depth = reanchored(rotations, centres, first, np.zeros((1, 2)), np.zeros(1), last)
    np.testing.assert_allclose(depth, 0)


def test_costs_are_infinite_behind_a_camera(flight: Flight) -> None:
    table = landmark_table(flight.tracks())
    rotations, centres = camera_poses(flight.states, CAMERA)
    triangulation = Triangulation(rotations, centres, table, SIGMA)
    right = triangulation.least_squares()
    assert triangulation.costs(right).max() < 1e-12
    assert np.isinf(triangulation.costs(np.full(len(right), 50.0))).any()
    nothing = landmark_table([FrameTracks(*(part[:0] for part in s)) for s in flight.tracks()])
    assert Triangulation(rotations, centres, nothing, SIGMA).costs(np.zeros(0)).shape == (0,)
