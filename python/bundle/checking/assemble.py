"""Assembly of a check's report from counts and findings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from bundle.base.words import plural
from bundle.checking.evidence import Finding
from bundle.checking.gradient_report import (
    GradientCheckerSummary,
    GradientReport,
    Offender,
    Undecided,
    Verdict,
)
from bundle.checking.tally import EDGES, MOST_WORST, Tally, verdicts
from bundle.interface.check_options import TOLERANCE

REASONS = {
    "camera_center": "too close to the camera's center: "
    "the last digits of point and pose change the derivatives",
    "rough": "a kink, a jump or noise there leaves no difference to compare with",
    "no_value": "the residual has no finite value on both sides",
}

SAYS_NOTHING = ("undecided", "unstable")
"""Kinds of findings after which the Jacobians are neither correct nor wrong, but undecided."""

NAMED = 3
"""Largest number of places listed in a sentence."""

CHECKER_PRECISION = 1e-6
"""Relative precision for ceres::GradientChecker, whose differences are not always more precise."""


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
    undecided: Sequence[Undecided] = (),
) -> GradientReport:
    """Return the report.

    A finding is added for each group of parameters that the reference cannot decide, and if no
    point is decided. A finding without columns (the residual has no value) means that no point is
    decided.
    """
    groups, parameters = verdicts(tallies)
    found = [*findings, *_undecided(groups)]
    if not found and num_checked and sum(entry.count for entry in undecided) >= num_checked:
        found.append(Finding("undecided", (), f"no {noun} could be decided"))
    says_nothing = all(
        finding.kind in SAYS_NOTHING or (finding.kind == "not_finite" and not finding.columns)
        for finding in found
    )
    verdict = "wrong" if not says_nothing else "undecided"
    if not found and num_checked:
        verdict = "correct"
    histogram = sum((tally.histogram for tally in tallies), np.zeros(len(EDGES) - 1, np.int64))
    return GradientReport(
        ok=verdict == "correct",
        verdict=verdict,
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
        undecided=tuple(undecided),
    )


def undecided_points(
    noun: str, points: Mapping[str, Sequence[int]], place: Callable[[int], str]
) -> list[Undecided]:
    """Return one entry per reason, the most frequent first.

    Args:
        noun: name of a point.
        points: numbers of the points, by reason.
        place: function that converts a point's number to text.
    """
    entries = []
    for reason, found in sorted(points.items(), key=lambda item: -len(item[1])):
        if not found:
            continue
        places = tuple(place(point) for point in found[:NAMED])
        named = "; ".join(places) + ("; ..." if len(found) > NAMED else "")
        sentence = f"{plural(len(found), noun)} undecided: {REASONS[reason]} ({named})"
        entries.append(Undecided(reason, len(found), places, sentence))
    return entries


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
