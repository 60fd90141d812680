"""``save_report``: the JSON report of a solve in Python, for ``bundle triage``."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bundle.base.arrays import check_type
from bundle.base.paths import as_path
from bundle.graphs.factors.factor_graph import GraphResult
from bundle.graphs.pose_graphs.edge_weights import densest_set
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.interface.environment import Environment
from bundle.interface.solve_record import SolveRecord
from bundle.io.atomic import atomic_write as atomic
from bundle.model.content_digests import content_digests
from bundle.reports.sections import Report, dumps, records
from bundle.reports.terminal.inputs import about_input
from bundle.reports.terminal.solve_data import solve_options
from bundle.solving.result import Result


def save_report(result: SolveRecord, path: str | os.PathLike[str], *, name: str = "") -> None:
    """Write the JSON report of a solve: input, options, summary, iterations, environment.

    :func:`bundle.triage` compares two such files, or one with that of ``bundle refine --json``.

    Args:
        result: result of :func:`bundle.solve` or :meth:`bundle.FactorGraph.solve`.
        path: path of the file.
        name: name of the input; two reports of one input have the same.

    Raises:
        InputError: ``result`` is not a result of a solve.
        OSError: the file cannot be written.
    """
    check_type("result", result, SolveRecord)
    about, structure = _about(result, name)
    report = Report(
        command="refine",
        input=about,
        headline=[result.outcome],
        warnings=result.summary.warnings,
        data={
            "options": solve_options(result.options),
            "summary": result.summary,
            "iterations": records(result.iterations),
            "structure": structure,
            "environment": Environment.now().finished(),
        },
    )
    atomic.write_text(Path(as_path(path)), dumps(report.json()))


def _about(result: SolveRecord, name: str) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Return the JSON entries of the input, and facts on the structure of its matrix."""
    if isinstance(result, PoseGraphResult):
        graph = result.initial_problem
        about = about_input(name or graph.path, graph) | {"digests": content_digests(graph)}
        return about, {"densest": densest_set(graph.edges)}
    if isinstance(result, Result):
        given = result.initial_problem
        return about_input(name, given) | {"digests": content_digests(given)}, {}
    assert isinstance(result, GraphResult)
    summary = result.summary
    counts = {"num_variables": len(result.values), "num_factors": summary.num_residual_blocks}
    return {"path": name, "format": "factor graph", **counts}, {}
