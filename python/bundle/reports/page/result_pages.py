"""Pages of `evaluate`, `compare`, `vio` and `check`: sections of their reports, and figures."""

from __future__ import annotations

import os
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from bundle.base.arrays import check_type
from bundle.base.paths import as_path
from bundle.checking import gradient_report
from bundle.checking.gradient_report import GradientReport
from bundle.checking.step_curve import CheckDetails
from bundle.errors import InputError, brief
from bundle.figures.evaluation_figures import step_figure
from bundle.figures.odometry_figures import odometry_figures
from bundle.graphs.factors import factor_report
from bundle.graphs.factors.factor_report import FactorCheck
from bundle.inertial.vio.keyframe_record import alarms_by_kind
from bundle.inertial.vio.odometry import OdometryResult
from bundle.inertial.vio.trajectory_comparison import TrajectoryError
from bundle.io.sequences.trajectory_files import Trajectory
from bundle.judging.evaluation.check_points import CheckPointEvaluation
from bundle.judging.evaluation.evaluation_result import Evaluation
from bundle.planning.comparison.comparison_result import Comparison
from bundle.planning.comparison.graph_comparison import GraphComparison
from bundle.reports.page.page import lead, prose, tag, write_page
from bundle.reports.page.table import findings_list, rendered
from bundle.reports.sections import Column, Report, Section, Table
from bundle.reports.terminal.compare import compared
from bundle.reports.terminal.graph_costs import compared_runs
from bundle.reports.terminal.judged import evaluated
from bundle.reports.terminal.vio_reports import odometry_facts, odometry_headline


def write_reported(report: Report, path: str | os.PathLike[str]) -> None:
    """Write a report as one self-contained HTML file."""
    headline, *more = report.headline or [report.title]
    sections = [tag("p", prose(sentence)) for sentence in more]
    sections += [tag("p", prose(sentence), class_="warn") for sentence in report.warnings]
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
    check_type("found", found, Evaluation | CheckPointEvaluation, "a result of bundle.evaluate")
    for name in names:
        check_type("names", name, str)
    write_reported(evaluated((names[0], names[1]), found), path)


def write_comparison(
    comparison: Comparison | GraphComparison, path: str | os.PathLike[str]
) -> None:
    """Write a comparison of a problem or of a graph as one self-contained HTML file.

    Raises:
        InputError: the path is a folder, or a path above it is not a folder.
        OSError: the file cannot be written.
    """
    if isinstance(comparison, GraphComparison):
        return write_reported(compared_runs(comparison, "a graph"), path)
    check_type("comparison", comparison, Comparison)
    return write_reported(compared(comparison), path)


SECTIONS = {
    "Trajectory": ("path", "error"),
    "Work": ("times", "steps", "costs", "sizes", "fill"),
    "State of the window": (
        "nullity",
        "excitation",
        "imu_excess",
        "yaw_sigma",
        "spectrum",
        "prior",
    ),
    "Biases": ("gyro_bias", "accel_bias"),
    "Marginalization": ("ages", "landmarks_left"),
}
ROWS = 12


def write_odometry(
    result: OdometryResult,
    path: str | os.PathLike[str],
    *,
    truth: Trajectory | None = None,
    error: TrajectoryError | None = None,
    name: str = "",
) -> None:
    """Write one self-contained HTML page about an odometry.

    Args:
        result: result of :func:`bundle.run_odometry`.
        path: path of the page. A failed write leaves no partial file.
        truth: true trajectory, drawn together with the estimate.
        error: error of :func:`bundle.inertial.vio.trajectory_comparison.compare_trajectories`, for
            the table.
        name: name of the sequence, for the title.

    Raises:
        InputError: ``result`` is not an odometry result, the truth has fewer than three poses in
            common with the trajectory, or the path cannot hold a page.
        OSError: the page cannot be written.
    """
    check_type("result", result, OdometryResult)
    check_type("name", name, str)
    figures = {figure.name: figure for figure in odometry_figures(result, truth)}
    facts = [("result", result.message), *odometry_facts(name, result, error)]
    headline, *more = odometry_headline(result, error)
    sections = [
        Section(title=title, figures=[figures[key] for key in names if key in figures])
        for title, names in SECTIONS.items()
    ]
    sections[1:1] = [Section(facts=facts), _alarms(result)]
    title = f"Odometry of {name}" if name else "Odometry"
    names = ("label", "x", "y", "sigma")
    lines = {
        key: [{name: getattr(line, name) for name in names} for line in figure.lines]
        for key, figure in figures.items()
    }
    data = {"figures": [{"name": key, "lines": of_one} for key, of_one in lines.items()]}
    written = [*([lead(more)] if more else []), *rendered(sections)]
    write_page(as_path(path), title, written, data, headline=headline, script="")


