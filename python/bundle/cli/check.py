"""`bundle check`: Jacobians of a model, of the edges of a pose graph, of a user's factors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bundle.checking.gradient_report import GradientReport
from bundle.checking.jacobians import check_problem
from bundle.cli.error_lines import EXIT_NO_SOLUTION, EXIT_UNDECIDED
from bundle.errors import InputError, brief, shown
from bundle.interface.analysis_options import CheckOptions
from bundle.reports.sections import Report

if TYPE_CHECKING:
    from bundle.cli.run import Run
    from bundle.graphs.factors.factor_report import FactorCheck


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
    from bundle.io.python_objects import load_object
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
    """Check what a user's file holds."""
    from bundle.graphs.factors.checks import check_edges, check_gradients
    from bundle.graphs.factors.factor_graph import FactorGraph
    from bundle.graphs.factors.factors import Factor
    from bundle.graphs.factors.problem_factors import check_factors
    from bundle.model.pose_graph_arrays import PoseGraph
    from bundle.model.problem import Problem

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
        from bundle.io.python_objects import user_error

        path = Path(source.rpartition(":")[0] or source)
        raise user_error(shown(source), error, path) from error


def _counting(run: Run, noun: str) -> Callable[[int], None]:
    return lambda done: run.progress.stage(f"checked {done} {noun}")


def _ended(run: Run, found: GradientReport | FactorCheck, report: Report) -> Report:
    if run.arguments.html is not None:
        from bundle.reports.page.result_pages import write_check  # only for a page

        write_check(found, run.arguments.html, str(run.source))
    if not found.ok:
        undecided = found.verdict == "undecided"
        run.end(EXIT_UNDECIDED if undecided else EXIT_NO_SOLUTION, report.headline[0])
    return report
