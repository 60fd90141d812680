"""`bundle info` and `convert` of a visual-inertial sequence."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.flags_by_kind import refuse_flags_of_reconstructions
from bundle.cli.given_sequence import given_sequence
from bundle.cli.output import check_replaced, publish
from bundle.cli.progress import Progress
from bundle.cli.recording_flags import RECORDING
from bundle.errors import shown
from bundle.inertial.vio.sequence_statistics import sequence_statistics
from bundle.io.recognition import Kind, sequence_format
from bundle.io.sequences.sequence_folder import (
    check_sequence_target,
    read_sequence,
    save_sequence,
)
from bundle.reports.sections import Report
from bundle.reports.terminal.convert import converted_sequence
from bundle.reports.terminal.sequence_tables import described_sequence


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
