"""Folders of visual-inertial sequences, read and written.

====================  ============================================================================
``imu.csv``           EuRoC's columns: stamp [ns], angular rate x y z [rad/s], specific force
                      x y z [m/s^2]
``tracks.csv``        ``timestamp_ns,track_id,x,y``: pixels, or normalised image coordinates;
                      sorted by time or by track
``calibration.yaml``  :mod:`bundle.model.sequence.calibration`
====================  ============================================================================
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from bundle.base.paths import as_path
from bundle.errors import InputError, shown
from bundle.io.atomic import atomic_write as atomic
from bundle.io.file_names import check_name
from bundle.io.recognition import RECORDINGS, is_recording, sequence_at
from bundle.io.recognition import SEQUENCE_FILES as FILES
from bundle.io.sequences.csv_tables import CsvTable, csv_lines, read_csv
from bundle.io.sequences.track_csv import read_track_csv
from bundle.model.sequence.calibration import calibration_text, load_calibration
from bundle.model.sequence.sequence import (
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
    """Raise an error for a sequence on which odometry would fail.

    Raises:
        InputError: a finding is fatal.
    """
    for finding in findings:
        if finding.is_fatal:
            raise InputError(finding.sentence)


def read_sequence(
    path: str | os.PathLike[str],
) -> tuple[Sequence, tuple[SequenceFinding, ...]]:
    """Read a sequence folder, or the CSV file of GTSAM's examples; return its findings too.

    Raises:
        InputError: as for :func:`load_sequence`, but not for gaps.
        OSError: a file cannot be read.
    """
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
    """Raise the error that :func:`save_sequence` would raise.

    Raises:
        InputError: the path is a file or a folder with other content, it has the suffix of a file,
            or a path above it is no folder.
    """
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
