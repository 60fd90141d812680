"""Pages of results: the sections of their reports with all details, and figures."""

from __future__ import annotations

import os
from collections.abc import Sequence
from html import escape

from bundle.base.arrays import check_type
from bundle.base.paths import as_path
from bundle.errors import InputError, brief
from bundle.judging.evaluation.check_points import CheckPointEvaluation
from bundle.judging.evaluation.evaluation_result import Evaluation
from bundle.planning.comparison.comparison_result import Comparison
from bundle.planning.comparison.graph_comparison import GraphComparison
from bundle.reports.page.page import tag, write_page
from bundle.reports.page.table import findings_list, rendered
from bundle.reports.sections import Report
from bundle.reports.terminal.compare import compared
from bundle.reports.terminal.evaluate import evaluated
from bundle.reports.terminal.graph_costs import compared_runs


def write_reported(report: Report, path: str | os.PathLike[str]) -> None:
    """Write a report as one self-contained HTML file.

    Raises:
        InputError: the path is a folder, or a path above it is no folder.
        OSError: the file cannot be written.
    """
    headline, *more = report.headline or [report.title]
    sections = [tag("p", escape(sentence)) for sentence in more]
    sections += [tag("p", escape(sentence), class_="warn") for sentence in report.warnings]
    sections += [findings_list(report.findings), *rendered(report.sections)]
    write_page(as_path(path), report.title, sections, headline=headline)


def write_evaluation(
    found: Evaluation | CheckPointEvaluation,
    path: str | os.PathLike[str],
    *,
    names: Sequence[str] = ("A", "B"),
) -> None:
    """Write one self-contained HTML page about a comparison with a reference.

    Args:
        found: result of :func:`bundle.evaluate`.
        path: path of the page. A failed write leaves no partial file.
        names: names of A and of the reference B, for the title.

    Raises:
        InputError: ``found`` is not an evaluation, or the path cannot hold a page.
        OSError: the page cannot be written.
    """
    if not isinstance(found, Evaluation | CheckPointEvaluation):
        raise InputError(f"found: expected a result of bundle.evaluate, found {brief(found)}")
    for name in names:
        check_type("names", name, str)
    write_reported(evaluated((names[0], names[1]), found), path)


def write_comparison(
    comparison: Comparison | GraphComparison, path: str | os.PathLike[str]
) -> None:
    """Write a comparison of a problem or of a graph as one self-contained HTML file.

    Raises:
        InputError: the path is a folder, or a path above it is no folder.
        OSError: the file cannot be written.
    """
    if isinstance(comparison, GraphComparison):
        return write_reported(compared_runs(comparison, "a graph"), path)
    check_type("comparison", comparison, Comparison)
    return write_reported(compared(comparison), path)
