"""`bundle inspect`."""

from __future__ import annotations

import argparse
import dataclasses
from time import perf_counter
from typing import TYPE_CHECKING

from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.option_flags import (
    WHAT_IS_REFINED,
    add_options,
    naming_flags,
    options_given,
    with_named_images,
)
from bundle.cli.path_checks import a_path, page_path, reconstruction
from bundle.interface.options import GRAPH_ORDERINGS, SolveOptions
from bundle.io.recognition import is_pose_graph_file

if TYPE_CHECKING:
    from bundle.planning.inspection.graph_inspection import GraphInspection

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "inspect"
HELP = "what each way to solve a problem will cost: nonzeros, fill, flops, memory, time per step"

# What decides the pattern, and how many threads the times are for.
OPTIONS = (*WHAT_IS_REFINED, "gauge")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of this command."""
    parser.usage = "bundle inspect INPUT [options]\n       bundle inspect --graph FILE [options]"
    parser.add_argument(
        "input",
        metavar="INPUT",
        type=reconstruction,
        nargs="?",
        help="a BAL file (plain, .gz or .bz2) or the folder of a COLMAP model (binary or text) or "
        "a pose graph (g2o); told by its content",
    )
    parser.add_argument(
        "--html",
        metavar="FILE",
        type=page_path("report"),
        help="also write a page with pictures, which needs no network",
    )
    parser.add_argument(
        "--recalibrate",
        action="store_true",
        help="measure this machine's rates again, which takes seconds (default: once, then kept)",
    )
    add_options(parser, SolveOptions, "what is refined", OPTIONS)
    group = parser.add_argument_group("several processes (docs/mpi.md)")
    group.add_argument(
        "--ranks",
        metavar="LIST",
        help="predict `mpirun -n N bundle refine` for these N, such as 1,4,16,64,256 "
        "(default: none)",
    )
    group.add_argument(
        "--network",
        metavar="GBIT,US",
        help="between the processes: gigabits per second and microseconds of latency "
        "(default: 10,50)",
    )
    group = parser.add_argument_group("a graph in place of a problem")
    orderings = [name.replace("_", "-") for name in GRAPH_ORDERINGS]
    group.add_argument(
        "--graph",
        metavar="FILE",
        type=a_path,
        help="eliminate a small graph step by step: an edge a line, two names; # begins a comment",
    )
    group.add_argument(
        "--ordering",
        metavar="ORDERING",
        type=lambda text: text.lower().replace("_", "-"),
        choices=orderings,
        help=f"of the graph: one of {', '.join(orderings)} (default: natural)",
    )
    group.add_argument(
        "--landmarks",
        metavar="NAMES",
        help="variables that landmarks-first eliminates first, such as l1,l2 "
        "(default: those whose names are an l and a number)",
    )
    group.add_argument(
        "--block-size",
        metavar="N",
        type=int,
        help="scalars of each variable, such as 6 for poses (default: 1)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Inspect INPUT or a graph."""
    from bundle.errors import InputError

    if (arguments.input is None) == (arguments.graph is None):
        found = "neither" if arguments.input is None else "both"
        raise InputError(f"expected INPUT or --graph FILE, found {found}")
    if arguments.network is not None and arguments.ranks is None:
        raise InputError("--network: expected with --ranks only")
    if arguments.ranks is not None and arguments.graph is not None:
        raise InputError("--ranks: expected with INPUT only")
    if arguments.graph is not None:
        for field in dataclasses.fields(SolveOptions):
            if getattr(arguments, field.name, None) is not None:
                raise InputError(f"{field.metadata['flag']}: expected with INPUT only")
        if arguments.recalibrate:
            raise InputError("--recalibrate: expected with INPUT only")
        return _inspect_graph(arguments)
    if is_pose_graph_file(arguments.input):
        if arguments.ranks is not None:
            raise InputError("--ranks: expected a bundle adjustment problem, found a pose graph")
        from bundle.cli.pose_graph_costs import inspect_graph_file

        return inspect_graph_file(arguments)
    for flag in ("ordering", "landmarks", "block_size"):
        if getattr(arguments, flag) is not None:
            raise InputError(f"--{flag.replace('_', '-')}: expected with --graph only")
    return _inspect_problem(arguments)


