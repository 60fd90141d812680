"""Findings of the report page: what is not determined, warnings, suspicions, and find()."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from bundle.analysis.uncertainty.covariance_result import Covariance
from bundle.interface.finding import Finding, one_list
from bundle.judging.findings.find import find
from bundle.judging.findings.next_command import NextCommand
from bundle.model.problem import Problem
from bundle.solving.result import Result


def report_findings(
    problem: Problem,
    result: Result | None,
    suspicions: Iterable[Finding],
    given: Iterable[Finding] | None,
    *,
    source: str,
    covariance: Covariance | None,
    no_covariance: str = "",
    priors: Sequence[Any] = (),
) -> tuple[Finding, ...]:
    """Return all findings about a model, problems first.

    Args:
        problem: the model.
        result: solve that made it, or None.
        suspicions: possible errors from the description of the model.
        given: findings of the caller; None finds them.
        source: path of the model in commands.
        covariance: covariance of the model, or None.
        no_covariance: reason why the covariance is missing; "" if it is known.
        priors: priors of the solve.
    """
    singular = Finding(
        kind="no_covariance",
        sentence=no_covariance,
        command=NextCommand(source).other("diagnose"),
        is_problem="full rank" in no_covariance,
    )
    undetermined = [singular] if no_covariance else []
    warnings = () if result is None else dict.fromkeys(result.summary.warnings)
    told = [Finding(kind="warning", sentence=words) for words in warnings]
    usable = covariance is not None and covariance.scale == "sigma0"
    if given is None:
        given = find(
            problem,
            source=source,
            options=None if result is None else result.options,
            rounds=0 if result is None else len(result.rounds),
            covariance=covariance if usable else None,
            priors=priors,
            is_minimum=result is not None and result.summary.termination_type == "CONVERGENCE",
        )
    return one_list(undetermined, told, suspicions, given)
