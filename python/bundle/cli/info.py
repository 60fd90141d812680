"""`bundle info`."""

from __future__ import annotations

import argparse

from bundle.cli.arguments import add_input
from bundle.cli.errors import EXIT_DONE

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "info"
HELP = "what a reconstruction holds, its reprojection error [px] now, and what looks wrong"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of this command."""
    add_input(parser)


def run(arguments: argparse.Namespace) -> int:
    """Describe INPUT."""
    from bundle.cli.output import check_json, show, write_json
    from bundle.cli.progress import Progress
    from bundle.errors import shown
    from bundle.io import load
    from bundle.report import info, json
    from bundle.statistics import describe

    check_json(arguments.json, arguments.input)
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(arguments.input)}")
        problem = load(arguments.input)
        progress.stage("counting")
        description = describe(problem)
    if arguments.json != "-":
        show(*info.information(arguments.input, problem, description))
    write_json(arguments.json, json.information(arguments.input, problem, description))
    return EXIT_DONE