def _alarms(result: OdometryResult) -> Section:
    begin = int(result.trajectory.timestamps_ns[0])
    found = alarms_by_kind(result.keyframes)
    if not found:
        return Section(title="Alarms", text=["None."])
    rows = []
    for raised in found.values():
        first, last = (f"{1e-9 * (raised[k][0] - begin):.2f}" for k in (0, -1))
        rows.append([raised[0][1], f"{len(raised)}", first, last])
    head = ["alarm", "keyframes", "first [s]", "last [s]"]
    return Section(title="Alarms", tables=[Table.of(head, rows, most=ROWS)])


MOST_COLUMNS = 24  # number of columns of a map of errors; further right columns are left out
MOST_ROWS = 40
MOST_FACTORS = 5  # number of factors with a map and curves, one per finding

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
    points: list[str] = []
    if isinstance(report, FactorCheck):
        words: Any = factor_report
        rows = factor_report.kind_rows(report)
        first = [Section(title="Kinds of factors", tables=[Table.of(KINDS, rows, left=2)])]
        chosen = list(dict.fromkeys(found.factor for found in report.findings))[:MOST_FACTORS]
        parts = {key: report.reports[key] for key in chosen or list(report.reports)[:1]}
    elif isinstance(report, GradientReport):
        words, parts = gradient_report, {"": report}
        points = [entry.sentence for entry in report.undecided]
        checked = f"Checked: {report.subject}, {report.num_checked} {report.noun}s."
        first = [Section(text=[checked])]
    else:
        raise InputError(f"report: expected the result of a check, found {brief(report)}")
    kind = "finding problem" if report.verdict == "wrong" else "finding"
    said = [found.sentence for found in report.findings] + points
    worst = [entry for entry in report.worst if entry.error > 0]
    sections: list[Section | str] = [
        *(tag("div", tag("p", escape(sentence)), class_=kind) for sentence in said),
        *first,
        *([Section(title="Worst entries", tables=[Table(WORST, worst, left=2)])] if worst else []),
        *(section for key, one in parts.items() for section in _details(one, key)),
    ]
    title = f"Jacobians: {name}"
    write_page(as_path(path), title, rendered(sections), headline=words.outcome(report))


KINDS = ("factors", "verdict", "largest error", "checked", "wrong", "undecided")
WORST = (
    Column("column", "parameter"),
    Column("place", "place"),
    Column("row", "residual"),
    Column("yours", "analytic", "{:.6g}".format),
    Column("should be", "reference", "{:.6g}".format),
    Column("error", "error", "{:.1e}".format),
)


def _details(report: GradientReport, name: str) -> list[Section]:
    if report.details is None:
        raise InputError("report: expected the result of a check with details=True")
    of = f": {name}" if name else ""
    maps = [_map(details, report.tolerance) for details in report.details]
    curves = [curve for details in report.details for curve in details.curves]
    figures = [step_figure(curve, report.tolerance) for curve in curves]
    return [
        Section(title=f"Errors by entry{of}", tables=maps),
        Section(title=f"Against the step size{of}", text=[READING], figures=figures),
    ]


def _map(details: CheckDetails, tolerance: float) -> Table:
    wrong = details.is_wrong.any(axis=0)
    order = [*np.flatnonzero(wrong), *np.flatnonzero(~wrong)]
    shown = sorted(int(j) for j in order[:MOST_COLUMNS])
    rows = range(min(len(details.errors), MOST_ROWS))
    head = ["column", *(f"row {row}" for row in rows)]
    lines = [[details.columns[j], *(_cell(details, row, j) for row in rows)] for j in shown]
    hidden = len(details.columns) - len(shown) or len(details.errors) - len(rows)
    legend = f"Largest relative error at all points. x: wrong, above {tolerance:g}."
    legend += " Further columns or rows are not shown." if hidden else ""
    return Table.of(head, lines, legend=legend)


def _cell(details: CheckDetails, row: int, column: int) -> str:
    error = details.errors[row, column]
    text = "not finite" if not np.isfinite(error) else f"{error:.0e}" if error else "0"
    return f"x {text}" if details.is_wrong[row, column] else text
