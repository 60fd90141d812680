"""What `bundle info` and `convert` do with a visual-inertial sequence."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.pose_graph_flags import refuse_flags_of_reconstructions
from bundle.io.recognition import sequence_at

if TYPE_CHECKING:
    from rich.console import RenderableType

__all__ = ["convert_sequence", "describe_sequence"]


def describe_sequence(path: str) -> tuple[list[RenderableType], dict[str, Any]]:
    """Return what `bundle info` says of a sequence, for people and for programs."""
    from bundle.reports.sequence_tables import described_sequence, information_of_sequence
    from bundle.vio import read_sequence, read_track_csv, sequence_findings
    from bundle.vio.sequence_statistics import sequence_statistics

    if sequence_at(path) == "track csv":
        sequence = read_track_csv(path)
        findings = sequence_findings(
            sequence, lambda row: f"IMU sample {row}", lambda row: f"observation {row}"
        )
    else:
        sequence, findings = read_sequence(path)
    statistics = sequence_statistics(sequence)
    return (
        described_sequence(path, sequence, statistics, findings),
        information_of_sequence(path, sequence, statistics, findings),
    )


def convert_sequence(arguments: argparse.Namespace) -> int:
    """Write a sequence as a folder."""
    from bundle.cli.output import check_json, show, write_json
    from bundle.cli.progress import Progress
    from bundle.errors import shown
    from bundle.reports.sequence_tables import conversion_of_sequence, converted_sequence
    from bundle.vio import check_sequence_target, read_sequence, read_track_csv, save_sequence

    refuse_flags_of_reconstructions(arguments)
    source, target = arguments.input, arguments.output
    check_json(arguments.json, source, target)
    check_sequence_target(target)
    is_table = sequence_at(source) == "track csv"
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        sequence = read_track_csv(source) if is_table else read_sequence(source)[0]
        progress.stage(f"writing {shown(target)}")
        save_sequence(sequence, target)
    if arguments.json != "-":
        show(*converted_sequence(source, sequence, target))
    format = "track_csv" if is_table else "sequence"
    write_json(arguments.json, conversion_of_sequence(source, format, sequence, target))
    return EXIT_DONE
