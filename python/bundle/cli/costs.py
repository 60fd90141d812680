"""`bundle inspect` and `bundle compare`: predicted and measured costs of solvers."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from bundle.cli.error_lines import EXIT_NO_SOLUTION
from bundle.cli.option_flags import naming_flags, options_given, with_named_images
from bundle.errors import InputError, shown
from bundle.interface.options import ORDERINGS, PATTERN, SolveOptions
from bundle.interface.planning_options import (
    COMPARED,
    CompareOptions,
    GraphFileOptions,
    RankOptions,
    ShapeOptions,
)
from bundle.reports.sections import Report

if TYPE_CHECKING:
    from bundle.cli.output import Progress
    from bundle.cli.run import Run
    from bundle.planning.comparison import work
    from bundle.planning.inspection.graph_inspection import GraphInspection


def inspect_model(run: Run) -> Report:
    """Inspect the reconstruction INPUT."""
    from bundle.planning.inspection.problem_inspection import inspect
    from bundle.planning.inspection.rank_prediction import predict_ranks
    from bundle.reports.terminal.inspect import inspected

    arguments = run.arguments
    processes = run.given(RankOptions)
    run.given(GraphFileOptions)
    options = run.given(SolveOptions)
    counts, network = processes.counts(), processes.rate_and_latency()
    problem = run.load()
    options = with_named_images(options, arguments.fixed_image_ids, problem)
    run.progress.stage("inspecting")
    with naming_flags(SolveOptions):
        inspection = inspect(problem, options, recalibrate=arguments.recalibrate)
    with naming_flags(ranks="--ranks", network="--network"):
        ranks = predict_ranks(problem, inspection, options, counts=counts, network=network)
    known = {"name": str(run.source), "ranks": ranks, "network": network}
    _write_inspection(run, inspection, problem, options, **known)
    return inspected(run.source, problem, inspection, options, PATTERN, ranks, network, run.wall)


def _write_inspection(run: Run, inspection: Any, *about: Any, **known: Any) -> None:
    if run.arguments.html is not None:
        from bundle.reports.page.inspection_page import write_inspection  # only for a page

        if about:
            run.progress.stage(f"writing {shown(run.arguments.html)}")
        write_inspection(inspection, run.arguments.html, *about, **known)


def inspect_shape(run: Run) -> Report:
    """Count the flops of a shape."""
    import bundle._core as _core
    from bundle.planning.inspection.peak_memory import count_schur, needs_of
    from bundle.reports.terminal.inspect import inspected_shape

    arguments = run.arguments
    run.given(RankOptions)
    run.given(GraphFileOptions)
    if arguments.input is not None:
        raise InputError("--shape: valid only without INPUT")
    _refuse(arguments, ("graph", "ranks", "html", *SolveOptions.names()), "without --shape")
    cameras, points, track = run.given(ShapeOptions).counts()
    counts = count_schur(cameras, points, track)
    shape = {"num_cameras": cameras, "num_points": points, "track_length": track}
    needs = needs_of(cameras, points, points * track, _core.available_memory())
    return inspected_shape(shape, counts, needs, run.wall)


def _refuse(arguments: argparse.Namespace, names: tuple[str, ...], valid: str) -> None:
    for name in names:
        if getattr(arguments, name, None) is not None:
            raise InputError(f"{arguments.flags[name]}: valid only {valid}")
    if arguments.recalibrate:
        raise InputError("--recalibrate: valid only with INPUT")


def inspect_graph_file(run: Run) -> Report:
    """Inspect the graph in a file."""
    from bundle.reports.terminal.inspect import inspected_steps

    arguments = run.arguments
    if (arguments.input is None) == (arguments.graph is None):
        found = "neither" if arguments.input is None else "both"
        raise InputError(f"expected INPUT or --graph FILE, found {found}")
    run.given(RankOptions)
    _refuse(arguments, ("ranks", *SolveOptions.names()), "with INPUT")
    graph = _eliminate(run.given(GraphFileOptions))
    _write_inspection(run, graph)
    return inspected_steps(arguments.graph, graph, run.wall)


def _eliminate(given: GraphFileOptions) -> GraphInspection:
    from bundle.planning.inspection.graph_inspection import inspect_graph, load_graph

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


def inspect_pose_graph(run: Run) -> Report:
    """Inspect the pose graph INPUT."""
    from bundle.interface.pose_graph_options import PoseGraphOptions
    from bundle.planning.inspection.problem_inspection import inspect
    from bundle.reports.terminal.graph_costs import inspected_graph

    arguments = run.arguments
    if run.given(RankOptions).ranks is not None:
        raise InputError("--ranks: expected a bundle adjustment problem, found a pose graph")
    threads = run.given(PoseGraphOptions).num_threads
    graph = run.load()
    run.progress.stage("inspecting")
    found = inspect(graph, num_threads=threads, recalibrate=arguments.recalibrate)
    if arguments.html is not None:
        from bundle.reports.page.graph_page import write_graph_structure

        run.progress.stage(f"writing {shown(arguments.html)}")
        write_graph_structure(found, graph, arguments.html, name=str(run.source))
    return inspected_graph(run.source, graph, found, run.wall)


def compare_models(run: Run) -> Report:
    """Compare methods on INPUT; the exit code is 0 if one has a usable solution."""
    from bundle.planning.comparison.compare_methods import compare
    from bundle.reports.terminal.compare import compared

    arguments = run.arguments
    options = options_given(arguments, SolveOptions)
    asked = run.given(CompareOptions)
    every = {"orderings": ORDERINGS} if arguments.orders == "all" else {}
    flags = {name: f"--{listed.replace('_', '-')}" for name, listed in COMPARED.items()}
    with naming_flags(**flags):
        found = compare(
            arguments.inputs,
            options,
            **{**asked.asdict(), "memory_cap": asked.memory_cap_in_bytes, **every},
            progress=lambda at: _show_progress(run.progress, at),
        )
    usable = any(one.is_usable for one in found.runs)
    run.end(0 if usable and not found.interrupted else EXIT_NO_SOLUTION)
    return compared(found)


def _show_progress(progress: Progress, at: work.Progress) -> None:
    if at.iteration is None:
        progress.stage(at.stage)
    elif progress.is_live:
        values = at.iteration
        progress.stage(f"{at.stage}: iter {values['iteration']}  cost {values['cost']:.4e}")


def compare_pose_graph(run: Run) -> Report:
    """Compare methods on the pose graph INPUT; the exit code is 0 if one can be recommended."""
    from bundle.interface.pose_graph_options import PoseGraphOptions
    from bundle.planning.comparison.graph_comparison import compare_graph
    from bundle.reports.terminal.graph_costs import compared_graph

    arguments = run.arguments
    if len(arguments.inputs) > 1:
        raise InputError(f"expected one INPUT with a pose graph, found {len(arguments.inputs)}")
    run.options = run.given(PoseGraphOptions)
    own = {name: getattr(arguments, name) for name in ("backends", "threads", "repeat", "timeout")}
    orders_only = arguments.orders == "all"
    run.source = arguments.inputs[0]
    graph = run.load()
    run.progress.stage("finding the start")
    with run.naming():
        found = compare_graph(
            graph,
            run.options,
            **{name: value for name, value in own.items() if value is not None},
            progress=run.progress.stage,
            orders_only=orders_only,
        )
    run.end(0 if found.recommended is not None else EXIT_NO_SOLUTION)
    return compared_graph(run.source, graph, found, run.asked, run.wall, orders_only)
