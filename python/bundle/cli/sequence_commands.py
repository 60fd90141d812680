"""Commands on visual-inertial sequences: `bundle info` and `convert`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.flags_by_kind import refuse_flags_of_reconstructions
from bundle.cli.option_flags import naming_flags, options_given
from bundle.cli.output import check_replaced, publish
from bundle.cli.progress import Progress
from bundle.cli.recording_flags import RECORDING, refuse_recording_flags
from bundle.errors import InputError, shown
from bundle.inertial.tracking.sequence_axes import axes_findings
from bundle.inertial.vio.odometry import sequence_statistics
from bundle.interface.finding import Finding
from bundle.interface.window_options import TrackingOptions
from bundle.io.recognition import Kind, is_recording, sequence_format
from bundle.io.sequences.sequence_folder import (
    check_sequence_target,
    read_sequence,
    refuse_fatal,
    save_sequence,
)
from bundle.model.sequence.sequence import Sequence
from bundle.model.sequence.sequence_findings import SequenceFinding
from bundle.reports.sections import Report
from bundle.reports.terminal.convert import converted_sequence
from bundle.reports.terminal.tracking import described_sequence

if TYPE_CHECKING:
    from bundle.inertial.tracking.track_recording import Tracking


def describe(path: str, arguments: argparse.Namespace, progress: Progress) -> Report:
    """Return the report of `bundle info` on a sequence."""
    refuse_flags_of_reconstructions(arguments, RECORDING, Kind.SEQUENCE)
    given = given_sequence(path, arguments, progress)
    statistics = sequence_statistics(given.sequence)
    format = sequence_format(path)
    return described_sequence(
        path, format, given.sequence, statistics, given.findings, given.tracking
    )


def convert(arguments: argparse.Namespace) -> int:
    """Write a sequence as a folder."""
    refuse_flags_of_reconstructions(arguments, RECORDING, Kind.SEQUENCE)
    source, target = arguments.input, arguments.output
    check_sequence_target(target)
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        given = given_sequence(source, arguments, progress)
        sequence = given.sequence

        def is_same(path: Path) -> bool:
            there = read_sequence(path)[0]
            return np.array_equal(there.frames()[0], sequence.frames()[0])

        check_replaced(target, [source], arguments.overwrite, is_same)
        progress.stage(f"writing {shown(target)}")
        save_sequence(sequence, target)
    format = sequence_format(source)
    report = converted_sequence(source, format, sequence, target, given.findings, given.tracking)
    publish(report, arguments)
    return EXIT_DONE


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
