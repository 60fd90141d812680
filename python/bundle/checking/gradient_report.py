"""Result of a check of Jacobians, as data and as text."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field
from html import escape
from typing import Any

from bundle.base.display import Display
from bundle.base.records import dataclass
from bundle.base.tables import Bar, Block, Columns, columns, facts, notes, render
from bundle.base.words import plural
from bundle.checking.evidence import Finding
from bundle.checking.step_curve import CheckDetails
from bundle.interface.tabular import Tabular

STYLES = {"correct": "green", "wrong": "red", "undecided": "yellow"}

SHOWN = 5  # number of findings in the repr; printing a report shows all


@dataclass(frozen=True)
class Verdict:
    """Verdict on a parameter, or on a group of parameters."""

    name: str  # "camera RADIAL k1", "rotation"
    # "correct", "wrong" or "undecided". A parameter is undecided if the reference is not accurate
    # enough for most of its entries; entries that are certainly zero are ignored. A group is
    # undecided if most of its parameters are
    verdict: str
    num_entries: int  # number of compared entries of the Jacobians
    num_wrong: int  # entries above the tolerance
    num_undecided: int  # entries whose reference is less accurate than the tolerance
    max_error: float  # relative, minus the reference's uncertainty for undecided entries


@dataclass(frozen=True)
class Offender:
    """An entry of a Jacobian with a large error."""

    place: str  # place in words: "image IMG_17.jpg, point 12", "sample 3"
    parameter: str  # name of the column: "camera 3 k1", "image IMG_17.jpg rotation y"
    residual: int  # index of the row
    analytic: float  # value to check
    reference: float  # correct value
    # relative, safe near zero (``JacobianDeviation.scale``), minus the reference's uncertainty
    error: float
    # the place for programs, by keys: image_id, image_name, camera_id, model, point_id, or sample
    details: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Undecided:
    """Points at which the reference is not accurate enough."""

    # "camera_center" (the point is so close to the projection centre that the rounding of point and
    # pose changes the derivatives), "rough" (a kink, a jump or noise), or "no_value" (the residual
    # has no value on both sides of the point)
    reason: str
    count: int  # number of points
    places: tuple[str, ...]  # the first few, in words: "image IMG_17.jpg, point 12"
    sentence: str  # reason, count and places in words


@dataclass(frozen=True)
class GradientCheckerSummary:
    """Results of ceres::GradientChecker at the same points."""

    num_probes: int = 0  # number of probes
    num_agreed: int = 0  # probes that GradientChecker accepted
    num_false_alarms: int = 0  # rejected Jacobians that are correct by the second reference
    num_gave_up: int = 0  # probes that failed because the residual has no value at a nearby point
    num_overlooked: int = 0  # wrong Jacobians that GradientChecker accepted


@dataclass(frozen=True, eq=False)
class GradientReport(Tabular):
    """Result of a check. Its truth value is True if all Jacobians are correct.

    Printing the report explains the result.

    Attributes:
        ok: True if the verdict is "correct".
        verdict: "correct", "wrong" or "undecided". It is undecided if no mistake was found, but a
            parameter has no accurate reference at most points or at the given point.
        subject: checked function in words.
        noun: name of a point: "sample", "observation".
        tolerance: relative error above which an entry is wrong.
        num_checked: number of checked points (observations).
        num_skipped: number of skipped points: their residual is not finite or has no weight.
        undecided: checked points without a verdict, by reason.
        findings: mistakes and undecided parameters, worst first.
        groups: verdict on each group of parameters.
        parameters: verdict on each parameter.
        worst: entries with the largest errors, worst first.
        histogram: (low, high, count) of the relative errors of all entries, by decades.
        gradient_checker: results of ceres::GradientChecker.
        details: errors of all entries and curves against the step size, of each kind of residual;
            None unless requested.
    """

    ok: bool
    verdict: str
    subject: str
    noun: str
    tolerance: float
    num_checked: int
    num_skipped: int
    findings: tuple[Finding, ...]
    groups: tuple[Verdict, ...]
    parameters: tuple[Verdict, ...]
    worst: tuple[Offender, ...]
    histogram: tuple[tuple[float, float, int], ...]
    gradient_checker: GradientCheckerSummary
    undecided: tuple[Undecided, ...] = ()
    details: tuple[CheckDetails, ...] | None = None

    @property
    def num_undecided(self) -> int:
        """Number of checked points without a verdict."""
        return sum(entry.count for entry in self.undecided)

    @property
    def kinds(self) -> frozenset[str]:
        """Kinds of all findings; {"correct"} without findings."""
        return frozenset(finding.kind for finding in self.findings) or frozenset({"correct"})

    def __bool__(self) -> bool:
        return self.ok

    def __str__(self) -> str:
        return render(*explanation(self)).rstrip("\n")

    def __repr__(self) -> str:
        return self._display().text()

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"

    def _display(self) -> Display:
        count = plural(self.num_checked, self.noun)
        findings = tuple(("finding", finding.sentence) for finding in self.findings[:SHOWN])
        more = len(self.findings) - SHOWN
        return Display(
            title=f"GradientReport: {outcome(self)}",
            facts=(
                ("checked", f"{self.subject}, {count}, {self.num_skipped} skipped"),
                *findings,
                *((("", f"and {more} more"),) if more > 0 else ()),
            ),
        )


def outcome(report: GradientReport) -> str:
    """Return the verdict in one sentence."""
    if report.ok:
        undecided = f"; {report.num_undecided} undecided" if report.num_undecided else ""
        return (
            f"Correct: all Jacobians agree with the reference to {report.tolerance:g} "
            f"at {plural(report.num_checked - report.num_undecided, report.noun)}{undecided}."
        )
    if not report.num_checked and not report.findings:
        return "Nothing to check."
    if report.verdict == "undecided":
        return "UNDECIDED: no mistake found, but the accuracy of the reference is not sufficient."
    return f"WRONG: {plural(len(report.findings), 'finding')}, the worst first."


def explanation(report: GradientReport) -> list[Block | str]:
    """Return the verdict, the findings, and tables of errors."""
    verdict = facts([("verdict", outcome(report))])
    return [*subject(report), verdict, *mistakes(report), *measurements(report)]


def subject(report: GradientReport) -> list[Block | str]:
    """Return the name of the checked function and the number of points."""
    skipped = f", {report.num_skipped} skipped" if report.num_skipped else ""
    count = plural(report.num_checked, report.noun)
    return [facts([("checked", f"{report.subject}, {count}{skipped}")])]


def mistakes(report: GradientReport) -> list[Block | str]:
    """Return the findings, and the points without a verdict."""
    return [
        *notes((finding.sentence for finding in report.findings), style=STYLES[report.verdict]),
        *notes((entry.sentence for entry in report.undecided), style="yellow"),
    ]


def measurements(report: GradientReport) -> list[Block | str]:
    """Return tables of errors."""
    if not report.num_checked:
        return []
    parts: list[Block | str] = []
    parts += ["", _verdicts(report.groups)]
    if not report.ok:
        wrong = [verdict for verdict in report.parameters if verdict.verdict != "correct"]
        parts += ["", _verdicts(wrong, "parameter")] if wrong else []
        parts += ["", worst_entries(report.worst)] if report.verdict == "wrong" else []
    parts += ["", _histogram(report.histogram)]
    parts += ["", facts([("GradientChecker", _checker(report.gradient_checker))])]
    return parts


def _verdicts(verdicts: Sequence[Verdict], title: str = "parameters") -> Columns:
    rows = [
        (
            verdict.name,
            verdict.verdict,
            _error(verdict.max_error),
            str(verdict.num_entries),
            str(verdict.num_wrong),
            str(verdict.num_undecided),
        )
        for verdict in verdicts
    ]
    head = (title, "verdict", "max error", "entries", "wrong", "undecided")
    return columns(head, rows, left=2)


def worst_entries(offenders: Sequence[Offender]) -> Columns:
    """Return a table of wrong entries: column, place, row and values."""
    rows = [
        (
            offender.parameter,
            offender.place,
            f"{offender.residual}",
            *_values(offender),
            _error(offender.error),
        )
        for offender in offenders
        if offender.error > 0
    ]
    head = ("worst", "where", "row", "analytic", "should be", "error")
    return columns(head, rows, left=2)


def _values(one: Offender) -> tuple[str, ...]:  # with the digits that tell them apart
    digits = 6 if f"{one.analytic:.6g}" != f"{one.reference:.6g}" else 12
    return tuple(f"{value:.{digits}g}" for value in (one.analytic, one.reference))


def _histogram(histogram: Sequence[tuple[float, float, int]]) -> Columns:
    filled = [index for index, (_, _, count) in enumerate(histogram) if count]
    shown_bins = histogram[filled[0] : filled[-1] + 1] if filled else []
    largest = max((count for _, _, count in shown_bins), default=1)
    total = max(sum(count for _, _, count in shown_bins), 1)
    rows = [
        (
            _bin(low, high),
            Bar(count / largest),
            str(count),
            f"{100.0 * count / total:.1f} %",
        )
        for low, high, count in shown_bins
    ]
    return columns(("relative error", "", "entries", "share"), rows, left=2)


def _bin(low: float, high: float) -> str:
    if low == 0:
        return f"below {high:.0e}"
    return f"{low:.0e} to {high:.0e}" if math.isfinite(high) else f"{low:.0e} and more"


def _checker(summary: GradientCheckerSummary) -> str:
    words = [f"Ceres finds {summary.num_agreed} of {summary.num_probes} correct"]
    if summary.num_false_alarms:
        words.append(
            f"{plural(summary.num_false_alarms, 'false alarm')} (entries near zero, "
            "or its step of 1 % too coarse)"
        )
    if summary.num_gave_up:
        words.append(f"gave up on {summary.num_gave_up}")
    if summary.num_overlooked:
        words.append(f"overlooked {summary.num_overlooked}")
    return "; ".join(words)


def _error(error: float) -> str:
    if error == 0:
        return "0"
    return f"{error:.1e}" if math.isfinite(error) else "not finite"
