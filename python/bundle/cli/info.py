"""`bundle info`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.parser import add_input, add_rig_config, with_rigs

if TYPE_CHECKING:
    from bundle.reports.sections import Report

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "info"
HELP = "what a reconstruction holds, its reprojection error [px] now, and what looks wrong"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of this command."""
    parser.usage = "bundle info INPUT... [options]"
    add_input(parser, "inputs", nargs="+")
    add_rig_config(parser)


def run(arguments: argparse.Namespace) -> int:
    """Describe every INPUT."""
    from bundle.analysis.statistics.description import describe
    from bundle.cli.output import publish, show, write_json
    from bundle.cli.pose_graph_commands import describe_graph
    from bundle.cli.pose_graph_flags import refuse_flags_of_reconstructions
    from bundle.cli.progress import Progress
    from bundle.cli.sequence_commands import describe_sequence
    from bundle.errors import shown
    from bundle.io.open import load
    from bundle.io.recognition import is_pose_graph_file, sequence_at
    from bundle.reports.sections import several
    from bundle.reports.terminal.info import information
    from bundle.reports.terminal.screen import laid_out

    reports: list[Report] = []
    with Progress(quiet=arguments.quiet) as progress:
        for path in arguments.inputs:
            progress.stage(f"reading {shown(path)}")
            if is_pose_graph_file(path) or sequence_at(path):
                refuse_flags_of_reconstructions(arguments)
                describe_it = describe_sequence if sequence_at(path) else describe_graph
                reports.append(describe_it(path))
                continue
            problem = with_rigs(load(path, progress.text), arguments.rig_config)
            progress.stage("counting")
            reports.append(information(path, problem, describe(problem)))
    if len(reports) == 1:
        publish(reports[0], arguments.json)
        return EXIT_DONE
    if arguments.json != "-":
        show(*laid_out([section for report in reports for section in report.sections]))
    if arguments.json is not None:
        write_json(arguments.json, several("info", reports))
    return EXIT_DONE
