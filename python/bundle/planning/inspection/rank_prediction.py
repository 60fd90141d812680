"""What a solve by N processes costs, from the problem's own pattern.

A step of N processes takes

    t(N) = w t_points + t_first + (b + (ceil(log2 N) - 1) b_2) / bandwidth + m ceil(log2 N) latency,

t_points the terms of one process that are sums over points, w the share of the fullest part (of
``ranks.partition``, by pairs of observations), t_first what the first process does alone while the
others wait: the linear solver and what does not depend on the size. b are the bytes of a step's
messages as `bundle refine` tallies them, m their number. Those of MPI go through trees in
pipelines: large ones take the time of their bytes once, however many processes there are. Of
twofold sums, b_2 of the bytes, the first process receives one at each level of a binary tree.
Efficiency is t(1) / (N t(N)).

Bytes of a step with blocks (i, j) of S of h x w numbers, n columns:

    normal equations   8 (sum of h w over the lower triangle, diagonal blocks whole, + n)
    gradient, norms    8 * 4 n   (two vectors, each summed and sent back)
    step               8 n

Twofold sums (cpp/core/parallel/twofold_sum.h) have two numbers each on the way to the first:
8 (2 sum of h w + 9 n) in all.

With conjugate gradients the block diagonal of J_c^T J_c may come on top. Memory is that of a
process without a problem, of a part and of S, without fill; the first process has the factor
besides and all points: several processes read BAL files and COLMAP models in binary in slices
(``bundle.solving.slices``), and of a model each has the ids of all points.

Where more processes stop to pay, and why.

Of a step t(N) = w(N) t_points + t_first + t_messages(N) (``rank_prediction``) only the first term
falls with N. Processes pay as long as their efficiency t(1) / (N t(N)) is at least one half: so far
each doubling saves more than it wastes. What stops them is the largest of what each adds to
N t(N), the time of all processes, over that of a single one:

    imbalance   N w(N) t_points - t_points
    first       (N - 1) t_first            (N - 1 processes wait)
    messages    N t_messages(N)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bundle.base.words import duration
from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.planning.inspection.inspection_result import Inspection, MethodInspection
from bundle.planning.inspection.problem_pattern import BlockPattern, find_pattern
from bundle.solving.ranks.partition import divide
from bundle.solving.solver import resolve_defaults

__all__ = [
    "NETWORK",
    "PAYS",
    "RankLimit",
    "RankPrediction",
    "find_rank_limit",
    "predict_ranks",
    "step_bytes",
]


NETWORK = (10.0, 50.0)
"""Gigabits per second and microseconds of latency that are assumed: 10 Gbit Ethernet."""

PROCESS = 62e6
"""Bytes of a process before it has a problem: Python, NumPy, the core and its threads, MPI."""

COLMAP = 85.0
"""Bytes per observation that the files of a COLMAP model and their index take."""

POINT_IDS = 30.0
"""Bytes per point of a COLMAP model in slices that each process has: ids, their index, owners and
sections."""

# Of a step: S in one or more portions, its right-hand side, sums with their way back, the step.
_MESSAGES = 24

_OF_POINTS = ("observations", "pairs of observations", "adding to S")
_OF_A_PART = ("plan of the points", "points", "sorting")
_OF_THE_FIRST = ("reduced system", "coarse system", "BLAS")


@dataclass(frozen=True, kw_only=True)
class RankPrediction:
    """A solve by so many processes.

    Attributes:
        num_processes: N.
        method: the linear solver that the numbers are for, Ceres' name.
        most_observations: of the fullest process.
        bytes_per_step: of messages, as ``summary.processes.traffic`` counts them.
        time_per_step_in_seconds: predicted.
        points_time_per_step_in_seconds: the part of it that is divided, of the fullest process.
        first_time_per_step_in_seconds: the part that the first process does alone, which is not.
        network_time_per_step_in_seconds: the part that messages take.
        efficiency: time of one process over N times the time of N.
        memory_of_first_in_bytes, memory_of_others_in_bytes: peak of a process.
    """

    num_processes: int
    method: str
    most_observations: int
    bytes_per_step: int
    time_per_step_in_seconds: float
    points_time_per_step_in_seconds: float
    first_time_per_step_in_seconds: float
    network_time_per_step_in_seconds: float
    efficiency: float
    memory_of_first_in_bytes: float
    memory_of_others_in_bytes: float


def predict_ranks(
    problem: Problem,
    inspection: Inspection,
    options: SolveOptions | None = None,
    *,
    counts: Sequence[int],
    network: tuple[float, float] = NETWORK,
) -> tuple[RankPrediction, ...]:
    """Predict solves by several processes with as many threads each as the inspection is for.

    Args:
        problem: what was inspected.
        inspection: what ``bundle.inspect`` said of it.
        options: with which.
        counts: numbers of processes.
        network: gigabits per second, and microseconds of latency.

    Raises:
        InputError: a count is below 1 or above the number of points, the network is not positive,
            or the fused backend, which alone can be divided, does not take the problem.
    """
    if not all(math.isfinite(value) and value > 0 for value in network):
        raise InputError(f"network: expected two positive numbers, found {network}")
    for count in counts:
        if count < 1:
            raise InputError(f"ranks: expected numbers of processes from 1 on, found {count}")
    if not counts:
        return ()
    method = _method(inspection)
    chosen = resolve_defaults(problem, SolveOptions.of(options, {}, "inspect"))
    reduced = find_pattern(problem, chosen).reduced
    twofold = reduced.sums_are_twofold(method.linear_solver_type)
    is_dense = method.linear_solver_type == "DENSE_SCHUR"
    size = step_bytes(reduced, is_dense=is_dense, twofold=twofold)
    num_vectors = 9 if twofold else 6
    sent_values = size - 8 * num_vectors * reduced.num_columns
    sent_twofold = sent_values + 8 * 6 * reduced.num_columns if twofold else 0
    # Of S alone: what rounding takes from it is a term of the method.
    values = sent_values / 2 if twofold else sent_values
    tracks = np.bincount(problem.observation_point, minlength=problem.num_points)
    work = tracks * (tracks + 1.0)
    whole = _bytes_of(problem)
    is_bal = problem.format == "bal"
    read = 0.0 if is_bal else COLMAP * problem.num_observations
    ids = 0.0 if is_bal else POINT_IDS * problem.num_points
    points_of_first = problem.points.nbytes + (0 if is_bal else 8 * problem.num_points)
    terms, times = method.memory_terms, method.time_terms
    of_points = sum(times.get(name, 0.0) for name in _OF_POINTS)
    of_first = method.time_per_step_in_seconds - of_points
    part = sum(terms.get(name, 0.0) for name in _OF_A_PART)
    factor = sum(terms.get(name, 0.0) for name in _OF_THE_FIRST)
    other = method.memory_in_bytes - part - factor
    rows = []
    for count in counts:
        parts = divide(problem, count).parts
        share = max(work[points].sum() for points in parts) / max(work.sum(), 1.0)
        sent = 0.0
        if count > 1:
            levels = math.ceil(math.log2(count))
            received = size + (levels - 1) * sent_twofold
            sent = _MESSAGES * levels * network[1] * 1e-6 + received * 8 / (network[0] * 1e9)
        time = share * of_points + of_first + sent
        most = max(int(tracks[points].sum()) for points in parts)
        own = most / max(int(tracks.sum()), 1)
        is_divided = count > 1
        kept = float(points_of_first) if is_divided else read
        common = other + (ids if is_divided else 0.0)
        rows.append(
            RankPrediction(
                num_processes=count,
                method=method.linear_solver_type,
                most_observations=most,
                bytes_per_step=size if count > 1 else 0,
                time_per_step_in_seconds=time,
                points_time_per_step_in_seconds=share * of_points,
                first_time_per_step_in_seconds=of_first,
                network_time_per_step_in_seconds=sent,
                efficiency=method.time_per_step_in_seconds / (count * time),
                memory_of_first_in_bytes=PROCESS + kept + own * (whole + part) + factor + common,
                memory_of_others_in_bytes=0.0
                if count == 1
                else PROCESS + own * (whole + part) + values + common,
            )
        )
    return tuple(rows)


def step_bytes(reduced: BlockPattern, *, is_dense: bool, twofold: bool) -> int:
    """Return the bytes of a step's messages; without a few scalars."""
    sizes = reduced.sizes.astype(np.int64)
    if is_dense:
        values = (int(sizes.sum()) ** 2 + int((sizes**2).sum())) // 2
    else:
        columns = np.repeat(sizes, np.diff(reduced.column_begin))
        values = int((columns * sizes[reduced.rows]).sum())
    if twofold:
        return 8 * (2 * values + 9 * reduced.num_columns)
    return 8 * (values + 6 * reduced.num_columns)


def _method(inspection: Inspection) -> MethodInspection:
    """Return the fastest method that can be divided."""
    able = [
        method for method in inspection.methods if method.backend == "FUSED" and method.is_taken
    ]
    if not able:
        raise InputError(
            "ranks: expected a problem for the fused backend, found one for Ceres alone"
        )
    return min(able, key=lambda method: method.time_per_step_in_seconds)


def _bytes_of(problem: Problem) -> int:
    arrays = (getattr(problem, name) for name in vars(problem))
    return sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))


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
