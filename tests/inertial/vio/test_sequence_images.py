"""The images of a sequence: rates, velocities of tracks, samples between."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from bundle.inertial.vio.sequence_images import ImuSlices, SequenceImages
from bundle.inertial.vio.sliding_window import SlidingWindow
from bundle.inertial.vio.trajectory_comparison import states_at
from bundle.synthetic.synthetic_flight import synthesize_flight
from tests.inertial.vio.sequences import START, sequence


def test_images_are_taken_at_the_rate_that_is_asked_for() -> None:
    images = SequenceImages(sequence())  # 10 Hz
    assert len(images) == 21
    assert images.after(0, 10.0) == list(range(1, 21))
    assert images.after(0, 9.0) == list(range(2, 21, 2))
    assert images.after(3, 2.0) == [8, 13, 18]
    assert images.after(20, 10.0) == []


def test_stamps_that_jitter_keep_their_rate() -> None:
    plain = sequence()
    jitter = np.random.default_rng(1).integers(0, 200_000, 21)
    jitter[-1] = 0  # the samples end with the last image
    stamps = plain.track_timestamps_ns + np.repeat(jitter, 5)
    shaky = sequence(track_timestamps_ns=stamps)
    assert SequenceImages(shaky).after(0, 10.0) == list(range(1, 21))


def test_velocities_are_those_since_the_image_before() -> None:
    drift = np.repeat(0.03 * np.arange(21), 5)[:, None] * [1.0, -2.0]
    images = SequenceImages(sequence(xy=np.zeros((105, 2)) + drift))
    np.testing.assert_allclose(images.tracks(4, velocities=True).velocity, [[0.3, -0.6]] * 5)
    np.testing.assert_array_equal(images.tracks(0, velocities=True).velocity, np.zeros((5, 2)))
    np.testing.assert_array_equal(images.tracks(4).velocity, np.zeros((5, 2)))


def test_samples_between_images() -> None:
    images = SequenceImages(sequence())
    first, second = images.intervals([0, 2, 3])
    assert first.dt.sum() == pytest.approx(0.2)
    assert len(second.gyro) == 20
    assert images.stamp(2) == START + 200_000_000


def test_a_time_offset_that_nobody_told_is_found() -> None:
    """Images are stamped 8 ms early; the window finds it from the velocities of the tracks."""
    flight = synthesize_flight(
        duration=6.0, rest=0.0, seed=5, time_offset=0.008, pixel_noise=0.1, num_tracks=40
    )
    given, truth = flight.sequence, flight.ground_truth
    images = SequenceImages(given)
    window = SlidingWindow(
        given.calibration.camera_from_imu,
        given.calibration.noise,
        given.calibration.focal,
        refine_time_offset=True,
        imu_noise_scale=1.0,
        pixel_sigma=0.1,
        time_budget=10.0,
    )
    chosen = list(range(4, 40, 3))
    early = truth.timestamps_ns[chosen] - 8_000_000  # as the camera stamped them
    slices = ImuSlices(given.imu_timestamps_ns, given.gyro, given.accel, "zero_order_hold")
    window.start(
        early,
        states_at(truth, early),
        [images.tracks(k, velocities=True) for k in chosen],
        [slices.between(int(a), int(b)) for a, b in pairwise(early)],
    )
    assert window.time_offset == pytest.approx(0.008, abs=0.001)
