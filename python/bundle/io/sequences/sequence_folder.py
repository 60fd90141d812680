"""Folders of visual-inertial sequences, read and written, and GTSAM's tables of tracks.

====================  ============================================================================
``imu.csv``           EuRoC's columns: stamp [ns], angular rate x y z [rad/s], specific force
                      x y z [m/s^2]
``tracks.csv``        ``timestamp_ns,track_id,x,y``: pixels, or normalised image coordinates;
                      sorted by time or by track
``calibration.yaml``  :mod:`bundle.model.sequence.calibration`
====================  ============================================================================
"""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from bundle.base.arrays import at
from bundle.base.paths import as_path, numbered_lines
from bundle.errors import InputError, brief, shown
from bundle.io.atomic import atomic_write as atomic
from bundle.io.recognition import RECORDINGS, check_name, is_recording, sequence_at
from bundle.io.recognition import SEQUENCE_FILES as FILES
from bundle.io.sequences.trajectory_files import CsvTable, csv_lines, read_csv
from bundle.model.rigid_motions import inverse_poses, unit_poses
from bundle.model.sequence.calibration import (
    Calibration,
    ImuNoise,
    calibration_text,
    load_calibration,
)
from bundle.model.sequence.sequence import (
    LATEST,
    Sequence,
    check_imu,
    check_overlap,
    check_stamp_units,
    check_tracks,
)
from bundle.model.sequence.sequence_findings import SequenceFinding, sequence_findings

IMU_HEAD = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
)
TRACKS_HEAD = "timestamp_ns,track_id,x,y"


def load_sequence(path: str | os.PathLike[str]) -> Sequence:
    """Read a sequence folder, or the CSV file of GTSAM's examples; raise an error on fatal gaps.

    Raises:
        InputError: the content violates the formats, or images fall into a gap of the IMU data; one
            line with file, line, expected and actual value.
        OSError: a file cannot be read.
    """
    sequence, findings = read_sequence(path)
    refuse_fatal(findings)
    return sequence


def refuse_fatal(findings: Iterable[SequenceFinding]) -> None:
    """Raise an error for a sequence on which odometry would fail."""
    for finding in findings:
        if finding.is_fatal:
            raise InputError(finding.sentence)


def read_sequence(
    path: str | os.PathLike[str],
) -> tuple[Sequence, tuple[SequenceFinding, ...]]:
    """Return a sequence and its findings, from a folder or the CSV file of GTSAM's examples."""
    folder = as_path(path)
    if sequence_at(folder) == "track csv":
        sequence = read_track_csv(folder)
        return sequence, sequence_findings(
            sequence, lambda row: f"IMU sample {row}", lambda row: f"observation {row}"
        )
    if is_recording(folder):
        raise InputError(
            f"{shown(folder)}: expected a folder with {', '.join(FILES)}, found images: "
            "bundle.track_images reads them"
        )
    folder.stat()  # raises the error of a path that does not exist
    if sequence_at(folder) is None:
        raise InputError(
            f"{shown(folder)}: expected a folder with {', '.join(FILES)}, or "
            f"{', '.join(RECORDINGS.values())}, found {_what(folder)}"
        )
    calibration = load_calibration(folder / "calibration.yaml")
    imu = read_csv(folder / "imu.csv", ["timestamp"], ["wx", "wy", "wz", "ax", "ay", "az"])
    tracks = read_csv(folder / "tracks.csv", ["timestamp_ns", "track_id"], ["x", "y"])
    tracks = _by_time(tracks)
    check_stamp_units(imu.whole[:, 0], tracks.whole[:, 0], calibration, imu.place, tracks.place)
    check_imu(imu.whole[:, 0], imu.numbers[:, :3], imu.numbers[:, 3:], imu.place)
    check_tracks(tracks.whole[:, 0], tracks.whole[:, 1], tracks.numbers, tracks.place)
    offset = round(1e9 * calibration.time_offset)
    check_overlap(imu.whole[:, 0], tracks.whole[:, 0] + offset, tracks.name)
    sequence = Sequence(
        imu_timestamps_ns=imu.whole[:, 0],
        gyro=imu.numbers[:, :3],
        accel=imu.numbers[:, 3:],
        track_timestamps_ns=tracks.whole[:, 0],
        track_ids=tracks.whole[:, 1],
        xy=tracks.numbers,
        calibration=calibration,
    )
    return sequence, sequence_findings(sequence, imu.place, tracks.place)


