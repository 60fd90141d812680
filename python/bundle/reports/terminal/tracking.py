"""Facts about tracked images: sensors, tracks, checks, time offset, agreement with the IMU."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from bundle.base.words import number, plural
from bundle.model.sequence.sequence import Sequence
from bundle.reports.sections import Section

if TYPE_CHECKING:
    from bundle.inertial.tracking.track_recording import Tracking


def tracking_headline(tracking: Tracking) -> str:
    """Return the number of tracks, their length, and the share that the checks ended."""
    lost = 100 * sum(tracking.share_lost.values())
    return (
        f"{plural(tracking.num_tracks, 'track', grouped=True)} of "
        f"{number(tracking.mean_track_length)} images on average, "
        f"{tracking.tracks_per_image:.0f} per image, tracked in {number(tracking.time)} s; checks "
        f"ended {lost:.1f} % per image. "
        f"{_offset(tracking)}"
    )


def tracking_section(sequence: Sequence, tracking: Tracking) -> Section:
    """Return facts: units, axes, time offset, tracks and checks."""
    calibration, check = sequence.calibration, tracking.check
    outside = (
        f", {tracking.num_outside} others outside the IMU samples" if tracking.num_outside else ""
    )
    lost = ", ".join(f"{100 * share:.1f} % {name}" for name, share in tracking.share_lost.items())
    agreement = "not compared: the camera hardly turns"
    if check.num_pairs:
        agreement = (
            f"rotations of tracks and gyroscope differ by {100 * check.unexplained:.1f} % (median "
            f"of {check.num_pairs} image pairs)"
        )
        if math.isfinite(check.angle_sigma):
            agreement += f"; camera_from_imu is within {number(check.angle)} degrees"
    noise = calibration.noise
    return Section(
        facts=[
            ("camera", f"{calibration.camera_model}, {calibration.camera_rate:g} Hz, pixels from "
                       "the centre of the first one"),
            ("IMU", f"{calibration.imu_rate:g} Hz, rad/s and m/s^2; noise densities "
                    f"{noise.gyro_noise_density:g} rad/s/sqrt(Hz), "
                    f"{noise.accel_noise_density:g} m/s^2/sqrt(Hz)"),
            ("axes", agreement),
            ("time", _offset(tracking)),
            ("tracks", f"{plural(tracking.num_tracks, 'track')} in {tracking.num_images} images"
                       f"{outside}"),
            ("ended", f"per image: {lost}"),
            ("predicted", f"motion of {100 * tracking.share_predicted:.0f} % of the images, by the "
                          "gyroscope"),
        ],
        notes=tracking.notes,
        is_detail=True,
    )  # fmt: skip


def _offset(tracking: Tracking) -> str:
    used = f"{1e3 * tracking.time_offset:.4g} ms were added to the stamps of images"
    check = tracking.check
    if not math.isfinite(check.time_sigma):
        return f"{used}."
    implied = 1e3 * (tracking.time_offset + check.time_shift)
    return f"{used}; the tracks imply {implied:.1f} ms (sigma {1e3 * check.time_sigma:.1f})."
