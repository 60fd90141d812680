"""chi2 of a refined pose graph against its expectation, by kind of edge."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

from bundle.analysis.diagnosis.chi2_kinds import (
    Chi2Kind,
    chi2_kinds,
    information_sentence,
    kinds_data,
)
from bundle.base.words import number
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.interface.finding import Finding
from bundle.reports.sections import Column

MOST_FLOPS = 2e10
"""Flops of a factorisation above which chi2 has no expectation by kind: it takes some seconds."""

KINDS = (
    Column("edges", "kind"),
    Column("number", "count"),
    Column("chi2", "chi2", number),
    Column("degrees of freedom", "degrees", number),
    Column("expected (99.9 %)", lambda one: f"{number(one.low)} to {number(one.high)}"),
    Column("information times", lambda one: number(one.scale)),
    Column("", lambda one: one.verdict.replace("-", " ")),
)


def kinds_of(solved: PoseGraphResult) -> tuple[Chi2Kind, ...]:
    """Return chi2 by kind of edge; () without a solution, or if it takes longer than the solve."""
    summary = solved.summary
    if not summary.is_solution_usable or (summary.factor_flops or 0.0) > MOST_FLOPS:
        return ()
    return chi2_kinds(solved)


def about_information(path: str, kinds: Sequence[Chi2Kind]) -> list[Finding]:
    """Return the finding that chi2 contradicts the information; empty if it agrees."""
    sentence = information_sentence(kinds)
    if not sentence:
        return []
    is_large = any(one.verdict == "too-large" for one in kinds)
    return [
        Finding(
            kind="information",
            sentence=sentence,
            command=shlex.join(["bundle", "diagnose", path]) if is_large else "",
            evidence={"kinds": kinds_data(kinds)},
        )
    ]
