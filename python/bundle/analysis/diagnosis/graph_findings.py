"""Findings of pose graphs and of factor graphs: wrong edges, noise, digits, no minimum."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.diagnosis_result import SuspiciousEdge
from bundle.base.words import number, plural
from bundle.graphs.pose_graphs.chi2_quantiles import chi2_limit, chi2_median
from bundle.interface.finding import Finding

AT_MINIMUM = 1e-4
"""Relative decrease of the cost by one more step, below which a state counts as a minimum."""

FEW_DIGITS = 4
"""Number of digits of a step below which the normal equations are a problem."""

MOST_NAMED = 5
"""Number of suspicious edges that a sentence names."""

REMEDIES = {
    "edge": "refine with a loss for wrong closures (dcs, gnc-tls)",
    "factor": "solve with a loss on it",
}


def is_at_minimum(decrease: float, cost: float) -> bool:
    """Tell whether one more step would hardly lower the cost."""
    return not (decrease > AT_MINIMUM * cost and decrease > 1e-9)


def worst_first(test: NDArray[np.float64], rank: NDArray[np.int64], scale: float) -> list[int]:
    """Return the positions of edges that others contradict, the worst first."""
    limit = np.array([chi2_limit(degrees) for degrees in rank.tolist()])
    ratio = np.where(np.isfinite(test) & (rank > 0), test, 0.0) / limit
    order = np.argsort(-ratio, kind="stable")
    return [int(edge) for edge in order[ratio[order] > scale]]


def noise_scale(test: NDArray[np.float64], rank: NDArray[np.int64]) -> float:
    """Return the ratio of actual to expected scatter of correct edges; half may be wrong."""
    checked = np.isfinite(test) & (rank > 0)
    if not checked.any():
        return 1.0
    medians = np.array([chi2_median(degrees) for degrees in rank[checked].tolist()])
    return max(1.0, float(np.median(test[checked] / medians)))


def about_edges(
    suspicious: Sequence[SuspiciousEdge], scale: float, names: Sequence[str], noun: str
) -> list[Finding]:
    """Return the finding about edges or factors that the others contradict.

    Args:
        suspicious: the edges, the worst first.
        scale: noise of all edges.
        names: names of the first edges.
        noun: "edge" or "factor".
    """
    if not suspicious:
        return []
    listed = [
        f"{name}{f' (line {one.line})' if one.line else ''}: {number(one.test)} on {one.degrees}"
        for name, one in zip(names[:MOST_NAMED], suspicious, strict=False)
    ]
    more = f" and {len(suspicious) - MOST_NAMED} more" if len(suspicious) > MOST_NAMED else ""
    against = f" times {number(scale)}, the noise" if scale > 1 else ""
    return [
        problem(
            "suspicious_edges",
            f"{plural(len(suspicious), noun)} with an error that one right {noun} in a million has "
            f"(chi2 of the test on degrees of freedom{against}): {'; '.join(listed)}{more}. A "
            f"wrong {noun} spoils its neighbours' errors, too: look at the first, or "
            f"{REMEDIES[noun]}.",
        )
    ]


def about_conditioning(condition: float) -> list[Finding]:
    """Return the finding about a condition number that leaves few digits."""
    if not np.isfinite(condition):
        return []
    digits = 16 - np.log10(max(condition, 1.0))
    if digits >= FEW_DIGITS:
        return []
    return [
        problem(
            "ill_conditioned",
            f"A step has about {max(0, round(digits))} digits by the normal equations (condition "
            f"number {number(condition)}).",
        )
    ]


def about_minimum(decrease: float, cost: float) -> list[Finding]:
    """Return the note on values that are no minimum."""
    return [
        note(
            "no_minimum",
            f"This is no minimum: a step of a solve would lower the cost by about "
            f"{number(min(100.0, 100 * decrease / cost))} %. Which edges the others contradict is "
            "told at a minimum only: refine first.",
        )
    ]


def about_noise(scale: float) -> list[Finding]:
    """Return the note on information that is too optimistic."""
    if scale < 2:
        return []
    return [
        note(
            "optimistic_information",
            f"Errors scatter {number(float(np.sqrt(scale)))} times as much as the information "
            "says: it is optimistic, or many edges are wrong.",
        )
    ]


def problem(kind: str, sentence: str) -> Finding:
    """Return a finding that makes a diagnosis not ok."""
    return Finding(kind=kind, is_problem=True, sentence=sentence)


def note(kind: str, sentence: str) -> Finding:
    """Return a finding that does not."""
    return Finding(kind=kind, is_problem=False, sentence=sentence)
