"""`bundle report`: a page on a reconstruction or a pose graph."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bundle.errors import InputError, shown
from bundle.interface.finding import one_list
from bundle.interface.options import SolveOptions
from bundle.io.georeference_file import owner_of, path_beside
from bundle.reports.sections import Report

if TYPE_CHECKING:
    from bundle.analysis.uncertainty.covariance_result import Covariance
    from bundle.cli.run import Run
    from bundle.model.problem import Problem


def report_model(run: Run) -> Report:
    """Write the page of the reconstruction INPUT."""
    from bundle.analysis.statistics.description import describe
    from bundle.reports.page.report_page import write_report
    from bundle.reports.terminal.outputs import reported

    source, page = str(run.source), _page(run)
    run.check_knowledge(SolveOptions().refine, page=True)
    run.open()
    place, lost = placed(source)
    with run.naming():
        run.progress.stage("computing the covariance")
        certainty = _covariance(run)
        run.judge(covariance=certainty)
        found = one_list(describe(run.input).suspicions, run.findings)
        run.progress.stage(f"writing {shown(page)}")
        notes = write_report(
            run.input,
            page,
            images=run.arguments.images,
            georeference=place,
            covariance=certainty,
            priors=run.priors,
            constraints=run.constraints,
            findings=found,
            name=source,
        )
    return reported(source, run.input, page, (*lost, *notes), run.wall, found)


def _page(run: Run) -> str:
    if run.target == "-":
        raise InputError("--output: expected a file for the page, found -")
    return run.target


def placed(source: str) -> tuple[dict[str, Any] | None, tuple[str, ...]]:
    """Return the content of the georeference.json that `bundle refine` wrote, if it exists.

    The second value has a sentence if the file has other content.
    """
    is_folder = Path(source).is_dir()
    path = path_beside(Path(source), is_folder=is_folder)
    of_it = owner_of(path) in (None, "" if is_folder else Path(source).name)
    if not path.is_file() or not of_it:
        return None, ()
    try:
        found = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        found = None
    if not isinstance(found, dict) or not {"gps", "gcps", "reference_system"} <= found.keys():
        return None, (f"{shown(str(path))} was not written by bundle refine: left out.",)
    return found, ()


def _covariance(run: Run) -> Covariance | None:
    """Return the covariance; None if it does not exist, as the page explains."""
    from bundle.analysis.uncertainty.covariance_by_input import covariance

    problem: Problem = run.input
    try:
        return covariance(problem, priors=run.priors, constraints=run.constraints, scale="sigma0")
    except InputError:
        return None


def report_pose_graph(run: Run) -> Report:
    """Write the page of the pose graph INPUT."""
    from bundle.reports.page.graph_report import write_graph_report
    from bundle.reports.terminal.outputs import reported

    page = _page(run)
    graph = run.load()
    findings = run.write(page, lambda path: write_graph_report(graph, path, name=str(run.source)))
    return reported(str(run.source), graph, page, (), run.wall, findings)
