"""`bundle report` of a pose graph."""

from __future__ import annotations

import argparse
from time import perf_counter

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.flags_by_kind import refuse_flags_of_reconstructions
from bundle.cli.output import publish
from bundle.cli.progress import Progress
from bundle.errors import InputError, shown
from bundle.io.g2o_files import load_g2o
from bundle.reports.page.graph_report import write_graph_report
from bundle.reports.terminal.report import reported_graph


def run(arguments: argparse.Namespace) -> int:
    """Write the report page of the pose graph INPUT."""
    started = perf_counter()
    refuse_flags_of_reconstructions(arguments)
    source, page = arguments.input, arguments.output
    if page == "-":
        raise InputError("--output: expected a file for the page, found -")
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        graph = load_g2o(source)
        progress.stage(f"writing {shown(page)}")
        findings = write_graph_report(graph, page, name=str(source))
    wall = perf_counter() - started
    publish(reported_graph(source, graph, page, wall, findings), arguments)
    return EXIT_DONE
