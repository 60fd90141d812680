"""Findings of the report page: what is not determined, warnings, suspicions, and find()."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bundle.analysis.statistics.description import Description
from bundle.analysis.uncertainty.covariance_result import Covariance
from bundle.interface.finding import Finding
from bundle.judging.findings.find import find
from bundle.judging.findings.next_command import NextCommand
from bundle.model.problem import Problem
from bundle.solving.result import Result

__all__ = ["report_findings"]

PROBLEMS = ("collapsed_points", "no_observations", "unsupported_camera_models")
"""Kinds of suspicions with which a model is no reconstruction."""


def report_findings(
    problem: Problem,
    result: Result | None,
    description: Description,
    *,
    source: str,
    covariance: Covariance | str,
    priors: Sequence[Any] = (),
) -> list[Finding]:
    """Return all findings about a model, problems first.

    Args:
        problem: the model.
        result: solve that made it, or None.
        description: description of the model, with its suspicions.
        source: path of the model in commands.
        covariance: covariance of the model, or the reason why it is missing.
        priors: priors of the solve.
    """
    found = []
    if isinstance(covariance, str) and covariance:
        found.append(
            Finding(
                kind="no_covariance",
                sentence=covariance,
                command=NextCommand(source).other("diagnose"),
                is_problem="full rank" in covariance,
            )
        )
    for words in () if result is None else dict.fromkeys(result.summary.warnings):
        found.append(Finding(kind="warning", sentence=words))
    for one in description.suspicions:
        is_problem = one.kind in PROBLEMS
        found.append(Finding(kind=one.kind, sentence=one.sentence, is_problem=is_problem))
    known = None if isinstance(covariance, str) or covariance.scale != "sigma0" else covariance
    found += find(
        problem,
        source=source,
        options=None if result is None else result.options,
        rounds=0 if result is None else len(result.rounds),
        covariance=known,
        priors=priors,
        is_minimum=result is not None and result.summary.termination_type == "CONVERGENCE",
    )
    return sorted(found, key=lambda one: not one.is_problem)
