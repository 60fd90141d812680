"""Flags of recordings, whose images are tracked.

Other inputs refuse these flags.
"""

from __future__ import annotations

import argparse
import dataclasses

from bundle.cli.option_flags import add_fields
from bundle.cli.path_checks import a_path
from bundle.errors import InputError
from bundle.interface.window_options import TrackingOptions

RECORDING = (
    "calibration",
    *("camera", "imu", "frame_times", "image_topic", "imu_topic"),
    *(field.name for field in dataclasses.fields(TrackingOptions)),
)
"""Destinations of the flags."""


def add_recording_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags of images and of tracking."""
    group = parser.add_argument_group("images of a visual-inertial sequence")
    group.add_argument(
        "--calibration",
        metavar="FILE",
        type=a_path,
        action="append",
        help="calibration in place of that in the sequence: calibration.yaml, or Kalibr's "
        "camchain-imucam.yaml and, given by a second --calibration or beside it, imu.yaml "
        "(default: sensor.yaml of mav0, or dso/camchain.yaml beside it; bags and videos have none)",
    )
    group.add_argument(
        "--camera",
        metavar="NAME",
        help="camera whose images are tracked: a folder of mav0, an entry of a camchain (default: "
        "cam0)",
    )
    group.add_argument(
        "--imu",
        metavar="FILE",
        type=a_path,
        help="samples of the IMU for a video: a csv of stamp, angular rate x y z [rad/s], specific "
        "force x y z [m/s^2]; stamps are integers of nanoseconds, or seconds with a decimal point",
    )
    group.add_argument(
        "--frame-times",
        metavar="FILE",
        type=a_path,
        help="times of the frames of a video, one a line, on the clock of --imu (default: the "
        "constant rate of the video, from 0)",
    )
    for sensor, name in (("image", "images"), ("imu", "IMU samples")):
        group.add_argument(
            f"--{sensor}-topic",
            metavar="TOPIC",
            help=f"topic of the {name} in a ROS bag (default: the rostopic of the calibration, or "
            "the only topic)",
        )
    add_fields(group, "TrackingOptions")


def refuse_recording_flags(arguments: argparse.Namespace) -> None:
    """Refuse flags of images for other inputs.

    Raises:
        InputError: such a flag was given.
    """
    for name in RECORDING:
        if getattr(arguments, name, None) is not None:
            raise InputError(
                f"{arguments.flags[name]}: valid only with images of a visual-inertial sequence, "
                "found an input without"
            )
