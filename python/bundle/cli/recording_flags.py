"""Flags of recordings, whose images are tracked, and their reading.

Other inputs refuse these flags.
"""

from __future__ import annotations

import argparse
import dataclasses
from typing import TYPE_CHECKING, NamedTuple

from bundle.cli.option_flags import add_fields, naming_flags, options_given
from bundle.cli.path_checks import a_path
from bundle.cli.progress import Progress
from bundle.errors import InputError, shown
from bundle.interface.finding import Finding
from bundle.interface.tracking_options import TrackingOptions
from bundle.io.recognition import is_recording
from bundle.io.sequences.sequence_folder import read_sequence, refuse_fatal
from bundle.model.sequence.sequence import Sequence
from bundle.model.sequence.sequence_findings import SequenceFinding

if TYPE_CHECKING:
    from bundle.inertial.tracking.track_recording import Tracking

__all__ = [
    "RECORDING",
    "GivenSequence",
    "add_recording_flags",
    "given_sequence",
    "refuse_recording_flags",
]

RECORDING = (
    "calibration",
    *("camera", "imu", "frame_times", "image_topic", "imu_topic"),
    *(field.name for field in dataclasses.fields(TrackingOptions)),
)
"""Destinations of the flags."""


class GivenSequence(NamedTuple):
    """Sequence from the command line; ``tracking`` is None if the input has tracks."""

    sequence: Sequence
    findings: tuple[SequenceFinding | Finding, ...]
    tracking: Tracking | None

    def refuse_fatal(self) -> None:
        """Raise an error for a sequence on which odometry would fail.

        Raises:
            InputError: a finding is fatal.
        """
        for finding in self.findings:
            if isinstance(finding, Finding) and finding.is_problem:
                raise InputError(finding.sentence)
        refuse_fatal(each for each in self.findings if isinstance(each, SequenceFinding))


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


def given_sequence(path: str, arguments: argparse.Namespace, progress: Progress) -> GivenSequence:
    """Read a sequence; track features if it has images.

    Raises:
        InputError: the input violates its format, or has flags of another kind.
        OSError: a file cannot be read.
    """
    if not is_recording(path):
        refuse_recording_flags(arguments)
        sequence, findings = read_sequence(path)
        return GivenSequence(sequence, findings, None)
    from bundle.inertial.tracking.track_images import track_images  # for images only

    progress.stage(f"tracking features of {shown(path)}")
    places = ("imu", "frame_times", "image_topic", "imu_topic")
    with naming_flags(TrackingOptions, **{name: arguments.flags[name] for name in places}):
        tracked = track_images(
            path,
            calibration=arguments.calibration or (),
            camera=arguments.camera or "cam0",
            options=options_given(arguments, TrackingOptions),
            progress=progress.share,
            **{name: getattr(arguments, name) for name in places},
        )
    return GivenSequence(tracked.sequence, tracked.findings, tracked.tracking)


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
