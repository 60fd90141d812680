"""Page of a check of Jacobians: wrong entries, by how much, and against the step size."""

from __future__ import annotations

import os
from collections.abc import Iterator
from html import escape

import numpy as np

from bundle.base.paths import as_path
from bundle.checking import gradient_report
from bundle.checking.gradient_report import GradientReport, Offender
from bundle.checking.step_curve import CheckDetails
from bundle.errors import InputError, brief
from bundle.figures.evaluation_figures import step_figure
from bundle.graphs.factors import factor_report
from bundle.graphs.factors.factor_report import FactorCheck
from bundle.reports.page.page import heading, tag, write_page
from bundle.reports.page.svg import grid
from bundle.reports.page.table import table

MOST_COLUMNS = 24
"""Number of columns of a map of errors; further right columns are left out."""
MOST_ROWS = 40
MOST_FACTORS = 5
"""Number of factors with a map and curves, one per finding."""

READING = (
    "Each curve is the distance of the central difference D(h) = (r(x + h) - r(x - h)) / 2h, "
    "relative to the size of the column. From the right, truncation falls with h²; from the left, "
    "rounding errors grow with 1/h. A right Jacobian has a V whose tip is below the tolerance. A "
    "wrong Jacobian has a floor: no step size reaches it."
)


def write_check(
    report: GradientReport | FactorCheck, path: str | os.PathLike[str], name: str = "check"
) -> None:
    """Write a check as one self-contained HTML file.

    Args:
        report: result of ``bundle.check_gradients`` or ``bundle.check_jacobians`` with
            ``details=True``.
        path: path of the file.
        name: name of the input.

    Raises:
        InputError: the report has no details, or the path is a folder.
        OSError: the file cannot be written.
    """
    if isinstance(report, FactorCheck):
        sections = list(_factors(report))
    elif isinstance(report, GradientReport):
        sections = list(_function(report))
    else:
        raise InputError(f"report: expected the result of a check, found {brief(report)}")
    write_page(as_path(path), f"Jacobians: {name}", sections)


def _function(report: GradientReport) -> Iterator[str]:
    yield _headline(gradient_report.outcome(report), report.verdict)
    points = [entry.sentence for entry in report.undecided]
    yield _listed([*(found.sentence for found in report.findings), *points])
    yield tag("p", escape(f"Checked: {report.subject}, {report.num_checked} {report.noun}s."),
              class_="quiet")  # fmt: skip
    yield from _worst(report.worst)
    yield from _details(report, "")


def _factors(check: FactorCheck) -> Iterator[str]:
    yield _headline(factor_report.outcome(check), check.verdict)
    yield _listed([found.sentence for found in check.findings])
    yield heading("Kinds of factors")
    head = ["factors", "verdict", "largest error", "checked", "wrong", "undecided"]
    yield table(head, factor_report.kind_rows(check), words={1})
    yield from _worst(check.worst)
    chosen = list(dict.fromkeys(found.factor for found in check.findings))[:MOST_FACTORS]
    for name in chosen or list(check.reports)[:1]:
        yield from _details(check.reports[name], name)


def _headline(sentence: str, verdict: str) -> str:
    kind = {"correct": "recommended", "wrong": "finding problem"}.get(verdict, "finding")
    return tag("div", tag("p", escape(sentence)), class_=kind)


def _listed(sentences: list[str]) -> str:
    return tag("ul", *(tag("li", escape(sentence)) for sentence in sentences)) if sentences else ""


def _worst(worst: tuple[Offender, ...]) -> Iterator[str]:
    rows = [
        [
            entry.parameter,
            entry.place,
            str(entry.residual),
            f"{entry.analytic:.6g}",
            f"{entry.reference:.6g}",
            f"{entry.error:.1e}",
        ]
        for entry in worst
        if entry.error > 0
    ]
    if rows:
        yield heading("Worst entries")
        yield table(["column", "place", "row", "yours", "should be", "error"], rows, words={1})


def _details(report: GradientReport, name: str) -> Iterator[str]:
    if report.details is None:
        raise InputError("report: expected the result of a check with details=True")
    title = f"Errors by entry: {name}" if name else "Errors by entry"
    yield heading(title)
    for details in report.details:
        yield _map(details, report.tolerance)
    yield heading(f"Against the step size: {name}" if name else "Against the step size")
    yield tag("p", escape(READING), class_="quiet")
    curves = [curve for details in report.details for curve in details.curves]
    yield grid([step_figure(curve, report.tolerance) for curve in curves])


def _map(details: CheckDetails, tolerance: float) -> str:
    """Return a table with the error of each entry; a wrong one is bold."""
    wrong = details.is_wrong.any(axis=0)
    order = [*np.flatnonzero(wrong), *np.flatnonzero(~wrong)]
    shown = sorted(int(j) for j in order[:MOST_COLUMNS])
    rows = range(min(len(details.errors), MOST_ROWS))
    head = ["column", *(f"row {row}" for row in rows)]
    lines = [[details.columns[j], *(_cell(details, row, j) for row in rows)] for j in shown]
    hidden = len(details.columns) - len(shown) or len(details.errors) - len(rows)
    rest = tag("p", "Further columns or rows are not shown.", class_="quiet") if hidden else ""
    legend = f"Largest relative error at all points. x: wrong, above {tolerance:g}."
    return table(head, lines) + tag("p", escape(legend), class_="quiet") + rest


def _cell(details: CheckDetails, row: int, column: int) -> str:
    error = details.errors[row, column]
    text = "not finite" if not np.isfinite(error) else f"{error:.0e}" if error else "0"
    return f"x {text}" if details.is_wrong[row, column] else text
