"""Visual-inertial sequences and recordings: samples of an IMU, images or tracks, a calibration."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from decimal import Decimal
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.arrays import Array, as_declared, check_arrays, check_type, declare, refuse_row
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.model.sequence.calibration import Calibration

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

    _ARRAYS = declare(
        imu_timestamps_ns=Array(("n",), dtype=np.int64),
        gyro=Array(("n", 3)),
        accel=Array(("n", 3)),
        track_timestamps_ns=Array(("m",), dtype=np.int64),
        track_ids=Array(("m",), dtype=np.int64),
        xy=Array(("m", 2)),
    )

    def __post_init__(self) -> None:
        check_type("calibration", self.calibration, Calibration)
        check_arrays(self, self._ARRAYS)
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
        from bundle.model.lenses.exact_image import normalized  # slow: loads pycolmap

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
    """Check that stamps are nanoseconds; ``imu_place`` and ``place`` convert a row to text."""
    check_stamp_unit(imu_stamps, calibration.imu_rate, "imu_rate", imu_place)
    check_stamp_unit(track_stamps, calibration.camera_rate, "camera_rate", place)


def check_imu(stamps: Any, gyro: Any, accel: Any, place: Place) -> None:
    """Check that IMU samples can be integrated; ``place`` converts a row to text."""
    if len(stamps) < 2:
        raise InputError(f"{place(0)}: expected at least two IMU samples, found {len(stamps)}")
    for name, values in (("gyro", gyro), ("accel", accel)):
        _check_finite(values, place, f": {name}")
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
    """Check that observations are sorted by time and id; ``place`` converts a row to text."""
    if not len(stamps):
        raise InputError(f"{place(0)}: expected observations, found an empty table")
    _check_finite(xy, place, ": x, y")
    step, other = np.diff(stamps), np.diff(ids)
    refuse_row(
        step < 0,
        lambda k: (
            f"{place(k + 1)}: time goes back: expected a stamp of at least {stamps[k]} ns, "
            f"found {stamps[k + 1]}"
        ),
    )
    refuse_row(
        (step == 0) & (other <= 0),
        lambda k: (
            f"{place(k + 1)}: expected a track once per image, found track {ids[k]} twice at "
            f"{stamps[k]} ns (also in {place(k)})"
            if ids[k] == ids[k + 1]
            else f"{place(k + 1)}: expected ids that ascend within an image, found {ids[k + 1]} "
            f"after {ids[k]}"
        ),
    )


def check_overlap(imu_stamps: Any, image_stamps: Any, where: str) -> None:
    """Check that images and IMU samples overlap in time."""
    inside = (image_stamps >= imu_stamps[0]) & (image_stamps <= imu_stamps[-1])
    if not inside.any():
        raise InputError(
            f"{where}: expected images between the IMU samples ({imu_stamps[0]} to "
            f"{imu_stamps[-1]} ns), found images from {image_stamps[0]} to {image_stamps[-1]} ns"
        )


def _check_finite(values: Any, place: Place, what: str) -> None:
    refuse_row(
        ~np.isfinite(values).all(axis=1),
        lambda row: (
            f"{place(row)}{what}: expected finite numbers, found "
            f"{', '.join(f'{value:g}' for value in values[row])}"
        ),
    )


def _check_ascending(stamps: Any, place: Place) -> None:
    refuse_row(
        np.diff(stamps) <= 0,
        lambda k: (
            f"{place(k + 1)}: "
            f"{'a duplicate stamp' if stamps[k + 1] == stamps[k] else 'time goes back'}: "
            f"expected more than {stamps[k]} ns, found {stamps[k + 1]}"
        ),
    )


STANDARD_GRAVITY = 9.80665  # m/s^2
# The average over a second is about |g| for a device that is not in free fall.
LEAST_MEAN, MOST_MEAN = 0.7, 1.3
DEGREES_SUSPECTED = 2 * np.pi * 5  # rad/s, limit of the median: five turns per second


def check_imu_samples(
    gyro: ArrayLike,
    accel: ArrayLike,
    *,
    gyro_range: float | None = None,
    accel_range: float | None = None,
) -> None:
    """Raise an error for samples with wrong units, saturated or invalid values.

    Args:
        gyro: (n, 3) angular rates in rad/s.
        accel: (n, 3) specific forces in m/s^2.
        gyro_range: largest rate that the gyroscope measures, in rad/s; None: unknown.
        accel_range: largest acceleration that the accelerometer measures, in m/s^2; None: unknown.

    Raises:
        InputError: an array has another shape, a number is not finite, or a sample is saturated (at
            the end of the sensor's range). Also if accelerations seem to be in g instead of m/s^2,
            or rates in degrees.
    """
    sizes: dict[Any, int] = {}
    samples = {
        name: as_declared(name, given, Array(("n", 3), "finite"), sizes)
        for name, given in (("gyro", gyro), ("accel", accel))
    }
    for name, limit, unit in (("gyro", gyro_range, "rad/s"), ("accel", accel_range, "m/s^2")):
        if limit is None:
            continue
        found = np.abs(samples[name]).ravel()
        clipped = found >= 0.999 * limit
        refuse_row(
            clipped,
            lambda k, name=name, limit=limit, unit=unit, clipped=clipped: (  # type: ignore[misc]
                f"{name}[{k // 3}, {k % 3}]: expected values below the sensor's limit of "
                f"{limit:g} {unit}, found {samples[name].flat[k]:g}: {clipped.sum()} saturated "
                "values"
            ),
        )
    suspected = suspected_units(samples["gyro"], samples["accel"])
    if suspected:
        raise InputError(suspected)


def suspected_units(gyro: NDArray[np.float64], accel: NDArray[np.float64]) -> str:
    """Return a sentence if samples (n, 3) seem to be in g or degrees, otherwise ""."""
    if not len(gyro):
        return ""
    mean = float(np.linalg.norm(accel, axis=1).mean())
    if LEAST_MEAN < mean < MOST_MEAN:
        return (
            f"accel: expected m/s^2, found a mean of {mean:.3g}: probably g "
            f"(1 g = {STANDARD_GRAVITY} m/s^2)"
        )
    median = float(np.median(np.linalg.norm(gyro, axis=1)))
    if median > DEGREES_SUSPECTED:
        return f"gyro: expected rad/s, found a median rate of {median:.3g}: probably degrees"
    return ""


@dataclass(frozen=True, eq=False)
class Recording:
    """Measurements of one camera and one IMU."""

    name: str  # path, for messages
    imu_timestamps_ns: NDArray[np.int64]  # (n,) int64
    gyro: NDArray[np.float64]  # (n, 3) angular rate in the IMU's frame [rad/s]
    accel: NDArray[np.float64]  # (n, 3) specific force in the IMU's frame [m/s^2]
    image_timestamps_ns: NDArray[np.int64]  # (m,) int64 stamps of the images, on the camera's clock
    # function that yields the images (height, width) as uint8 in the order of the stamps, from the
    # first index (inclusive) to the second (exclusive)
    images: Callable[[int, int], Iterator[NDArray[np.uint8]]]
    calibration: Calibration  # calibration of both sensors, with a camera model
    # sentences about sources of the calibration and conversions, for the report
    notes: tuple[str, ...]
    # imu_place, image_place: functions that convert a row to text for messages
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
    """Check units, order and overlap of the stamps, and units of the samples."""
    stamps, place = recording.image_timestamps_ns, recording.image_place
    if len(stamps) < 2:
        raise InputError(f"{place(0)}: expected at least two images, found {len(stamps)}")
    refuse_row(
        np.diff(stamps) <= 0,
        lambda k: f"{place(k + 1)}: expected an image after {stamps[k]} ns, found {stamps[k + 1]}",
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


# Detection of the unit of time stamps from the calibrated rates and the range of 64 bits.
#
# All stamps must be nanoseconds. A sensor with rate f then has a stamp every 1e9 / f. If stamps are
# a thousand or a million times closer, they are microseconds or milliseconds. Deviations from the
# rate by less than half a unit, a factor of 316, are not evidence of another unit.

_UNITS = {3: "microseconds", 6: "milliseconds", 9: "seconds"}
"""Units by the power of ten that converts them to nanoseconds."""

LATEST = 2**63 / 1e9  # s
_EARLIEST_NOW, _LATEST_NOW = 1e8, 5e9  # s since 1970 of plausible clocks


def check_stamp_unit(
    stamps: NDArray[np.int64], rate: float, name: str, place: Callable[[int], str]
) -> None:
    """Raise an error for stamps that are not nanoseconds.

    ``stamps``: (n,) stamps, not necessarily sorted; repeated stamps count once. ``rate``: rate of
    the sensor [Hz].
    """
    times = np.unique(stamps)
    if len(times) < 2:
        return
    period = float(np.median(np.diff(times)))
    power = math.log10(1e9 / (rate * period))
    if power > 2.5:
        unit = _UNITS[min(max(3 * round(power / 3), 3), 9)]
        raise InputError(
            f"{place(0)}: expected stamps in nanoseconds, {1e9 / rate:.3g} apart for the {name} of "
            f"{rate:g} Hz, found {period:.3g} apart; are they in {unit}?"
        )


def stamp_of_seconds(word: str, place: str) -> int:
    """Convert a stamp in seconds to nanoseconds without rounding."""
    seconds = Decimal(word)
    if seconds.is_finite() and abs(seconds) <= LATEST:
        stamp = int(seconds.scaleb(9))
        if abs(stamp) < 2**63:
            return stamp
    hint = ""
    if seconds.is_finite():
        for power, unit in ((3, "milliseconds"), (6, "microseconds"), (9, "nanoseconds")):
            if _EARLIEST_NOW < abs(seconds).scaleb(-power) < _LATEST_NOW:
                hint = f": {unit}?"
    raise InputError(f"{place}: timestamp: expected seconds, found {brief(word)[1:-1]}{hint}")


def other_unit(stamps: NDArray[np.int64], others: NDArray[np.int64]) -> str:
    """Return a hint if stamps, times a power of 1000, fall into the range of others; else ""."""
    first, last = float(others.min()), float(others.max())
    for power in (-9, -6, -3, 3, 6, 9):
        scaled = stamps * 10.0**power
        if ((scaled >= first) & (scaled <= last)).sum() > 1:
            return f": stamps in another unit? Multiplied by {10.0**power:g}, they would fit"
    return ""
