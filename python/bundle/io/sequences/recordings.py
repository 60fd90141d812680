"""Reading of recordings: images and IMU samples in one of several formats."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from bundle.base.paths import as_path
from bundle.errors import InputError, shown
from bundle.io.recognition import RECORDINGS, sequence_at
from bundle.io.sequences.grey_images import require_opencv
from bundle.io.sequences.mav_folder import read_mav
from bundle.model.sequence.recording import Recording

__all__ = ["RecordingSource", "read_recording"]


@dataclass(frozen=True)
class RecordingSource:
    """Where parts of a recording are that its path does not determine.

    Attributes:
        calibration: files of calibrations: this package's, or Kalibr's of camera and IMU.
        camera: name of the camera: a folder of mav0, and an entry of a camchain.
    """

    calibration: tuple[str | os.PathLike[str], ...] = ()
    camera: str = "cam0"


def read_recording(path: str | os.PathLike[str], source: RecordingSource) -> Recording:
    """Read samples, calibration and list of images.

    Raises:
        InputError: the path is no recording, a file violates its format, or OpenCV is missing.
        OSError: a file cannot be read.
    """
    format = sequence_at(as_path(path))
    if format not in RECORDINGS:
        expected = ", ".join(RECORDINGS.values())
        raise InputError(f"{shown(path)}: expected images and IMU samples: {expected}")
    require_opencv(f"{shown(path)}: images")
    files = tuple(Path(each) for each in source.calibration)
    return read_mav(path, files, source.camera)
