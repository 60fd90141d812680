"""CSV files of GTSAM's examples with the EuRoC flights: IMU samples and tracks, one per row.

Every row begins with its type: ``meta`` (key and value), ``imu`` (time in seconds, rates, specific
forces), ``vision_feature`` (time, frame, track, normalised coordinates).

The pose T_ci in the meta rows is the pose of the camera in the IMU's frame (imu_from_camera). With
T_ci, EuRoC's ground truth predicts the tracks to a pixel; with the inverse of T_ci it does not. The
noise values of the file come from a tuned filter. For EuRoC (``source_mode`` asl) they are replaced
by those in the data sheet of the ADIS16448, as in EuRoC's ``sensor.yaml``.
"""

from __future__ import annotations

import csv
import math
import os

import numpy as np

from bundle.base.paths import numbered_lines
from bundle.errors import InputError, brief, shown
from bundle.model.rigid_motions import inverse_poses, unit_poses
from bundle.model.sequence.calibration import Calibration
from bundle.model.sequence.imu_noise import ImuNoise
from bundle.model.sequence.sequence import Sequence
from bundle.model.sequence.stamp_units import LATEST

_POSE = ("T_ci_qx", "T_ci_qy", "T_ci_qz", "T_ci_qw", "T_ci_tx", "T_ci_ty", "T_ci_tz")
_FILTER_NOISE = ("gyr", "acc", "gyr_bias_walk", "acc_bias_walk")
_ADIS16448 = ImuNoise(1.6968e-4, 2.0e-3, 1.9393e-5, 3.0e-3)


def read_track_csv(path: str | os.PathLike[str]) -> Sequence:
    """Read the file as a sequence.

    Raises:
        InputError: a column or a calibration value is missing or is not a number. The message is
            one line that begins with the path.
        OSError: the file cannot be read.
    """
    name = shown(path)
    lines = numbered_lines(path)
    head = lines[0][1].strip().split(",")
    column = {title: index for index, title in enumerate(head)}
    needed = ("row_type", "t_abs", "landmark_id", "gx", "gy", "gz", "ax", "ay", "az", "u_norm")
    for title in (*needed, "v_norm", "key", "value"):
        if title not in column:
            raise InputError(f"{name}: line 1: expected a column {title}; it is missing")

    meta: dict[str, str] = {}
    imu: list[list[str]] = []
    tracks: list[list[str]] = []
    imu_columns = [column[title] for title in ("t_abs", "gx", "gy", "gz", "ax", "ay", "az")]
    track_columns = [column[title] for title in ("t_abs", "landmark_id", "u_norm", "v_norm")]
    for number, row in zip(
        (number for number, _ in lines[1:]), csv.reader(line for _, line in lines[1:]), strict=False
    ):
        if not row:
            continue
        if len(row) != len(head):
            raise InputError(
                f"{name}: line {number}: expected {len(head)} columns, found {len(row)}"
            )
        if row[0] == "meta":
            meta[row[column["key"]]] = row[column["value"]]
        elif row[0] in ("imu", "vision_feature"):
            rows, wanted = (imu, imu_columns) if row[0] == "imu" else (tracks, track_columns)
            rows.append([row[index] for index in wanted])
        else:
            raise InputError(
                f"{name}: line {number}: expected meta, imu or vision_feature, found "
                f"{brief(row[0])}"
            )
    try:
        samples = np.array(imu, np.float64).reshape(-1, 7)
        observations = np.array(tracks, np.float64).reshape(-1, 4)
    except ValueError as error:
        raise InputError(f"{name}: expected numbers, found: {error}") from None
    imu_stamps, stamps = _nanoseconds(samples[:, 0]), _nanoseconds(observations[:, 0])
    ids = observations[:, 1].astype(np.int64)
    order = np.lexsort((ids, stamps))
    try:
        return Sequence(
            imu_timestamps_ns=imu_stamps,
            gyro=samples[:, 1:4],
            accel=samples[:, 4:],
            track_timestamps_ns=stamps[order],
            track_ids=ids[order],
            xy=observations[order, 2:],
            calibration=_calibration(name, meta, imu_stamps, stamps),
        )
    except InputError as error:
        text = str(error)
        raise InputError(text if text.startswith(name) else f"{name}: {text}") from None


def _calibration(
    name: str, meta: dict[str, str], imu_stamps: np.ndarray, stamps: np.ndarray
) -> Calibration:
    def value(key: str) -> float:
        try:
            return float(meta[key])
        except (KeyError, ValueError):
            found = brief(meta[key]) if key in meta else "no such row"
            raise InputError(f"{name}: meta {key}: expected a number, found {found}") from None

    imu_from_camera = np.array([[value(key) for key in _POSE]])
    norm = np.linalg.norm(imu_from_camera[0, :4])
    if not 0.99 < norm < 1.01:
        raise InputError(f"{name}: meta T_ci: expected a quaternion of norm 1, found norm {norm:g}")
    camera_from_imu = inverse_poses(unit_poses(imu_from_camera))[0]
    if meta.get("source_mode") == "asl":
        noise = _ADIS16448
    else:
        noise = ImuNoise(*(math.sqrt(value(f"eqf.input_var_{key}")) for key in _FILTER_NOISE))
    return Calibration(
        camera_from_imu=tuple(camera_from_imu.tolist()),
        noise=noise,
        imu_rate=_rate(imu_stamps),
        camera_rate=_rate(np.unique(stamps)),
        focal=(value("camera_fx") + value("camera_fy")) / 2,
    )


def _rate(stamps: np.ndarray) -> float:
    """Return the rate of time stamps in Hz, rounded to 0.2 %."""
    step = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 1e9
    return round(1e9 / step, 2) if step > 0 else 1.0


def _nanoseconds(seconds: np.ndarray) -> np.ndarray:
    if not (np.abs(seconds) < LATEST).all():
        raise InputError("t_abs: expected finite times in seconds, found inf or nan")
    return np.rint(1e9 * seconds).astype(np.int64)
