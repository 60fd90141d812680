"""A recording: samples of an IMU and images of a camera, before features are tracked."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.model.sequence.calibration import Calibration
from bundle.model.sequence.sequence import Place, check_imu, check_overlap, check_stamp_units


@dataclass(frozen=True, eq=False)
class Recording:
    """Measurements of one camera and one IMU.

    Attributes:
        name: path, for messages.
        imu_timestamps_ns: (n,) int64.
        gyro: (n, 3) angular rate in the IMU's frame [rad/s].
        accel: (n, 3) specific force in the IMU's frame [m/s^2].
        image_timestamps_ns: (m,) int64 stamps of the images, on the camera's clock.
        images: function that yields the images (height, width) as uint8 in the order of the
            stamps, from the first index (inclusive) to the second (exclusive).
        calibration: calibration of both sensors, with a camera model.
        notes: sentences about sources of the calibration and conversions, for the report.
        imu_place, image_place: functions that convert a row to text for messages.
    """

    name: str
    imu_timestamps_ns: NDArray[np.int64]
    gyro: NDArray[np.float64]
    accel: NDArray[np.float64]
    image_timestamps_ns: NDArray[np.int64]
    images: Callable[[int, int], Iterator[NDArray[np.uint8]]]
    calibration: Calibration
    notes: tuple[str, ...]
    imu_place: Place
    image_place: Place

    @property
    def image_times_ns(self) -> NDArray[np.int64]:
        """(m,) stamps of the images on the IMU's clock (time offset added)."""
        return self.image_timestamps_ns + round(1e9 * self.calibration.time_offset)

    def covered(self) -> tuple[int, int]:
        """Return the range of the images between the first and the last IMU sample."""
        times: Any = self.image_times_ns
        first = int(np.searchsorted(times, self.imu_timestamps_ns[0], "left"))
        return first, int(np.searchsorted(times, self.imu_timestamps_ns[-1], "right"))


def check_recording(recording: Recording) -> None:
    """Check units, order and overlap of the stamps, and units of the samples.

    Raises:
        InputError: a check fails; one line with place, expected and found.
    """
    stamps, place = recording.image_timestamps_ns, recording.image_place
    if len(stamps) < 2:
        raise InputError(f"{place(0)}: expected at least two images, found {len(stamps)}")
    back = np.flatnonzero(np.diff(stamps) <= 0)
    if len(back):
        row = int(back[0]) + 1
        raise InputError(
            f"{place(row)}: expected an image after {stamps[row - 1]} ns, found {stamps[row]}"
        )
    check_stamp_units(
        recording.imu_timestamps_ns,
        stamps,
        recording.calibration,
        recording.imu_place,
        place,
    )
    check_imu(recording.imu_timestamps_ns, recording.gyro, recording.accel, recording.imu_place)
    check_overlap(recording.imu_timestamps_ns, recording.image_times_ns, recording.name)
