"""Where more processes stop to pay, and why.

Of a step t(N) = w(N) t_points + t_first + t_messages(N) (``rank_prediction``) only the first term
falls with N. Processes pay as long as their efficiency t(1) / (N t(N)) is at least one half: so far
each doubling saves more than it wastes. What stops them is the largest of what each adds to
N t(N), the time of all processes, over that of a single one:

    imbalance   N w(N) t_points - t_points
    first       (N - 1) t_first            (N - 1 processes wait)
    messages    N t_messages(N)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bundle.base.words import duration
from bundle.planning.inspection.rank_prediction import RankPrediction

__all__ = ["PAYS", "RankLimit", "find_rank_limit"]

PAYS = 0.5
"""Efficiency from which on processes are said to pay."""

_WHY = {
    "first": "all wait while the first one solves the reduced system",
    "messages": "sums of S and of vectors go through the network",
    "imbalance": "points can be divided no more evenly",
}


@dataclass(frozen=True, kw_only=True)
class RankLimit:
    """Where more processes stop to pay.

    Attributes:
        num_processes: the most of those asked for that pay.
        next_num_processes: the fewest of those asked for that do not; 0 if all pay.
        reason: what wastes most of their time: "first", "messages" or "imbalance"; "" if all pay.
        share: of their time that goes there, 0 to 1.
        message: the same in a sentence.
    """

    num_processes: int
    next_num_processes: int
    reason: str
    share: float
    message: str


def find_rank_limit(predictions: Sequence[RankPrediction]) -> RankLimit | None:
    """Return where processes stop to pay; None without predictions of more than one process."""
    rows = sorted(predictions, key=lambda row: row.num_processes)
    if not rows or rows[-1].num_processes < 2:
        return None
    paying = [row for row in rows if row.efficiency >= PAYS]
    most = max((row.num_processes for row in paying), default=1)
    beyond = next((row for row in rows if row.num_processes > most), None)
    if beyond is None:
        last = rows[-1]
        return RankLimit(
            num_processes=most,
            next_num_processes=0,
            reason="",
            share=0.0,
            message=(
                f"All pay: {most} processes still work at {last.efficiency:.0%} "
                f"efficiency, a step takes {duration(last.time_per_step_in_seconds)}."
            ),
        )
    waste = _waste(beyond)
    reason = max(waste, key=lambda name: waste[name])
    share = waste[reason] / (beyond.num_processes * beyond.time_per_step_in_seconds)
    pay = f"{most} processes pay" if most > 1 else "One process is best"
    return RankLimit(
        num_processes=most,
        next_num_processes=beyond.num_processes,
        reason=reason,
        share=share,
        message=(
            f"{pay}; {beyond.num_processes} would work at {beyond.efficiency:.0%} efficiency: "
            f"{_WHY[reason]}, {share:.0%} of their time."
        ),
    )


def _waste(row: RankPrediction) -> dict[str, float]:
    """Return the seconds of all processes that one process would not need."""
    count = row.num_processes
    alone = count * row.efficiency * row.time_per_step_in_seconds  # t(1)
    divided = alone - row.first_time_per_step_in_seconds
    return {
        "first": (count - 1) * row.first_time_per_step_in_seconds,
        "messages": count * row.network_time_per_step_in_seconds,
        "imbalance": count * row.points_time_per_step_in_seconds - divided,
    }
