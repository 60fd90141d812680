"""Reading of recordings: images and IMU samples in one of several formats."""

from __future__ import annotations

import os

from bundle.base.paths import as_path
from bundle.base.records import dataclass
from bundle.errors import InputError, shown
from bundle.io.recognition import RECORDINGS, sequence_at
from bundle.io.sequences.bag_recording import read_bag
from bundle.io.sequences.grey_images import require_opencv
from bundle.io.sequences.mav_folder import read_mav
from bundle.io.sequences.video_recording import read_video
from bundle.model.sequence.recording import Recording


@dataclass(frozen=True)
class RecordingSource:
    """Where parts of a recording are that its path does not determine.

    Attributes:
        calibration: files of calibrations: this package's, or Kalibr's of camera and IMU.
        camera: name of the camera: a folder of mav0, and an entry of a camchain.
        imu: table of the IMU's samples, of a video.
        frame_times: times of the frames, of a video; None: a constant rate from 0.
        image_topic, imu_topic: topics of a ROS bag; None: the only one.
    """

    calibration: tuple[str | os.PathLike[str], ...] = ()
    camera: str = "cam0"
    imu: str | os.PathLike[str] | None = None
    frame_times: str | os.PathLike[str] | None = None
    image_topic: str | None = None
    imu_topic: str | None = None


_ONLY_OF = {
    "imu": "video",
    "frame_times": "video",
    "image_topic": "rosbag",
    "imu_topic": "rosbag",
}


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
    for name, only in _ONLY_OF.items():
        if getattr(source, name) is not None and format != only:
            raise InputError(
                f"{name}: valid only with {RECORDINGS[only]}, found {RECORDINGS[str(format)]}"
            )
    require_opencv(f"{shown(path)}: images")
    files = tuple(as_path(each) for each in source.calibration)
    if format == "rosbag":
        topics = source.image_topic, source.imu_topic
        return read_bag(as_path(path), files, source.camera, *topics)
    if format == "video":
        imu, times = (
            None if each is None else as_path(each) for each in (source.imu, source.frame_times)
        )
        return read_video(as_path(path), imu, times, files, source.camera)
    return read_mav(path, files, source.camera)
