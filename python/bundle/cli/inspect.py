"""`bundle inspect` of a reconstruction, of numbers, of a small graph from a file."""

from __future__ import annotations

import argparse
from time import perf_counter

import bundle._core as _core
from bundle.cli.error_lines import EXIT_DONE
from bundle.cli.option_flags import naming_flags, options_given, with_named_images
from bundle.cli.output import publish
from bundle.cli.progress import Progress
from bundle.errors import InputError, shown
from bundle.interface.options import PATTERN, SolveOptions
from bundle.interface.planning_options import GraphFileOptions, RankOptions, ShapeOptions
from bundle.io.open import load
from bundle.planning.inspection.graph_inspection import GraphInspection, inspect_graph, load_graph
from bundle.planning.inspection.problem_inspection import inspect
from bundle.planning.inspection.problem_needs import count_schur, needs_of
from bundle.planning.inspection.rank_prediction import predict_ranks
from bundle.reports.terminal.inspect import inspected, inspected_shape, inspected_steps


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


def run_numbers(arguments: argparse.Namespace) -> int:
    """Count the flops of a shape."""
    started = perf_counter()
    _refuse_other_inputs(arguments)
    cameras, points, track = options_given(arguments, ShapeOptions).counts()
    counts = count_schur(cameras, points, track)
    shape = {"num_cameras": cameras, "num_points": points, "track_length": track}
    needs = needs_of(cameras, points, points * track, _core.available_memory())
    publish(inspected_shape(shape, counts, needs, perf_counter() - started), arguments)
    return EXIT_DONE


def _refuse_other_inputs(arguments: argparse.Namespace) -> None:
    options_given(arguments, RankOptions)
    options_given(arguments, GraphFileOptions)
    if arguments.input is not None:
        raise InputError("--shape: valid only without INPUT")
    for name in ("graph", "ranks", "html", *SolveOptions.names()):
        if getattr(arguments, name, None) is not None:
            raise InputError(f"{arguments.flags[name]}: valid only without --shape")
    if arguments.recalibrate:
        raise InputError("--recalibrate: valid only with INPUT")


def run_graph_file(arguments: argparse.Namespace) -> int:
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
    publish(inspected_steps(arguments.graph, graph, perf_counter() - started), arguments)
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
