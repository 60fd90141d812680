"""A visual-inertial sequence: samples of an IMU, tracks of image features, and a calibration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arguments import check_type
from bundle.base.arrays import immutable
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.model.sequence.calibration import Calibration
from bundle.model.sequence.imu_samples import suspected_units
from bundle.model.sequence.stamp_units import check_stamp_unit

Place = Callable[[int], str]

FREE_FALL = 3.0  # m/s^2; a lower median is an error: no vehicle is in free fall for so long


@dataclass(frozen=True, eq=False, repr=False)
class Sequence(Displayed):
    """Measurements of one flight, drive or walk, with one camera and one IMU.

    Attributes:
        imu_timestamps_ns: (n,) int64, ascending.
        gyro: (n, 3) angular rate in the IMU's frame [rad/s].
        accel: (n, 3) specific force in the IMU's frame [m/s^2].
        track_timestamps_ns: (m,) int64 image stamp of each observation, on the camera's clock.
        track_ids: (m,) int64 track id of each observation.
        xy: (m, 2) pixels, or normalised image coordinates if the calibration has no camera model.
        calibration: calibration of both sensors.

    Rows of tracks are sorted by time, then id.

    Raises:
        InputError: shapes do not match, a number is not finite, stamps decrease or repeat, an image
            has a track twice, no image lies between two IMU samples, or accelerations are in g.
    """

    imu_timestamps_ns: NDArray[np.int64]
    gyro: NDArray[np.float64]
    accel: NDArray[np.float64]
    track_timestamps_ns: NDArray[np.int64]
    track_ids: NDArray[np.int64]
    xy: NDArray[np.float64]
    calibration: Calibration

    def __post_init__(self) -> None:
        check_type("calibration", self.calibration, Calibration)
        columns: dict[str, tuple[int, ...]] = {"gyro": (3,), "accel": (3,), "xy": (2,)}
        for field in fields(self)[:-1]:
            kind = np.float64 if field.name in columns else np.int64
            array = immutable(field.name, getattr(self, field.name), kind)
            leader = self.track_ids if field.name == "xy" else self.imu_timestamps_ns
            rows = len(leader) if field.name in columns else array.shape[0]
            if field.name == "track_ids":
                rows = len(self.track_timestamps_ns)
            expected = (rows, *columns.get(field.name, ()))
            if array.shape != expected:
                raise InputError(f"{field.name}: expected shape {expected}, found {array.shape}")
            object.__setattr__(self, field.name, array)
        sample: Place = lambda row: f"IMU sample {row}"  # noqa: E731
        place: Place = lambda row: f"observation {row}"  # noqa: E731
        check_imu(self.imu_timestamps_ns, self.gyro, self.accel, sample)
        check_tracks(self.track_timestamps_ns, self.track_ids, self.xy, place)
        check_overlap(self.imu_timestamps_ns, self.image_timestamps_ns, "sequence")
        check_stamp_units(
            self.imu_timestamps_ns, self.track_timestamps_ns, self.calibration, sample, place
        )

    @property
    def image_timestamps_ns(self) -> NDArray[np.int64]:
        """(m,) stamps of the observations on the IMU's clock (time offset added)."""
        offset = round(1e9 * self.calibration.time_offset)
        return self.track_timestamps_ns + offset if offset else self.track_timestamps_ns

    @property
    def duration(self) -> float:
        """Seconds from the first IMU sample to the last."""
        return 1e-9 * float(self.imu_timestamps_ns[-1] - self.imu_timestamps_ns[0])

    @property
    def num_frames(self) -> int:
        """Number of images with observations."""
        return 1 + int(np.count_nonzero(np.diff(self.track_timestamps_ns)))

    def frames(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the image stamps (f,) on the camera's clock, and ``begin`` (f + 1,).

        The observations of image i are the rows ``begin[i]`` to ``begin[i + 1]`` (exclusive).
        """
        stamps, begin = np.unique(self.track_timestamps_ns, return_index=True)
        return stamps, np.append(begin, len(self.track_timestamps_ns)).astype(np.int64)

    def normalized(self) -> NDArray[np.float64]:
        """Return the undistorted observations (m, 2) on the plane z = 1 of the camera."""
        calibration = self.calibration
        if calibration.camera_model is None:
            return self.xy
        from bundle.model.pycolmap.lens import normalized  # slow: loads pycolmap

        return normalized(calibration.camera_model, calibration.camera_params, self.xy)

    def _display(self) -> Display:
        tracks = len(np.unique(self.track_ids))
        return Display(
            title=f"Sequence of {self.duration:.2f} s",
            facts=(
                ("IMU", f"{len(self.gyro)} samples"),
                ("images", f"{self.num_frames}"),
                ("tracks", f"{tracks}, {len(self.xy)} observations"),
                ("camera", self.calibration.camera_model or "normalised coordinates"),
            ),
        )


def check_stamp_units(
    imu_stamps: Any, track_stamps: Any, calibration: Calibration, imu_place: Place, place: Place
) -> None:
    """Check that stamps are nanoseconds; ``imu_place`` and ``place`` convert a row to text.

    Raises:
        InputError: as for :func:`bundle.model.sequence.stamp_units.check_stamp_unit`.
    """
    check_stamp_unit(imu_stamps, calibration.imu_rate, "imu_rate", imu_place)
    check_stamp_unit(track_stamps, calibration.camera_rate, "camera_rate", place)


def check_imu(stamps: Any, gyro: Any, accel: Any, place: Place) -> None:
    """Check that IMU samples can be integrated; ``place`` converts a row to text.

    Raises:
        InputError: fewer than two samples, numbers that are not finite, stamps that decrease or
            repeat, accelerations in g, or rates in degrees.
    """
    if len(stamps) < 2:
        raise InputError(f"{place(0)}: expected at least two IMU samples, found {len(stamps)}")
    for name, values in (("gyro", gyro), ("accel", accel)):
        wrong = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if len(wrong):
            row = int(wrong[0])
            raise InputError(
                f"{place(row)}: {name}: expected finite numbers, found {_list(values[row])}"
            )
    _check_ascending(stamps, place)
    suspected = suspected_units(gyro, accel)
    if suspected:
        raise InputError(f"{place(0)}: {suspected}")
    norm = float(np.median(np.linalg.norm(accel, axis=1)))
    if norm < FREE_FALL:
        raise InputError(
            f"{place(0)}: accel: expected m/s^2 including gravity, with a norm of about 9.81, "
            f"found a median norm of {norm:.3g}"
        )


def check_tracks(stamps: Any, ids: Any, xy: Any, place: Place) -> None:
    """Check that observations are sorted by time and id; ``place`` converts a row to text.

    Raises:
        InputError: the list is empty, a number is not finite, the order is wrong, or an image has a
            track twice.
    """
    if not len(stamps):
        raise InputError(f"{place(0)}: expected observations, found an empty table")
    wrong = np.flatnonzero(~np.isfinite(xy).all(axis=1))
    if len(wrong):
        row = int(wrong[0])
        raise InputError(f"{place(row)}: x, y: expected finite numbers, found {_list(xy[row])}")
    step, other = np.diff(stamps), np.diff(ids)
    back = np.flatnonzero(step < 0)
    if len(back):
        row = int(back[0]) + 1
        raise InputError(
            f"{place(row)}: time goes back: expected a stamp of at least {stamps[row - 1]} ns, "
            f"found {stamps[row]}"
        )
    wrong = np.flatnonzero((step == 0) & (other <= 0))
    if len(wrong):
        row = int(wrong[0]) + 1
        if ids[row] == ids[row - 1]:
            raise InputError(
                f"{place(row)}: expected a track once per image, found track {ids[row]} twice at "
                f"{stamps[row]} ns (also in {place(row - 1)})"
            )
        raise InputError(
            f"{place(row)}: expected ids that ascend within an image, found {ids[row]} after "
            f"{ids[row - 1]}"
        )


def check_overlap(imu_stamps: Any, image_stamps: Any, where: str) -> None:
    """Check that images and IMU samples overlap in time.

    Raises:
        InputError: no image lies between two IMU samples; the message begins with ``where``.
    """
    inside = (image_stamps >= imu_stamps[0]) & (image_stamps <= imu_stamps[-1])
    if not inside.any():
        raise InputError(
            f"{where}: expected images between the IMU samples ({imu_stamps[0]} to "
            f"{imu_stamps[-1]} ns), found images from {image_stamps[0]} to {image_stamps[-1]} ns"
        )


def _check_ascending(stamps: Any, place: Place) -> None:
    wrong = np.flatnonzero(np.diff(stamps) <= 0)
    if len(wrong):
        row = int(wrong[0]) + 1
        what = "a duplicate stamp" if stamps[row] == stamps[row - 1] else "time goes back"
        raise InputError(
            f"{place(row)}: {what}: expected more than {stamps[row - 1]} ns, found {stamps[row]}"
        )


def _list(values: Any) -> str:
    return ", ".join(f"{value:g}" for value in values)
