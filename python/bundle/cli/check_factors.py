"""`bundle check` of the edges of a pose graph, and of factors in a Python file."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import Any

from bundle.checking.gradient_report import GradientReport
from bundle.checking.jacobians import check_problem
from bundle.cli.error_lines import EXIT_DONE, EXIT_NO_SOLUTION, EXIT_UNDECIDED
from bundle.cli.flags_by_kind import refuse_flags_of_reconstructions
from bundle.cli.option_flags import options_given
from bundle.cli.output import publish
from bundle.cli.progress import Progress
from bundle.cli.standard_streams import complain
from bundle.errors import InputError, brief, shown
from bundle.graphs.factors.checks import check_edges, check_gradients
from bundle.graphs.factors.factor_graph import FactorGraph
from bundle.graphs.factors.factor_report import FactorCheck
from bundle.graphs.factors.factors import Factor
from bundle.graphs.factors.problem_factors import check_factors
from bundle.interface.analysis_options import CheckOptions
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.io.g2o_files import load_g2o
from bundle.io.python_objects import load_object, user_error
from bundle.io.recognition import Kind
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem
from bundle.reports.sections import Report
from bundle.reports.terminal.check import checked_factors, checked_function
from bundle.reports.terminal.inputs import about_graph, graph_facts

FLAGS = ("samples_per_image", "all", "seed", "tolerance", "num_threads", "html")


def check_edges_of_file(arguments: argparse.Namespace) -> int:
    """Check the edges of the pose graph INPUT."""
    started = perf_counter()
    refuse_flags_of_reconstructions(arguments, (*FLAGS, "error"))
    settings = _settings(arguments)
    error = options_given(arguments, PoseGraphOptions).error
    source = arguments.input
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        graph = load_g2o(source)
        progress.stage("checking")
        found = check_edges(graph, error, progress=_counting(progress, "edges"), **settings)
    report = checked_factors(
        about_graph(source, graph),
        graph_facts(source, graph),
        found,
        {**settings, "error": error},
        perf_counter() - started,
    )
    return _publish(report, found, arguments)


def check_object(arguments: argparse.Namespace) -> int:
    """Check the factors of the object that INPUT, FILE.py:NAME, names."""
    started = perf_counter()
    refuse_flags_of_reconstructions(arguments, FLAGS, Kind.PYTHON)
    settings = _settings(arguments)
    source = arguments.input
    with Progress(quiet=arguments.quiet) as progress, _naming(source):
        progress.stage(f"running {shown(source)}")
        thing = load_object(source)
        progress.stage("checking")
        found = _check(source, thing, settings, _counting(progress, "factors"))
    wall = perf_counter() - started
    facts = [("input", f"{shown(source)} (Python)")]
    about = {"path": source, "format": "python"}
    if isinstance(found, GradientReport):
        report = checked_function(about, facts, found, settings, wall)
    else:
        report = checked_factors(about, facts, found, settings, wall)
    return _publish(report, found, arguments)


def _settings(arguments: argparse.Namespace) -> dict[str, Any]:
    options = options_given(arguments, CheckOptions)
    most = None if arguments.all else options.samples_per_image
    return {
        "most_of_a_kind": most,
        "seed": options.seed,
        "tolerance": options.tolerance,
        "details": arguments.html is not None,
    }


def _check(
    source: str, thing: Any, settings: dict[str, Any], progress: Callable[[int], None]
) -> GradientReport | FactorCheck:
    """Check what a user's file holds."""
    most = settings["most_of_a_kind"]
    each = {name: settings[name] for name in ("seed", "tolerance", "details")}
    if isinstance(thing, FactorGraph):
        return thing.check_gradients(progress=progress, **settings)
    if isinstance(thing, PoseGraph):
        return check_edges(thing, progress=progress, **settings)
    if isinstance(thing, Problem):
        return check_problem(thing, samples_per_image=most, **each)
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
        path = Path(source.rpartition(":")[0] or source)
        raise user_error(shown(source), error, path) from error


def _counting(progress: Progress, noun: str) -> Callable[[int], None]:
    return lambda done: progress.stage(f"checked {done} {noun}")


def _publish(
    report: Report, found: GradientReport | FactorCheck, arguments: argparse.Namespace
) -> int:
    if arguments.html is not None:
        from bundle.reports.page.check_page import write_check  # only for a page

        write_check(found, arguments.html, str(arguments.input))
    publish(report, arguments)
    if found.ok:
        return EXIT_DONE
    if arguments.json == "-":  # standard output has only the JSON report
        complain(report.headline[0])
    return EXIT_UNDECIDED if found.verdict == "undecided" else EXIT_NO_SOLUTION
