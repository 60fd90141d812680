"""`bundle inspect`, `compare` and `check`: costs of solvers, and their Jacobians."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bundle.checking.gradient_report import GradientReport
from bundle.checking.jacobians import check_problem
from bundle.cli.error_lines import EXIT_NO_SOLUTION, EXIT_UNDECIDED, complain
from bundle.cli.option_flags import naming_flags, options_given, with_named_images
from bundle.errors import InputError, brief, shown
from bundle.interface.analysis_options import CheckOptions
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
    from bundle.graphs.factors.factor_report import FactorCheck
    from bundle.planning.comparison import work
    from bundle.planning.inspection.graph_inspection import GraphInspection


# `bundle check`: Jacobians of a model, of the edges of a pose graph, of a user's factors.


def check_model(run: Run) -> Report:
    """Check INPUT; the exit code is 0 if all is correct, 1 if anything is wrong, 3 undecided."""
    from bundle.reports.terminal.analyses import checked

    options = run.given(CheckOptions).asdict()
    if run.arguments.all:
        options["samples_per_image"] = None
    problem = run.load()
    run.progress.stage("checking")
    found = check_problem(
        problem,
        **options,
        details=run.arguments.html is not None,
        progress=lambda done, of: run.progress.stage(f"checked {done} of {of} observations"),
    )
    return _ended(run, found, checked(run.source, problem, found, options, run.wall))


def check_pose_graph(run: Run) -> Report:
    """Check the edges of the pose graph INPUT."""
    from bundle.graphs.factors.checks import check_edges
    from bundle.interface.pose_graph_options import PoseGraphOptions
    from bundle.reports.terminal.analyses import checked

    settings = _settings(run)
    error = run.given(PoseGraphOptions).error
    graph = run.load()
    run.progress.stage("checking")
    found = check_edges(graph, error, progress=_counting(run, "edges"), **settings)
    asked = {**settings, "error": error}
    return _ended(run, found, checked(run.source, graph, found, asked, run.wall))


def check_object(run: Run) -> Report:
    """Check the factors of the object that INPUT, FILE.py:NAME, names."""
    from bundle.io.recognition import load_object
    from bundle.reports.terminal.analyses import checked

    settings, source = _settings(run), run.source
    with _naming(source):
        run.progress.stage(f"running {shown(source)}")
        thing = load_object(source)
        run.progress.stage("checking")
        found = _check(source, thing, settings, _counting(run, "factors"))
    return _ended(run, found, checked(source, None, found, settings, run.wall))


def _settings(run: Run) -> dict[str, Any]:
    options = run.given(CheckOptions)
    return {
        "most_of_a_kind": None if run.arguments.all else options.samples_per_image,
        "seed": options.seed,
        "tolerance": options.tolerance,
        "details": run.arguments.html is not None,
    }


def _check(
    source: str, thing: Any, settings: dict[str, Any], progress: Callable[[int], None]
) -> GradientReport | FactorCheck:
    """Check the object of a user's file."""
    from bundle.graphs.factors.checks import check_edges, check_gradients
    from bundle.graphs.factors.factor_graph import FactorGraph
    from bundle.graphs.factors.factors import Factor
    from bundle.graphs.factors.problem_factors import check_factors
    from bundle.model.pose_graph_arrays import PoseGraph
    from bundle.model.problem import Problem

    each = {name: settings[name] for name in ("seed", "tolerance", "details")}
    if isinstance(thing, FactorGraph):
        return thing.check_gradients(progress=progress, **settings)
    if isinstance(thing, PoseGraph):
        return check_edges(thing, progress=progress, **settings)
    if isinstance(thing, Problem):
        return check_problem(thing, samples_per_image=settings["most_of_a_kind"], **each)
    if isinstance(thing, tuple) and 2 <= len(thing) <= 3:
        first, *others = thing
        if isinstance(first, Problem):
            return check_factors(first, *others, **each)
        if callable(first) or isinstance(first, Factor):
            return check_gradients(first, *others, **each)
    raise InputError(
        f"{shown(source)}: expected a FactorGraph, (function, blocks, manifolds), (factor, "
        f"values, manifolds) or (problem, factors), or a function that returns one, "
        f"found {brief(thing)}"
    )


@contextmanager
def _naming(source: str) -> Iterator[None]:
    """Report an exception of a user's function as one line."""
    try:
        yield
    except (InputError, OSError, MemoryError):
        raise
    except Exception as error:
        from bundle.io.recognition import user_error

        path = Path(source.rpartition(":")[0] or source)
        raise user_error(shown(source), error, path) from error


def _counting(run: Run, noun: str) -> Callable[[int], None]:
    return lambda done: run.progress.stage(f"checked {done} {noun}")


def _ended(run: Run, found: GradientReport | FactorCheck, report: Report) -> Report:
    run.page("reports.page.result_pages:write_check", found, str(run.source))
    if not found.ok:
        undecided = found.verdict == "undecided"
        run.end(EXIT_UNDECIDED if undecided else EXIT_NO_SOLUTION, report.headline[0])
    return report


INSPECTION_PAGE = "reports.page.inspection_page:write_inspection"


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
    run.page(INSPECTION_PAGE, inspection, problem, options, **known)
    return inspected(run.source, problem, inspection, options, PATTERN, ranks, network, run.wall)


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
    run.page(INSPECTION_PAGE, graph)
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
    run.page("reports.page.graph_page:write_graph_structure", found, graph, name=str(run.source))
    return inspected_graph(run.source, graph, found, run.wall)


def compare_models(run: Run) -> Report:
    """Compare methods on INPUT; the exit code is 0 if one has a usable solution."""
    from bundle.planning.comparison.compare_methods import compare
    from bundle.reports.terminal.compare import compared

    arguments = run.arguments
    options = options_given(arguments, SolveOptions)
    asked = run.given(CompareOptions)
    every = {"orderings": ORDERINGS} if arguments.orders == "all" else {}
    if len(arguments.inputs) == 2 and not arguments.quiet:
        a, b = map(shlex.quote, arguments.inputs)
        complain(f"note: for the differences of two models: bundle evaluate {a} --reference {b}")
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
