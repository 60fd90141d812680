"""What `bundle check` and `bundle.check_gradients` say."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

from rich.console import RenderableType
from rich.table import Table

from bundle.checking import GradientCheckerSummary, GradientReport, Offender, Verdict
from bundle.errors import shown
from bundle.problem import Problem
from bundle.report import json
from bundle.report.refine import contents
from bundle.report.text import columns, facts, format_name, notes, plural

__all__ = ["as_json", "checked", "explanation", "outcome"]

BAR_WIDTH = 40


def checked(path: str, problem: Problem, report: GradientReport) -> list[RenderableType]:
    """Return the report on a problem's own Jacobians."""
    return [
        facts(
            [("input", f"{shown(path)} ({format_name(problem.format)})"), ("", contents(problem))]
        ),
        *explanation(report),
    ]


def outcome(report: GradientReport) -> str:
    """Return the verdict in one sentence."""
    if report.ok and report.num_checked:
        return (
            f"Correct: all Jacobians agree with the reference to {report.tolerance:g} "
            f"at {plural(report.num_checked, report.noun)}."
        )
    if report.ok:
        return "Nothing to check."
    return f"WRONG: {plural(len(report.findings), 'finding')}, the worst first."


def explanation(report: GradientReport) -> list[RenderableType]:
    """Return verdict, what is wrong, and the numbers behind it."""
    skipped = f", {report.num_skipped} skipped" if report.num_skipped else ""
    count = plural(report.num_checked, report.noun)
    parts: list[RenderableType] = [
        facts([("checked", f"{report.subject}, {count}{skipped}")]),
        facts([("verdict", outcome(report))]),
        *notes((finding.sentence for finding in report.findings), style="red"),
    ]
    if not report.num_checked:
        return parts
    parts += ["", _verdicts(report.groups)]
    if not report.ok:
        wrong = [verdict for verdict in report.parameters if verdict.verdict != "correct"]
        parts += ["", _verdicts(wrong, "parameter"), "", _worst(report.worst)]
    parts += ["", _histogram(report.histogram)]
    parts += ["", facts([("GradientChecker", _checker(report.gradient_checker))])]
    return parts


def as_json(
    path: str,
    problem: Problem,
    report: GradientReport,
    options: dict[str, Any],
    wall_time: float,
) -> dict[str, Any]:
    """Return the report of `bundle check` for programs; wall_time in seconds."""
    numbers = dataclasses.asdict(report)
    numbers["histogram"] = [
        {"low": low, "high": high, "count": count} for low, high, count in report.histogram
    ]
    return {
        **json.heading("check", path, problem),
        "options": options,
        **json.plain(numbers),
        "wall_time": {"total": wall_time},
    }


def _verdicts(verdicts: Sequence[Verdict], title: str = "parameters") -> Table:
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
    head = (title, "verdict", "largest error", "entries", "wrong", "undecided")
    return columns(head, rows, left=2)


def _worst(offenders: Sequence[Offender]) -> Table:
    rows = [
        (
            offender.parameter,
            offender.place,
            f"{offender.residual}",
            f"{offender.analytic:.6g}",
            f"{offender.reference:.6g}",
            _error(offender.error),
        )
        for offender in offenders
        if offender.error > 0
    ]
    head = ("worst", "where", "row", "analytic", "should be", "error")
    return columns(head, rows, left=2)


def _histogram(histogram: Sequence[tuple[float, float, int]]) -> Table:
    filled = [index for index, (_, _, count) in enumerate(histogram) if count]
    shown_bins = histogram[filled[0] : filled[-1] + 1] if filled else []
    largest = max((count for _, _, count in shown_bins), default=1)
    total = max(sum(count for _, _, count in shown_bins), 1)
    rows = [
        (
            _bin(low, high),
            "#" * math.ceil(BAR_WIDTH * count / largest),
            str(count),
            f"{100.0 * count / total:.1f} %",
        )
        for low, high, count in shown_bins
    ]
    return columns(("relative error", " " * BAR_WIDTH, "entries", "share"), rows, left=2)


def _bin(low: float, high: float) -> str:
    if low == 0:
        return f"below {high:.0e}"
    return f"{low:.0e} to {high:.0e}" if math.isfinite(high) else f"{low:.0e} and more"


def _checker(summary: GradientCheckerSummary) -> str:
    words = [f"Ceres' own finds {summary.num_agreed} of {summary.num_probes} correct"]
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