def _inspect_problem(arguments: argparse.Namespace) -> int:
    started = perf_counter()
    from bundle.cli.output import publish
    from bundle.cli.progress import Progress
    from bundle.errors import shown
    from bundle.io.open import load
    from bundle.planning.inspection.problem_inspection import inspect
    from bundle.planning.inspection.rank_prediction import predict_ranks
    from bundle.reports.terminal.inspect import inspected

    options = options_given(arguments, SolveOptions, names_follow=True)
    counts, network = _processes_given(arguments)
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(arguments.input)}")
        problem = load(arguments.input, progress.text)
        options = with_named_images(options, arguments, problem)
        progress.stage("inspecting")
        with naming_flags(SolveOptions):
            inspection = inspect(problem, options, recalibrate=arguments.recalibrate)
        with naming_flags(ranks="--ranks", network="--network"):
            ranks = predict_ranks(problem, inspection, options, counts=counts, network=network)
        if arguments.html is not None:
            from bundle.reports.page.inspection_page import write_inspection

            progress.stage(f"writing {shown(arguments.html)}")
            page, name = arguments.html, str(arguments.input)
            write_inspection(
                inspection, page, problem, options, name=name, ranks=ranks, network=network
            )
    wall = perf_counter() - started
    report = inspected(arguments.input, problem, inspection, options, OPTIONS, ranks, network, wall)
    publish(report, arguments.json)
    return EXIT_DONE


def _processes_given(arguments: argparse.Namespace) -> tuple[list[int], tuple[float, float]]:
    """Return numbers of processes, and the network between them."""
    from bundle.errors import InputError
    from bundle.planning.inspection.rank_prediction import NETWORK

    try:
        counts = [] if arguments.ranks is None else [int(n) for n in arguments.ranks.split(",")]
    except ValueError:
        raise InputError(
            f"--ranks: expected numbers of processes such as 1,4,16, found {arguments.ranks}"
        ) from None
    if arguments.network is None:
        return counts, NETWORK
    try:
        rate, latency = (float(number) for number in arguments.network.split(","))
    except ValueError:
        raise InputError(
            "--network: expected gigabits per second and microseconds such as 10,50, "
            f"found {arguments.network}"
        ) from None
    return counts, (rate, latency)


def _inspect_graph(arguments: argparse.Namespace) -> int:
    started = perf_counter()
    from bundle.cli.output import publish
    from bundle.reports.terminal.inspect_graph import inspected

    graph = _eliminate(arguments)
    if arguments.html is not None:
        from bundle.reports.page.inspection_page import write_inspection

        write_inspection(graph, arguments.html)
    publish(inspected(arguments.graph, graph, perf_counter() - started), arguments.json)
    return EXIT_DONE


def _eliminate(arguments: argparse.Namespace) -> GraphInspection:
    from bundle.errors import InputError, shown
    from bundle.planning.inspection.graph_input import load_graph
    from bundle.planning.inspection.graph_inspection import inspect_graph

    if arguments.block_size is not None and arguments.block_size < 1:
        raise InputError(f"--block-size: expected at least 1, found {arguments.block_size}")
    graph = load_graph(arguments.graph)
    landmarks = graph.landmarks
    if arguments.landmarks is not None:
        index = {name: variable for variable, name in enumerate(graph.names)}
        named = [name for name in arguments.landmarks.split(",") if name]
        for name in named:
            if name not in index:
                raise InputError(
                    f"--landmarks: expected variables of {shown(arguments.graph)}, found {name!r}"
                )
        landmarks = tuple(index[name] for name in named)
    return inspect_graph(
        graph.edges,
        names=graph.names,
        ordering=arguments.ordering or "natural",
        landmarks=landmarks,
        block_size=1 if arguments.block_size is None else arguments.block_size,
    )
