"""Finding: a fact about a model that its user should act on, and the command to act with."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import field
from typing import Any

from bundle.base.records import dataclass

DETAILS = ("duplicate_points",)
"""Kinds that terminals show with --verbose only: they matter little, and no command helps."""

SUPERSEDED = {
    "gross_errors": "outliers",
    "images_without_observations": "unobserved_pose",
    "not_converged": "outliers",  # more steps of least squares would follow them
}
"""Kinds that another kind, if it was found, states better."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A fact about a model that its user should act on."""

    kind: str  # stable name for programs, such as "outliers"
    sentence: str  # the fact with its numbers, in words
    command: str = ""  # command line to run next; "" if no command helps
    evidence: Mapping[str, Any] = field(default_factory=dict)  # numbers behind it, by name
    is_problem: bool = False  # True if the problem is not determined or not usable as it is


def one_list(*groups: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings of several sources as one list, problems first.

    A kind that an earlier source found, or that is superseded by another, is left out.
    """
    listed: list[Finding] = []
    for group in groups:
        known = {finding.kind for finding in listed}
        listed += [finding for finding in group if finding.kind not in known]
    kinds = {finding.kind for finding in listed}
    kept = [finding for finding in listed if SUPERSEDED.get(finding.kind) not in kinds]
    return tuple(sorted(kept, key=lambda finding: not finding.is_problem))
