"""Images outside of the samples of the IMU."""

from __future__ import annotations

import numpy as np
import pytest

from bundle.errors import InputError
from bundle.inertial.tracking.track_recording import track_recording
from bundle.interface.window_options import TrackingOptions
from bundle.model.sequence.sequence import Recording
from tests.inertial.vio.sequences import calibration


@pytest.mark.parametrize("count", [1, 2])
def test_samples_that_cover_less_than_two_images_are_the_cause(count: int) -> None:
    size = 2 + 10 * (count - 1)
    recording = Recording(
        name="video.mp4",
        imu_timestamps_ns=5_000_000 * np.arange(size),
        gyro=np.zeros((size, 3)),
        accel=np.tile([0, 0, 9.81], (size, 1)),
        image_timestamps_ns=50_000_000 * np.arange(100),
        images=lambda first, last: iter(np.zeros((last - first, 48, 64), np.uint8)),
        calibration=calibration(camera_model="SIMPLE_PINHOLE", camera_params=(400.0, 32.0, 24.0)),
        notes=(),
        imu_place=str,
        image_place=str,
    )
    words = "found 1 of 100: the samples cover 0.005 s, the images 4.95 s"
    with pytest.raises(InputError, match=words if count == 1 else "texture"):
        track_recording(recording, TrackingOptions())
