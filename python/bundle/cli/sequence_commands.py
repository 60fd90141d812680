"""What `bundle info` and `convert` do with a visual-inertial sequence."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.pose_graph_flags import refuse_flags_of_reconstructions
from bundle.io.recognition import sequence_format

if TYPE_CHECKING:
    from rich.console import RenderableType

__all__ = ["convert_sequence", "describe_sequence"]


def describe_sequence(path: str) -> tuple[list[RenderableType], dict[str, Any]]:
    """Return what `bundle info` says of a sequence, for people and for programs."""
    from bundle.inertial.vio.sequence_statistics import sequence_statistics
    from bundle.io.sequences.sequence_folder import read_sequence
    from bundle.reports.terminal.sequence_tables import described_sequence, information_of_sequence

    sequence, findings = read_sequence(path)
    statistics = sequence_statistics(sequence)
    return (
        described_sequence(path, sequence, statistics, findings),
        information_of_sequence(path, sequence_format(path), sequence, statistics, findings),
    )


def convert_sequence(arguments: argparse.Namespace) -> int:
    """Write a sequence as a folder."""
    import numpy as np

    from bundle.cli.output import check_replaced, show, write_json
    from bundle.cli.progress import Progress
    from bundle.errors import shown
    from bundle.io.sequences.sequence_folder import (
        check_sequence_target,
        read_sequence,
        save_sequence,
    )
    from bundle.reports.terminal.sequence_tables import conversion_of_sequence, converted_sequence

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
    if arguments.json != "-":
        show(*converted_sequence(source, sequence, target))
    write_json(
        arguments.json, conversion_of_sequence(source, sequence_format(source), sequence, target)
    )
    return EXIT_DONE
