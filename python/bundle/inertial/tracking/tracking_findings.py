"""Findings of a comparison of tracks and gyroscope: units, axes, time offset."""

from __future__ import annotations

import math

from bundle.inertial.tracking.rotation_check import RotationCheck
from bundle.interface.finding import Finding
from bundle.model.sequence.sequence import Recording

SIGMAS = 4.0
LEAST_SHIFT = 3e-3  # s
LEAST_ANGLE = 2.0  # degrees
REFUSED_ANGLE = 15.0  # degrees


def tracking_findings(recording: Recording, check: RotationCheck) -> tuple[Finding, ...]:
    """Return the findings; those with ``is_problem`` spoil an odometry."""
    evidence = {
        "num_pairs": check.num_pairs,
        "unexplained": check.unexplained,
        "cause_unexplained": check.cause_unexplained,
        "ratio": check.ratio,
        "time_shift": check.time_shift,
        "angle": check.angle,
    }
    share = f"{100 * check.unexplained:.0f} %"
    explained = f"{100 * check.cause_unexplained:.0f} %" if check.cause else ""
    table, pairs = recording.imu_place(len(recording.gyro)), f"{check.num_pairs} image pairs"
    if check.cause:
        sentence = {
            "degrees": f"{table}: gyro: expected rad/s, found rotations {check.ratio:.1f} times "
            f"as large as those of the tracks (median of {pairs}); as degrees/s they agree up to "
            f"{explained}",
            "inverse": f"{recording.name}: camera_from_imu: expected the rotation that the tracks "
            f"show in {pairs}, found its inverse: {share} of the motion disagrees as given, "
            f"{explained} with the inverse",
            "axes": f"{table}: axes: expected gyroscope axes that agree with the tracks in "
            f"{pairs}, found that {share} of the rotation disagrees; with axes {check.axes} "
            f"in place of +x +y +z {explained} does: swapped or reversed axes, or a wrong "
            "camera_from_imu",
            "turned": f"{recording.name}: camera_from_imu: expected the rotation that the tracks "
            f"show in {pairs}, found that {share} of the motion disagrees; with another rotation "
            f"{explained} does",
            "unknown": f"{recording.name}: expected rotations of the gyroscope that agree with the "
            f"tracks, found that {share} disagrees in {pairs}: wrong stamps, axes or calibration",
        }[check.cause]
        kind = {"degrees": "gyro units", "unknown": "rotation"}.get(check.cause, "axes")
        # Rays of one plane, or of a narrow lens, confuse small rotations with translations.
        is_wrong = check.cause != "turned" or check.angle > REFUSED_ANGLE
        return (Finding(kind=kind, sentence=sentence, evidence=evidence, is_problem=is_wrong),)
    found = []
    shift, sigma = check.time_shift, check.time_sigma
    if math.isfinite(sigma) and abs(shift) > max(LEAST_SHIFT, SIGMAS * sigma):
        used = 1e3 * recording.calibration.time_offset
        found.append(
            Finding(
                kind="time offset",
                sentence=f"{recording.name}: time offset: the tracks imply "
                f"{1e3 * shift + used:.1f} ms (sigma {1e3 * sigma:.1f}), used were {used:.1f} ms; "
                "--refine-time-offset estimates it",
                evidence=evidence,
            )
        )
    limit = max(LEAST_ANGLE, SIGMAS * check.angle_sigma)  # nan: nothing follows
    if math.isfinite(check.angle_sigma) and check.angle > limit:
        found.append(
            Finding(
                kind="axes",
                sentence=f"{recording.name}: camera_from_imu: the tracks imply a rotation "
                f"{check.angle:.1f} degrees from the given one (sigma {check.angle_sigma:.1f}); "
                "--refine-extrinsics estimates it",
                evidence=evidence,
            )
        )
    return tuple(found)
