"""Folders of EuRoC and TUM-VI: images of a camera and samples of an IMU.

The path is ``mav0`` or its parent::

    mav0/cam0/data.csv       stamp [ns], file name (with or without its extension)
    mav0/cam0/data/*.png
    mav0/cam0/sensor.yaml    lens, T_BS, rate (TUM-VI: dso/camchain.yaml beside mav0)
    mav0/imu0/data.csv       stamp [ns], angular rate [rad/s], specific force [m/s^2]
    mav0/imu0/sensor.yaml    noise densities, T_BS, rate (TUM-VI: dso/imu_config.yaml)
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.paths import as_path, numbered_lines
from bundle.errors import InputError, brief, shown
from bundle.io.recognition import mav_root
from bundle.io.sequences.csv_tables import read_csv
from bundle.io.sequences.grey_images import grey_images
from bundle.io.sequences.recording_calibration import find_calibration
from bundle.model.sequence.recording import Recording

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".tif", ".tiff")


def read_mav(
    path: str | os.PathLike[str],
    calibration: Sequence[str | os.PathLike[str]] = (),
    camera: str = "cam0",
) -> Recording:
    """Read samples, calibration and list of images; images are read when they are needed.

    Args:
        path: ``mav0`` or its parent.
        calibration: files that replace those of the folder.
        camera: folder of the camera, and its name in a camchain.

    Raises:
        InputError: a file violates its format, or an image is missing.
        OSError: a file cannot be read.
    """
    given = as_path(path)
    root = mav_root(given) or given
    for name in (camera, "imu0"):
        if not (root / name / "data.csv").is_file():
            raise InputError(f"{shown(root)}: expected {name}/data.csv; it is missing")
    stamps, files, lines = _image_list(root / camera)
    imu = read_imu_csv(root / "imu0" / "data.csv")
    beside = root.parent / "dso"
    found = find_calibration(
        [as_path(each) for each in calibration],
        [root / camera / "sensor.yaml", beside / "camchain.yaml"],
        [root / "imu0" / "sensor.yaml", beside / "imu_config.yaml"],
        camera,
        (stamps, imu.whole[:, 0]),
    )
    table = shown(root / camera / "data.csv")

    def images(first: int, last: int) -> Iterator[NDArray[np.uint8]]:
        return grey_images(files[first:last], found.size)

    return Recording(
        name=shown(given),
        imu_timestamps_ns=imu.whole[:, 0],
        gyro=imu.numbers[:, :3],
        accel=imu.numbers[:, 3:],
        image_timestamps_ns=stamps,
        images=images,
        calibration=found.calibration,
        notes=found.notes,
        imu_place=imu.place,
        image_place=lambda row: f"{table}: line {lines[row]}" if row < len(lines) else table,
    )


def read_imu_csv(path: Path) -> Any:
    """Read EuRoC's table of an IMU.

    Raises:
        InputError: a line has other columns, or stamps are not integers of nanoseconds.
        OSError: the file cannot be read.
    """
    return read_csv(path, ["timestamp"], ["wx", "wy", "wz", "ax", "ay", "az"])


def _image_list(folder: Path) -> tuple[NDArray[np.int64], list[Path], list[int]]:
    """Return the stamps, the files and their lines in the table."""
    table, data = folder / "data.csv", folder / "data"
    if not data.is_dir() and (folder / "images").is_dir():
        data = folder / "images"
    known = {entry.name for entry in os.scandir(data)} if data.is_dir() else set()
    stamps: list[int] = []
    files: list[Path] = []
    lines: list[int] = []
    missing, first = 0, ""
    for number, line in numbered_lines(table):
        words = [word.strip() for word in line.split(",")]
        if not words[0] or words[0].startswith("#") or (not lines and words[0][0].isalpha()):
            continue
        place = f"{shown(table)}: line {number}"
        if len(words) > 2 or not _is_stamp(words[0]):
            raise InputError(
                f"{place}: expected a stamp in nanoseconds and a file name, found {brief(line)}"
                + ("; a stamp in seconds?" if _is_decimal(words[0]) else "")
            )
        name = (words[1:] or [""])[0] or words[0]
        name = next((name + end for end in ("", *SUFFIXES) if name + end in known), name)
        if name not in known:
            missing += 1
            first = first or f"{place}: expected the image {shown(data / name)}; it is missing"
        stamps.append(int(words[0]))
        files.append(data / name)
        lines.append(number)
    if missing:
        raise InputError(f"{first} ({missing} of {len(files)} are)")
    return np.array(stamps, np.int64), files, lines


def _is_stamp(word: str) -> bool:
    return word.isdecimal() and int(word) < 2**63


def _is_decimal(word: str) -> bool:
    try:
        return float(word) < 1e11
    except ValueError:
        return False
