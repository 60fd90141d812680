"""`bundle inspect` and `bundle compare` of a pose graph."""

from __future__ import annotations

import argparse
from time import perf_counter

from bundle.cli.error_lines import EXIT_DONE, EXIT_NO_SOLUTION
from bundle.cli.flags_by_kind import refuse_flags_of_reconstructions
from bundle.cli.option_flags import naming_flags, options_given
from bundle.cli.output import publish
from bundle.cli.progress import Progress
from bundle.errors import InputError, shown
from bundle.interface.planning_options import RankOptions
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.io.g2o_files import load_g2o
from bundle.planning.comparison.graph_comparison import compare_graph as compare_graph_methods
from bundle.planning.inspection.problem_inspection import inspect
from bundle.reports.terminal.graph_costs import compared_graph, inspected_graph

OPTIONS = (
    *("error", "init", "information", "loss", "loss_scale", "loss_on", "max_num_iterations"),
    *("function_tolerance", "gradient_tolerance", "parameter_tolerance"),
)
"""Options of every compared solve."""


def inspect_graph(arguments: argparse.Namespace) -> int:
    """Inspect the pose graph INPUT."""
    started = perf_counter()
    if options_given(arguments, RankOptions).ranks is not None:
        raise InputError("--ranks: expected a bundle adjustment problem, found a pose graph")
    refuse_flags_of_reconstructions(arguments, ("num_threads", "recalibrate", "html"))
    threads = options_given(arguments, PoseGraphOptions).num_threads
    source = arguments.input
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        graph = load_g2o(source)
        progress.stage("inspecting")
        found = inspect(graph, num_threads=threads, recalibrate=arguments.recalibrate)
        if arguments.html is not None:
            from bundle.reports.page.graph_page import write_graph_structure

            progress.stage(f"writing {shown(arguments.html)}")
            write_graph_structure(found, graph, arguments.html, name=str(source))
    wall = perf_counter() - started
    publish(inspected_graph(source, graph, found, wall), arguments)
    return EXIT_DONE


def compare_graph(arguments: argparse.Namespace) -> int:
    """Compare methods on the pose graph INPUT; return 0 if one can be recommended."""
    started = perf_counter()
    if len(arguments.inputs) > 1:
        raise InputError(f"expected one INPUT with a pose graph, found {len(arguments.inputs)}")
    own = ("backends", "threads", "repeat", "timeout")
    refuse_flags_of_reconstructions(arguments, (*OPTIONS, *own, "orders", "html"))
    orders_only = arguments.orders == "all"
    options = options_given(arguments, PoseGraphOptions)
    given = {name: getattr(arguments, name) for name in own}
    source = arguments.inputs[0]
    flags = {name: f"--{name}" for name in own}
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        graph = load_g2o(source)
        progress.stage("finding the start")
        with naming_flags(PoseGraphOptions, **flags):
            found = compare_graph_methods(
                graph,
                options,
                **{name: value for name, value in given.items() if value is not None},
                progress=progress.stage,
                orders_only=orders_only,
            )
    asked = {name: getattr(options, name) for name in OPTIONS}
    wall = perf_counter() - started
    publish(compared_graph(source, graph, found, asked, wall, orders_only), arguments)
    return EXIT_DONE if found.recommended is not None else EXIT_NO_SOLUTION
