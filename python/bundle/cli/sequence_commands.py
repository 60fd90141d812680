"""What `bundle info` and `convert` do with a visual-inertial sequence."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.pose_graph_flags import refuse_flags_of_reconstructions
from bundle.io.recognition import sequence_format

if TYPE_CHECKING:
    from bundle.reports.sections import Report

__all__ = ["convert_sequence", "describe_sequence"]


def describe_sequence(path: str) -> Report:
    """Return the report of `bundle info` on a sequence."""
    from bundle.inertial.vio.sequence_statistics import sequence_statistics
    from bundle.io.sequences.sequence_folder import read_sequence
    from bundle.reports.terminal.sequence_tables import described_sequence

    sequence, findings = read_sequence(path)
    statistics = sequence_statistics(sequence)
    return described_sequence(path, sequence_format(path), sequence, statistics, findings)


def convert_sequence(arguments: argparse.Namespace) -> int:
    """Write a sequence as a folder."""
    import numpy as np

    from bundle.cli.output import check_replaced, publish
    from bundle.cli.progress import Progress
    from bundle.errors import shown
    from bundle.io.sequences.sequence_folder import (
        check_sequence_target,
        read_sequence,
        save_sequence,
    )
    from bundle.reports.terminal.convert import converted_sequence

    refuse_flags_of_reconstructions(arguments)
    source, target = arguments.input, arguments.output
    check_sequence_target(target)
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        sequence = read_sequence(source)[0]

        def is_same(path: Path) -> bool:
            there = read_sequence(path)[0]
            return np.array_equal(there.frames()[0], sequence.frames()[0])

        check_replaced(target, [source], arguments.overwrite, is_same)
        progress.stage(f"writing {shown(target)}")
        save_sequence(sequence, target)
    report = converted_sequence(source, sequence_format(source), sequence, target)
    publish(report, arguments.json)
    return EXIT_DONE
