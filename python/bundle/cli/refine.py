"""`bundle refine`."""

from __future__ import annotations

import argparse
import sys
from time import perf_counter
from typing import TYPE_CHECKING

from bundle.cli.arguments import FORMATS, add_input, add_solve_options, solve_options
from bundle.cli.errors import EXIT_DONE, EXIT_NO_SOLUTION

if TYPE_CHECKING:
    from bundle.result import Result

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "refine"
HELP = "bundle adjustment: poses, points and intrinsics that explain the observations best"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of this command."""
    parser.usage = "bundle refine INPUT -o OUTPUT [options]"
    add_input(parser)
    parser.add_argument(
        "-o",
        "--output",
        metavar="OUTPUT",
        required=True,
        help="what to write; may be INPUT. Takes INPUT's format unless its name says otherwise: "
        "NAME.txt, .txt.gz or .txt.bz2 is a BAL file, an existing folder a COLMAP model",
    )
    parser.add_argument(
        "--format", choices=FORMATS, help="format of OUTPUT (default: what its name says)"
    )
    add_solve_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Refine INPUT into OUTPUT."""
    started = perf_counter()
    from bundle.cli.output import check_destination, check_json, output_format, show, write_json
    from bundle.cli.progress import Progress
    from bundle.io import load, save
    from bundle.report import json
    from bundle.report.refine import refinement
    from bundle.report.timing import WallTime
    from bundle.solver import solve

    options = solve_options(arguments)
    source, target = arguments.input, arguments.output
    check_json(arguments.json)
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {source}")
        begun = perf_counter()
        problem = load(source)
        load_time = perf_counter() - begun
        kind = output_format(target, arguments.format, problem.format)
        check_destination(target, kind)
        progress.stage("building the problem")
        solved = solve(problem, options, progress=progress.iteration)
        begun = perf_counter()
        output, lost = None, ()
        if _worth_saving(solved):
            progress.stage(f"writing {target}")
            lost = save(solved.problem, target, kind)
            output = {"path": target, "format": kind}
        save_time = perf_counter() - begun
    wall = WallTime(
        load=load_time,
        build=solved.build_time_in_seconds,
        solve=solved.solve_time_in_seconds,
        save=save_time,
        total=perf_counter() - started,
    )
    write_json(arguments.json, json.refinement(source, problem, solved, wall, output))
    if arguments.json != "-":
        show(*refinement(source, problem, solved, wall, output, lost))
    elif not _done(solved):
        _say_outcome(solved)
    return EXIT_DONE if _done(solved) else EXIT_NO_SOLUTION


def _done(solved: Result) -> bool:
    return solved.summary.is_solution_usable and not solved.summary.interrupted


def _worth_saving(solved: Result) -> bool:
    return solved.summary.is_solution_usable or solved.summary.interrupted


def _say_outcome(solved: Result) -> None:
    """Tell a person what the report on standard output tells a program."""
    from bundle.report.refine import outcome

    print(outcome(solved), file=sys.stderr)
