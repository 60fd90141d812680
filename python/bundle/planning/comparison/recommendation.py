"""One recommendation from what was measured, with its reason."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence

from bundle.planning.comparison.command_line import command_line
from bundle.planning.comparison.comparison_result import Comparison, Recommendation, Run
from bundle.planning.comparison.method import Method
from bundle.planning.comparison.reasons import reason_on_many, reason_on_one

__all__ = ["COST_TOLERANCE", "NEAR_ENOUGH", "recommend"]

COST_TOLERANCE = 1e-3
"""Relative distance to the best final cost within which two solutions count as equally good."""

NEAR_ENOUGH = 1.15
"""Factor of the least total time within which a choice counts as right."""


def recommend(
    comparison: Comparison, foreseen: Sequence[Method | None] = ()
) -> Recommendation | None:
    """Return what to take: of the methods that reached the best cost, the one of least time.

    With several problems it is the method that reached the best cost most often, and among those
    the one whose time is on the geometric mean the least multiple of the fastest one's.

    Args:
        comparison: whose recommendation is not read.
        foreseen: for each problem the method that was thought the fastest before.

    Returns:
        None where no run has a usable solution.
    """
    ratios = [_ratios(comparison, index) for index in range(len(comparison.problems))]
    ranked = sorted(
        (method for method in comparison.methods if any(method in row for row in ratios)),
        key=lambda method: _rank(method, ratios),
    )
    if not ranked:
        return None
    best = ranked[0]
    one = len(comparison.problems) == 1
    source = comparison.problems[0].name if one and comparison.problems[0].is_file else "INPUT"
    return Recommendation(
        method=best,
        reason=reason_on_one(comparison, best, COST_TOLERANCE)
        if one
        else reason_on_many(best, ratios),
        command=command_line(best.options(comparison.options), source),
        foreseen=tuple(foreseen),
        verdict=_verdict(ratios, foreseen),
    )


def _ratios(comparison: Comparison, problem: int) -> dict[Method, float]:
    """Return the total times over the least one, of the runs that reached the best cost."""
    good = [run for run in comparison.runs_of(problem) if _reached_best(comparison, run)]
    least = min((run.total_time_in_seconds for run in good), default=math.nan)
    return {run.method: run.total_time_in_seconds / least for run in good}


def _reached_best(comparison: Comparison, run: Run) -> bool:
    return run.is_usable and comparison.gap(run) <= COST_TOLERANCE


def _rank(method: Method, ratios: Sequence[dict[Method, float]]) -> tuple[int, float]:
    """Return a key that sorts the best method first."""
    own = [row[method] for row in ratios if method in row]
    return -len(own), statistics.geometric_mean(own)


def _verdict(ratios: Sequence[dict[Method, float]], foreseen: Sequence[Method | None]) -> str:
    """Return whether what was foreseen is as good as what was found."""
    judged = [
        (method, row) for row, method in zip(ratios, foreseen, strict=False) if row and method
    ]
    if not judged:
        return ""
    right = [row.get(method, math.inf) <= NEAR_ENOUGH for method, row in judged]
    within = f"within {round(100 * (NEAR_ENOUGH - 1))} % of the fastest"
    if len(judged) > 1:
        return f"Foreseen before any solve, and {within}: {sum(right)} of {len(judged)} problems."
    method, row = judged[0]
    name = f"{method.name} on {method.threads} was foreseen before any solve"
    if method not in row:
        return f"{name}, which was wrong: it did not reach the best cost."
    if row[method] == 1:
        return f"{name}, which was right."
    verdict = "right" if right[0] else "wrong"
    return f"{name}, which was {verdict}: it takes {row[method]:.2f} times as long as the fastest."
