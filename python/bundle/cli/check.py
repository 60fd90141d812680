"""`bundle check`."""

from __future__ import annotations

import argparse
from time import perf_counter

from bundle.cli.error_lines import EXIT_DONE, EXIT_NO_SOLUTION, EXIT_UNDECIDED
from bundle.cli.parser import add_input
from bundle.interface import check_defaults as defaults

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "check"
HELP = "validates the analytic Jacobians on this very problem, and names what is wrong"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of this command."""
    add_input(parser)
    group = parser.add_argument_group("options of the check")
    which = group.add_mutually_exclusive_group()
    which.add_argument(
        "--samples",
        metavar="N",
        type=int,
        default=defaults.SAMPLES_PER_IMAGE,
        help="observations to check of each image and its camera "
        f"(default: {defaults.SAMPLES_PER_IMAGE})",
    )
    which.add_argument("--all", action="store_true", help="check every observation")
    group.add_argument(
        "--seed", metavar="N", type=int, default=0, help="of the sampling (default: 0)"
    )
    group.add_argument(
        "--tolerance",
        metavar="X",
        type=float,
        default=defaults.TOLERANCE,
        help=f"relative error from which on an entry is wrong (default: {defaults.TOLERANCE:g})",
    )
    group.add_argument(
        "--threads",
        metavar="N",
        type=int,
        default=0,
        help="threads, at most one a core; 0: all cores (default: 0)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Check INPUT: 0 if all is correct, 1 if anything is wrong, 3 if that cannot be decided."""
    started = perf_counter()
    from bundle.checking.gradient_report import outcome
    from bundle.checking.jacobians import check_jacobians
    from bundle.cli.output import publish
    from bundle.cli.progress import Progress
    from bundle.cli.standard_streams import complain
    from bundle.errors import InputError, shown
    from bundle.io.open import load
    from bundle.reports.terminal.check import checked

    for flag, value, least in (("--samples", arguments.samples, 1), ("--seed", arguments.seed, 0)):
        if value < least:
            raise InputError(f"{flag}: expected at least {least}, found {value}")
    if arguments.threads < 0:
        raise InputError(f"--threads: expected at least 0, found {arguments.threads}")
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(arguments.input)}")
        problem = load(arguments.input)
        progress.stage("checking")
        report = check_jacobians(
            problem,
            samples_per_image=None if arguments.all else arguments.samples,
            seed=arguments.seed,
            tolerance=arguments.tolerance,
            num_threads=arguments.threads,
            progress=lambda done, total: progress.stage(f"checked {done} of {total} observations"),
        )
    options = {
        "samples_per_image": None if arguments.all else arguments.samples,
        "seed": arguments.seed,
        "tolerance": arguments.tolerance,
        "num_threads": arguments.threads,
    }
    wall = perf_counter() - started
    publish(checked(arguments.input, problem, report, options, wall), arguments.json)
    if report.ok:
        return EXIT_DONE
    if arguments.json == "-":  # the report that people read was not printed
        complain(outcome(report))
    return EXIT_UNDECIDED if report.verdict == "undecided" else EXIT_NO_SOLUTION
