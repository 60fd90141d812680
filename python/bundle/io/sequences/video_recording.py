"""A video with the samples of an IMU in a table, as action cameras and telephones record them.

Frames have the times of ``--frame-times``, one a line, or a constant rate from 0. The first column
of the IMU's table is on the same clock. Both are integers of nanoseconds, or seconds if a number
has a decimal point. The other columns are EuRoC's: rad/s, m/s^2.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.paths import numbered_lines
from bundle.errors import InputError, shown
from bundle.io.sequences.csv_tables import CsvTable, read_csv
from bundle.io.sequences.grey_images import GreyScale, check_size
from bundle.io.sequences.recording_calibration import find_calibration
from bundle.model.sequence.recording import Recording

COLUMNS = ["wx", "wy", "wz", "ax", "ay", "az"]
SLACK = 2  # frames that a container may count and not hold


def read_video(
    path: Path,
    imu: Path | None,
    frame_times: Path | None = None,
    calibration: Sequence[Path] = (),
    camera: str = "cam0",
) -> Recording:
    """Read samples and times of frames; frames are decoded when they are needed.

    Args:
        path: the video.
        imu: table of the samples.
        frame_times: times of the frames; None: a constant rate from 0.
        calibration: files of the calibration.
        camera: name of the camera in a camchain.

    Raises:
        InputError: a file violates its format, or numbers of frames and times differ.
        OSError: a file cannot be read.
    """
    if imu is None:
        raise InputError(f"{shown(path)}: a video: expected --imu FILE with the IMU's samples")
    count, rate = _frames(path)
    if frame_times is None:
        stamps: NDArray[np.int64] = np.rint(1e9 / rate * np.arange(count)).astype(np.int64)
        note = f"Frames: {count} at {rate:.6g} per second from 0, the rate of the container."
    else:
        table = _table(frame_times, [])
        stamps = table.whole[:, 0]
        note = f"Frames: times of {shown(frame_times)}."
        if abs(len(stamps) - count) > SLACK:
            raise InputError(
                f"{shown(frame_times)}: expected the times of {count} frames of {shown(path)}, "
                f"found {len(stamps)}"
            )
    samples = _table(imu, COLUMNS)
    found = find_calibration(calibration, [], [], camera, (stamps, samples.whole[:, 0]))

    def images(first: int, last: int) -> Iterator[NDArray[np.uint8]]:
        return _images(path, found.size, first, last, count)

    def place(row: int) -> str:
        return f"{shown(path)}: frame {row + 1}" if frame_times is None else table.place(row)

    return Recording(
        name=shown(path),
        imu_timestamps_ns=samples.whole[:, 0],
        gyro=samples.numbers[:, :3],
        accel=samples.numbers[:, 3:],
        image_timestamps_ns=stamps,
        images=images,
        calibration=found.calibration,
        notes=(note, *found.notes),
        imu_place=samples.place,
        image_place=place,
    )


def _table(path: Path, columns: list[str]) -> CsvTable:
    """Read a table whose first column is a time; return it in nanoseconds."""
    lines = (text.split(",")[0].strip() for _, text in numbered_lines(path))
    if not any("." in word for word in lines if word[:1].isdigit() or word[:1] == "-"):
        return read_csv(path, ["timestamp"], columns)
    table = read_csv(path, [], ["timestamp", *columns])
    times = 1e9 * table.numbers[:, :1]
    wrong = np.flatnonzero(~(np.abs(times[:, 0]) < 2**63))
    if len(wrong):
        raise InputError(f"{table.place(int(wrong[0]))}: timestamp: expected seconds")
    whole = np.rint(times).astype(np.int64)
    return CsvTable(whole, table.numbers[:, 1:], table.lines, table.name)


def _opened(path: Path) -> Any:
    import cv2

    video = cv2.VideoCapture(str(path))
    if not video.isOpened():
        with path.open("rb"):  # raises the error of the system
            pass
        raise InputError(f"{shown(path)}: expected a video that OpenCV can decode")
    return video


def _frames(path: Path) -> tuple[int, float]:
    """Return the number of frames and the rate that the container states."""
    import cv2

    video = _opened(path)
    count, rate = round(video.get(cv2.CAP_PROP_FRAME_COUNT)), video.get(cv2.CAP_PROP_FPS)
    video.release()
    if count < 1 or not 0.1 < rate < 2000:
        raise InputError(
            f"{shown(path)}: expected a number of frames and their rate in the container, found "
            f"{count} and {rate:g}"
        )
    return count, float(rate)


def _images(
    path: Path, size: tuple[int, int] | None, first: int, last: int, count: int
) -> Iterator[NDArray[np.uint8]]:
    import cv2

    scale, video = GreyScale(), _opened(path)
    try:
        for number in range(last):
            if not video.grab():
                if number < count - SLACK:
                    raise InputError(
                        f"{shown(path)}: expected {count} frames, found {number}: a truncated video"
                    )
                return
            if number < first:
                continue
            decoded, frame = video.retrieve()
            if not decoded:
                raise InputError(f"{shown(path)}: frame {number + 1}: expected an image")
            image: Any = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) if frame.ndim == 3 else frame
            size = check_size(image, size, f"{shown(path)}: frame {number + 1}")
            yield scale.grey(image)
    finally:
        video.release()
