"""Rest at the begin: one rule for the figures of a sequence and for a start at rest."""

import numpy as np
import pytest

from bundle.inertial.vio.initialize import find_static_start, rest_at_start
from bundle.inertial.vio.odometry import sequence_statistics
from bundle.inertial.vio.sequence_images import SequenceImages
from tests.inertial.vio.sequences import START, calibration, sequence


def rest(**changes):
    return rest_at_start(SequenceImages(sequence(**changes)))


def test_rest_ends_where_tracks_move():
    assert rest() == (20, 401)
    xy = np.array(sequence().xy)
    xy[55:] += 0.02  # 8 pixels, from image 11 at 1.1 s on
    assert rest(xy=xy) == (10, 201)  # up to image 10, at 1.0 s
    assert sequence_statistics(sequence(xy=xy)).static_start == pytest.approx(1.0)
    found = find_static_start(SequenceImages(sequence(xy=xy)))
    assert (found.first_image, found.last_image) == (0, 8)
    xy[5:] += 0.02
    assert rest(xy=xy) == (0, 0)
    assert sequence_statistics(sequence(xy=xy)).static_start == 0
    assert find_static_start(SequenceImages(sequence(xy=xy))) is None


def test_rest_ends_where_the_rate_changes():
    gyro = np.array(sequence().gyro)
    gyro[300:] += 0.1
    assert rest(gyro=gyro) == (14, 300)  # the last image before 1.5 s
    assert find_static_start(SequenceImages(sequence(gyro=gyro))).last_image == 11
    gyro[:] = 0
    gyro[60:] += 0.1
    assert rest(gyro=gyro)[1] == 100  # in whole means of half a second


def test_displacements_count_in_sigmas_of_the_tracks():
    xy = np.array(sequence().xy)
    xy[55:] += 0.005  # 2 pixels in both, 2.8 together
    assert rest(xy=xy) == (20, 401)
    sharp = calibration(pixel_sigma=0.5)
    assert rest(xy=xy, calibration=sharp) == (10, 201)


def test_too_few_tracks_and_images_without_samples_end_it():
    ids = np.array(sequence().track_ids)
    ids[50:] += 100  # other tracks from image 10 on: none of image 10 is seen again
    assert rest(track_ids=ids)[0] == 9
    late = np.arange(START + 10**9, START + 3 * 10**9 + 1, 5_000_000)
    last, samples = rest(imu_timestamps_ns=late)  # images 10 to 20 alone are covered
    assert (last, samples) == (20, 201)
    short = {"imu_timestamps_ns": late[:201] - 10**9, "gyro": sequence().gyro[:201]}
    assert rest(**short, accel=sequence().accel[:201]) == (10, 201)