def save_sequence(sequence: Sequence, path: str | os.PathLike[str]) -> None:
    """Write a sequence folder; numbers read back unchanged.

    Raises:
        InputError: for the reasons of :func:`check_sequence_target`.
        OSError: a system call fails.
    """
    folder = as_path(path)
    check_sequence_target(path)
    rates, forces, xy = sequence.gyro, sequence.accel, sequence.xy
    texts = {
        "imu.csv": csv_lines(IMU_HEAD, sequence.imu_timestamps_ns, *rates.T, *forces.T),
        "tracks.csv": csv_lines(
            TRACKS_HEAD, sequence.track_timestamps_ns, sequence.track_ids, *xy.T
        ),
        "calibration.yaml": calibration_text(sequence.calibration),
    }
    with atomic.made_folder(folder):
        for name, text in texts.items():
            atomic.write_text(folder / name, text)


def check_sequence_target(path: str | os.PathLike[str]) -> None:
    """Raise the error that :func:`save_sequence` would raise."""
    folder = Path(os.path.realpath(as_path(path)))
    if not folder.exists():
        check_name(path, "a folder")
        atomic.check_folder(Path(path))
        return
    if not folder.is_dir():
        raise InputError(f"{shown(path)}: expected a sequence folder or a new path, found a file")
    others = sorted(file.name for file in folder.iterdir() if file.name not in FILES)
    if others and sequence_at(folder) != "sequence":
        raise InputError(
            f"{shown(path)}: expected a sequence folder, an empty folder or a new path, found a "
            f"folder with other content ({shown(others[0])})"
        )


def _what(path: Path) -> str:
    if not path.is_dir():
        return "a file"
    names = sorted(file.name for file in path.iterdir())
    return f"a folder with {', '.join(map(shown, names[:3]))}" if names else "an empty folder"


def _by_time(tracks: CsvTable) -> CsvTable:
    """Sort observations by time, then id, if the file is sorted by time or by track."""
    stamps, ids = tracks.whole[:, 0], tracks.whole[:, 1]
    later, same = np.diff(stamps), np.diff(ids) == 0
    by_time = bool((later >= 0).all())
    by_track = bool((np.diff(ids) >= 0).all() and (later[same] >= 0).all())
    if not by_time and not by_track:
        return tracks  # check_tracks reports the row where time decreases
    order = np.lexsort((ids, stamps))
    return CsvTable(tracks.whole[order], tracks.numbers[order], tracks.lines[order], tracks.name)


# CSV files of GTSAM's examples with the EuRoC flights: IMU samples and tracks, one per row.
#
# Every row begins with its type: ``meta`` (key and value), ``imu`` (time in seconds, rates,
# specific forces), ``vision_feature`` (time, frame, track, normalised coordinates).
#
# The pose T_ci in the meta rows is the pose of the camera in the IMU's frame (imu_from_camera).
# With T_ci, EuRoC's ground truth predicts the tracks to a pixel; with the inverse of T_ci it does
# not. The noise values of the file come from a tuned filter. For EuRoC (``source_mode`` asl) they
# are replaced by those in the data sheet of the ADIS16448, as in EuRoC's ``sensor.yaml``.

_POSE = ("T_ci_qx", "T_ci_qy", "T_ci_qz", "T_ci_qw", "T_ci_tx", "T_ci_ty", "T_ci_tz")
_FILTER_NOISE = ("gyr", "acc", "gyr_bias_walk", "acc_bias_walk")
_ADIS16448 = ImuNoise(1.6968e-4, 2.0e-3, 1.9393e-5, 3.0e-3)


def read_track_csv(path: str | os.PathLike[str]) -> Sequence:
    """Read the file as a sequence."""
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
    with at(f"{name}: expected numbers, found", ValueError):
        samples = np.array(imu, np.float64).reshape(-1, 7)
        observations = np.array(tracks, np.float64).reshape(-1, 4)
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
