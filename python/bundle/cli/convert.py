"""`bundle convert`."""

from __future__ import annotations

import argparse

from bundle.cli.arguments import FORMATS, add_input
from bundle.cli.errors import EXIT_DONE

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "convert"
HELP = "between formats, saying what is lost"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of this command."""
    add_input(parser)
    parser.add_argument(
        "output",
        metavar="OUTPUT",
        help="what to write: NAME.txt, .txt.gz or .txt.bz2 is a BAL file, a folder a COLMAP model",
    )
    parser.add_argument(
        "--format", choices=FORMATS, help="format of OUTPUT (default: what its name says)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Write INPUT in another format."""
    from bundle.cli.output import check_destination, check_json, output_format, show, write_json
    from bundle.cli.progress import Progress
    from bundle.io import load, save
    from bundle.report import json
    from bundle.report.convert import conversion

    path = arguments.output
    check_json(arguments.json)
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {arguments.input}")
        problem = load(arguments.input)
        kind = output_format(path, arguments.format, problem.format)
        check_destination(path, kind)
        progress.stage(f"writing {path}")
        lost = save(problem, path, kind)
    output = {"path": path, "format": kind}
    if arguments.json != "-":
        show(*conversion(arguments.input, problem, output, lost))
    write_json(arguments.json, json.conversion(arguments.input, problem, output, lost))
    return EXIT_DONE
