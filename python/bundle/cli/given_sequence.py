"""Visual-inertial sequence from the command line; features of a recording are tracked."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, NamedTuple

from bundle.cli.option_flags import naming_flags, options_given
from bundle.cli.progress import Progress
from bundle.cli.recording_flags import refuse_recording_flags
from bundle.errors import InputError, shown
from bundle.inertial.tracking.sequence_axes import axes_findings
from bundle.interface.finding import Finding
from bundle.interface.tracking_options import TrackingOptions
from bundle.io.recognition import is_recording
from bundle.io.sequences.sequence_folder import read_sequence, refuse_fatal
from bundle.model.sequence.sequence import Sequence
from bundle.model.sequence.sequence_findings import SequenceFinding

if TYPE_CHECKING:
    from bundle.inertial.tracking.track_recording import Tracking


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


def given_sequence(path: str, arguments: argparse.Namespace, progress: Progress) -> GivenSequence:
    """Read a sequence; track features if it has images.

    Raises:
        InputError: the input violates its format, or has flags of another kind.
        OSError: a file cannot be read.
    """
    if not is_recording(path):
        refuse_recording_flags(arguments)
        sequence, findings = read_sequence(path)
        fatal = any(finding.is_fatal for finding in findings)
        axes = () if fatal else axes_findings(sequence, path)
        return GivenSequence(sequence, (*axes, *findings), None)
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
