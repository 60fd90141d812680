"""`bundle inspect --graph`: step by step elimination of a small graph from a file."""

from __future__ import annotations

import argparse
from time import perf_counter

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.option_flags import options_given
from bundle.cli.output import publish
from bundle.errors import InputError, shown
from bundle.interface.options import SolveOptions
from bundle.interface.planning_options import GraphFileOptions, RankOptions
from bundle.planning.inspection.graph_inspection import GraphInspection, inspect_graph, load_graph
from bundle.reports.terminal.inspect_graph import inspected


def run(arguments: argparse.Namespace) -> int:
    """Inspect the graph in a file."""
    if (arguments.input is None) == (arguments.graph is None):
        found = "neither" if arguments.input is None else "both"
        raise InputError(f"expected INPUT or --graph FILE, found {found}")
    _refuse_flags_of_problems(arguments)
    started = perf_counter()
    given = options_given(arguments, GraphFileOptions)
    graph = _eliminate(given)
    if arguments.html is not None:
        from bundle.reports.page.inspection_page import write_inspection  # only for a page

        write_inspection(graph, arguments.html)
    publish(inspected(arguments.graph, graph, perf_counter() - started), arguments)
    return EXIT_DONE


def _refuse_flags_of_problems(arguments: argparse.Namespace) -> None:
    options_given(arguments, RankOptions)
    for name in ("ranks", *SolveOptions.names()):
        if getattr(arguments, name, None) is not None:
            raise InputError(f"{arguments.flags[name]}: valid only with INPUT")
    if arguments.recalibrate:
        raise InputError("--recalibrate: valid only with INPUT")


def _eliminate(given: GraphFileOptions) -> GraphInspection:
    if given.block_size < 1:
        raise InputError(f"--block-size: expected at least 1, found {given.block_size}")
    graph = load_graph(str(given.graph))
    landmarks = graph.landmarks
    if given.landmarks is not None:
        index = {name: variable for variable, name in enumerate(graph.names)}
        named = [name for name in given.landmarks.split(",") if name]
        for name in named:
            if name not in index:
                raise InputError(
                    f"--landmarks: expected variables of {shown(str(given.graph))}, found {name!r}"
                )
        landmarks = tuple(index[name] for name in named)
    return inspect_graph(
        graph.edges,
        names=graph.names,
        ordering=given.ordering,
        landmarks=landmarks,
        block_size=given.block_size,
    )
