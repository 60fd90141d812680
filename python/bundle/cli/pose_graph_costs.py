"""What `bundle inspect` and `bundle compare` do with a pose graph."""

from __future__ import annotations

import argparse
from time import perf_counter
from typing import Any

from bundle.cli.error_lines import EXIT_DONE, EXIT_NO_SOLUTION
from bundle.cli.option_flags import naming_flags, options_given
from bundle.cli.pose_graph_flags import refuse_flags_of_reconstructions
from bundle.errors import InputError
from bundle.interface import compare_defaults as defaults
from bundle.interface.pose_graph_options import PoseGraphOptions

__all__ = ["compare_graph_file", "inspect_graph_file"]

OPTIONS = (
    *("error", "init", "information", "loss", "loss_scale", "loss_on", "max_num_iterations"),
    *("function_tolerance", "gradient_tolerance", "parameter_tolerance"),
)
"""Of every solve that is compared."""


def inspect_graph_file(arguments: argparse.Namespace) -> int:
    """Inspect the pose graph INPUT."""
    started = perf_counter()
    from bundle.cli.output import publish
    from bundle.cli.progress import Progress
    from bundle.errors import shown
    from bundle.io.g2o_files import load_g2o
    from bundle.planning.inspection.problem_inspection import inspect
    from bundle.reports.terminal.graph_costs import inspected_graph

    refuse_flags_of_reconstructions(arguments, ("num_threads",))
    source = arguments.input
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        graph = load_g2o(source)
        progress.stage("inspecting")
        found = inspect(graph)
    wall = perf_counter() - started
    publish(inspected_graph(source, graph, found, wall), arguments.json)
    return EXIT_DONE


def compare_graph_file(arguments: argparse.Namespace) -> int:
    """Compare methods on the pose graph INPUT: 0 if one can be recommended."""
    started = perf_counter()
    from bundle.cli.output import publish
    from bundle.cli.progress import Progress
    from bundle.errors import shown
    from bundle.io.g2o_files import load_g2o
    from bundle.planning.comparison.compare_methods import compare
    from bundle.reports.terminal.graph_costs import compared_graph

    if len(arguments.inputs) > 1:
        raise InputError(f"expected one INPUT with a pose graph, found {len(arguments.inputs)}")
    own = ("inputs", "backends", "threads", "repeat", "timeout")
    refuse_flags_of_reconstructions(_without_defaults(arguments), (*OPTIONS, *own))
    options = options_given(arguments, PoseGraphOptions)
    source = arguments.inputs[0]
    flags = {name: f"--{name}" for name in ("backends", "threads", "repeat", "timeout")}
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        graph = load_g2o(source)
        progress.stage("finding the start")
        with naming_flags(PoseGraphOptions, **flags):
            found = compare(
                graph,
                options,
                backends=arguments.backends,
                threads=arguments.threads,
                repeat=arguments.repeat,
                timeout=arguments.timeout,
                progress=progress.stage,
            )
    asked = {name: getattr(options, name) for name in OPTIONS}
    wall = perf_counter() - started
    publish(compared_graph(source, found, asked, wall), arguments.json)
    return EXIT_DONE if found.recommended is not None else EXIT_NO_SOLUTION


def _without_defaults(arguments: argparse.Namespace) -> argparse.Namespace:
    """Return the arguments without those that only reconstructions have, where not given."""
    values: dict[str, Any] = dict(vars(arguments))
    for name, default in (
        ("solvers", defaults.SOLVERS),
        ("preconditioners", defaults.PRECONDITIONERS),
        ("orderings", defaults.ORDERINGS),
    ):
        if values[name] == default:
            values[name] = None
    return argparse.Namespace(**values)
