"""`bundle inspect` of a reconstruction."""

from __future__ import annotations

import argparse
from time import perf_counter

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.option_flags import naming_flags, options_given, with_named_images
from bundle.cli.output import publish
from bundle.cli.progress import Progress
from bundle.errors import shown
from bundle.interface.options import PATTERN, SolveOptions
from bundle.interface.planning_options import GraphFileOptions, RankOptions
from bundle.io.open import load
from bundle.planning.inspection.problem_inspection import inspect
from bundle.planning.inspection.rank_prediction import predict_ranks
from bundle.reports.terminal.inspect import inspected


def run(arguments: argparse.Namespace) -> int:
    """Inspect the reconstruction INPUT."""
    started = perf_counter()
    processes = options_given(arguments, RankOptions)
    options_given(arguments, GraphFileOptions)
    options = options_given(arguments, SolveOptions, names_follow=True)
    counts, network = processes.counts(), processes.rate_and_latency()
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(arguments.input)}")
        problem = load(arguments.input, progress.text)
        options = with_named_images(options, arguments.fixed_image_ids, problem)
        progress.stage("inspecting")
        with naming_flags(SolveOptions):
            inspection = inspect(problem, options, recalibrate=arguments.recalibrate)
        with naming_flags(ranks="--ranks", network="--network"):
            ranks = predict_ranks(problem, inspection, options, counts=counts, network=network)
        if arguments.html is not None:
            from bundle.reports.page.inspection_page import write_inspection  # only for a page

            progress.stage(f"writing {shown(arguments.html)}")
            page, name = arguments.html, str(arguments.input)
            write_inspection(
                inspection, page, problem, options, name=name, ranks=ranks, network=network
            )
    wall = perf_counter() - started
    report = inspected(arguments.input, problem, inspection, options, PATTERN, ranks, network, wall)
    publish(report, arguments)
    return EXIT_DONE
