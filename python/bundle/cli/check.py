"""`bundle check`."""

from __future__ import annotations

import argparse
from time import perf_counter

from bundle.checking.gradient_report import outcome
from bundle.checking.jacobians import check_problem
from bundle.cli.error_lines import EXIT_DONE, EXIT_NO_SOLUTION, EXIT_UNDECIDED
from bundle.cli.option_flags import options_given
from bundle.cli.output import publish
from bundle.cli.progress import Progress
from bundle.cli.standard_streams import complain
from bundle.errors import shown
from bundle.interface.analysis_options import CheckOptions
from bundle.io.open import load
from bundle.reports.terminal.check import checked


def run(arguments: argparse.Namespace) -> int:
    """Check INPUT; return 0 if all is correct, 1 if anything is wrong, 3 if undecided."""
    started = perf_counter()
    options = options_given(arguments, CheckOptions).asdict()
    if arguments.all:
        options["samples_per_image"] = None
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(arguments.input)}")
        problem = load(arguments.input)
        progress.stage("checking")
        report = check_problem(
            problem,
            **options,
            details=arguments.html is not None,
            progress=lambda done, total: progress.stage(f"checked {done} of {total} observations"),
        )
    if arguments.html is not None:
        from bundle.reports.page.check_page import write_check  # only for a page

        write_check(report, arguments.html, str(arguments.input))
    wall = perf_counter() - started
    publish(checked(arguments.input, problem, report, options, wall), arguments)
    if report.ok:
        return EXIT_DONE
    if arguments.json == "-":  # standard output has only the JSON report
        complain(outcome(report))
    return EXIT_UNDECIDED if report.verdict == "undecided" else EXIT_NO_SOLUTION
