"""A report out of what was counted and found."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from bundle.checking.evidence import Finding
from bundle.checking.report import GradientCheckerSummary, GradientReport, Offender, Verdict
from bundle.checking.tally import EDGES, MOST_WORST, Tally, verdicts

__all__ = ["CHECKER_PRECISION", "TOLERANCE", "make_report"]

TOLERANCE = 1e-7
"""Relative error from which on an entry is wrong."""

CHECKER_PRECISION = 1e-6
"""What ceres::GradientChecker is asked for: its own differences are not better everywhere."""


def make_report(
    *,
    subject: str,
    noun: str,
    tallies: Sequence[Tally],
    findings: Iterable[Finding],
    worst: Iterable[Offender],
    num_checked: int,
    num_skipped: int,
    gradient_checker: GradientCheckerSummary,
    tolerance: float = TOLERANCE,
) -> GradientReport:
    """Return the report; groups that the reference cannot decide become findings of their own."""
    groups, parameters = verdicts(tallies)
    found = [*findings, *_undecided(groups)]
    histogram = sum((tally.histogram for tally in tallies), np.zeros(len(EDGES) - 1, np.int64))
    return GradientReport(
        ok=not found,
        subject=subject,
        noun=noun,
        tolerance=tallies[0].tolerance if tallies else tolerance,
        num_checked=num_checked,
        num_skipped=num_skipped,
        findings=tuple(sorted(found, key=lambda finding: -finding.error)),
        groups=groups,
        parameters=parameters,
        worst=tuple(sorted(worst, key=lambda offender: -offender.error)[:MOST_WORST]),
        histogram=tuple(
            (float(low), float(high), int(count))
            for low, high, count in zip(EDGES[:-1], EDGES[1:], histogram, strict=True)
        ),
        gradient_checker=gradient_checker,
    )


def _undecided(groups: Sequence[Verdict]) -> list[Finding]:
    return [
        Finding(
            "undecided",
            (group.name,),
            f"{group.name}: the residual is too noisy or too rough there for any reference; "
            "nothing can be said",
        )
        for group in groups
        if group.verdict == "undecided"
    ]
