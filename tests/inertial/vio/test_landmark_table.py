"""The numbering of tracks is nothing that a result depends on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bundle.inertial.vio.initialize import initialize_vio
from bundle.inertial.vio.landmark_table import FrameTracks, TrackNumbers
from bundle.inertial.vio.odometry import run_odometry
from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.model.sequence.sequence import Sequence
from bundle.synthetic.synthetic_flight import synthesize_flight


def renumbered(sequence: Sequence, seed: int) -> tuple[Sequence, dict[int, int]]:
    ids = np.unique(sequence.track_ids)
    new = np.random.default_rng(seed).choice(10**6, len(ids), replace=False)
    found = new[np.searchsorted(ids, sequence.track_ids)]
    order = np.lexsort((found, sequence.track_timestamps_ns))
    again = replace(
        sequence,
        track_timestamps_ns=sequence.track_timestamps_ns[order],
        track_ids=found[order],
        xy=sequence.xy[order],
    )
    return again, dict(zip(ids.tolist(), new.tolist(), strict=True))


@pytest.mark.parametrize("rest", [1.5, 0.0])
def test_a_flight_ends_in_the_same_bits(rest: float) -> None:
    sequence = synthesize_flight(duration=5.0, rest=rest, num_tracks=30, seed=4).sequence
    expected = run_odometry(sequence, time_budget=100.0)
    for seed in range(2):
        found = run_odometry(renumbered(sequence, seed)[0], time_budget=100.0)
        np.testing.assert_array_equal(found.trajectory.states, expected.trajectory.states)


def test_a_start_names_tracks_as_their_sequence_does() -> None:
    sequence = synthesize_flight(duration=4.0, rest=0.0, num_tracks=30, seed=4).sequence
    again, new = renumbered(sequence, 3)
    first, second = initialize_vio(sequence), initialize_vio(again)
    assert first.kind == "moving"
    assert [new[track] for track in first.track_ids.tolist()] == second.track_ids.tolist()
    np.testing.assert_array_equal(first.points, second.points)


def test_images_keep_their_observations() -> None:
    sequence = synthesize_flight(duration=1.0, rest=0.0, num_tracks=20, seed=4).sequence
    images = SequenceImages(sequence)
    xy = sequence.normalized()
    for image in range(len(images)):
        rows = images.rows(image)
        assert (np.diff(images.ids[rows]) > 0).all()
        own = dict(zip(sequence.track_ids[rows].tolist(), xy[rows].tolist(), strict=True))
        found = dict(zip(images.track_ids[rows].tolist(), images.xy[rows].tolist(), strict=True))
        assert own == found


def seen(*tracks: tuple[int, float]) -> FrameTracks:
    ids = np.array([track for track, _ in tracks])
    xy = np.array([[x, 0.0] for _, x in tracks])
    return FrameTracks(ids, xy, 2 * xy)


def test_tracks_are_numbered_as_they_appear() -> None:
    numbers = TrackNumbers()
    first = numbers.of(seen((3, 0.5), (7, 0.1)))
    assert first.ids.tolist() == [0, 1]
    assert first.xy[:, 0].tolist() == [0.1, 0.5]
    assert first.velocity[:, 0].tolist() == [0.2, 1.0]
    second = numbers.of(seen((1, 0.9), (2, 0.2), (3, 0.6)))
    assert second.ids.tolist() == [1, 2, 3]
    assert second.xy[:, 0].tolist() == [0.6, 0.2, 0.9]
    numbers.keep(np.array([1, 2]))
    third = numbers.of(seen((1, 0.0), (2, 0.3), (3, 0.7)))
    assert third.ids.tolist() == [1, 2, 4]  # a track that was forgotten begins anew
