"""Predicted cost of a solve by N MPI processes, from the problem's own pattern.

A step by N processes takes

    t(N) = w t_points + t_first + (b + (ceil(log2 N) - 1) b_2) / bandwidth + m ceil(log2 N) latency,

with t_points the terms of one process that are sums over points, w the largest share of a process
(``ranks.partition``, by pairs of observations), and t_first the serial work of rank 0: the linear
solver and the constant cost. A step sends m messages of b bytes (the count that `bundle refine`
reports). MPI pipelines large messages through trees, so their time does not depend on the number of
processes. b_2 of the bytes are double-double sums; rank 0 receives one such sum at each level of a
binary tree. Efficiency is t(1) / (N t(N)).

Bytes per step, for blocks (i, j) of S of h x w numbers and n columns:

    normal equations   8 (sum of h w over the lower triangle, diagonal blocks whole, + n)
    gradient, norms    8 * 4 n   (two vectors, each summed and sent back)
    step               8 n

Double-double sums (cpp/core/sums/double_double.h) send two numbers each to rank 0: 8 (2 sum of h
w + 9 n) in all.

Conjugate gradients may add the block diagonal of J_c^T J_c. Memory is that of a process without a
problem, of its part of the points, and of S without fill-in. Rank 0 adds the factor and all points:
with several processes, BAL files and binary COLMAP models are read in slices
(``bundle.solving.slices``), and each process stores the ids of all points of a model.

Scaling limit: in a step t(N) = w(N) t_points + t_first + t_messages(N), only the first term falls
with N. More processes are useful while the efficiency t(1) / (N t(N)) is at least one half:
doubling N then saves more time than it wastes. N t(N) is the time of all processes; the largest of
its added terms causes the limit:

    imbalance   N w(N) t_points - t_points
    first       (N - 1) t_first            (N - 1 processes wait)
    messages    N t_messages(N)
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bundle.base.records import dataclass
from bundle.base.words import duration
from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.planning.inspection.inspection_result import Inspection, MethodInspection
from bundle.planning.inspection.problem_pattern import BlockPattern, find_pattern
from bundle.solving.layout import resolve_defaults
from bundle.solving.ranks.partition import divide

NETWORK = (10.0, 50.0)  # assumed network: 10 Gbit/s Ethernet with 50 microseconds of latency

PROCESS = 62e6  # bytes of a process without a problem: Python, NumPy, the core and its threads, MPI

COLMAP = 85.0
"""Bytes per observation of the files of a COLMAP model and their index."""

POINT_IDS = 30.0
"""Bytes per point of a sliced COLMAP model in each process: ids, index, owners, sections."""

# Messages per step: S in one or more portions, right-hand side, sums with replies, step.
_MESSAGES = 24

_OF_POINTS = ("observations", "pairs of observations", "adding to S")
_OF_A_PART = ("plan of the points", "points", "sorting")
_OF_THE_FIRST = ("reduced system", "coarse system", "BLAS")


@dataclass(frozen=True, kw_only=True)
class RankPrediction:
    """Predicted solve by N processes."""

    num_processes: int  # number of processes N
    method: str  # linear solver (Ceres' name) that is predicted
    most_observations: int  # largest number of observations of a process
    bytes_per_step: int  # bytes of messages, as ``summary.processes.traffic`` counts them
    time_per_step_in_seconds: float  # predicted time of a step
    points_time_per_step_in_seconds: float  # divided part, of the process with the most work
    first_time_per_step_in_seconds: float  # serial part of rank 0
    network_time_per_step_in_seconds: float  # part of the messages
    efficiency: float  # time of one process over N times the time of N processes
    # memory_of_first_in_bytes, memory_of_others_in_bytes: peak of rank 0 and of another rank
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
    """Predict solves by several processes, each with as many threads as the inspection assumes.

    ``network``: bandwidth in gigabits per second, and latency in microseconds.
    """
    if not all(math.isfinite(value) and value > 0 for value in network):
        raise InputError(f"network: expected two positive numbers, found {network}")
    for count in counts:
        if count < 1:
            raise InputError(f"ranks: expected at least 1 process, found {count}")
    if not counts:
        return ()
    method = _method(inspection)
    chosen = resolve_defaults(problem, SolveOptions.of(options, {}, "inspect"))
    reduced = find_pattern(problem, chosen).reduced
    double_doubles = reduced.sums_are_double_doubles(method.linear_solver_type)
    is_dense = method.linear_solver_type == "DENSE_SCHUR"
    size = step_bytes(reduced, is_dense=is_dense, double_doubles=double_doubles)
    num_vectors = 9 if double_doubles else 6
    sent_values = size - 8 * num_vectors * reduced.num_columns
    sent_double_doubles = sent_values + 8 * 6 * reduced.num_columns if double_doubles else 0
    # Values of S alone: its error terms belong to the method.
    values = sent_values / 2 if double_doubles else sent_values
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
            received = size + (levels - 1) * sent_double_doubles
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


def step_bytes(reduced: BlockPattern, *, is_dense: bool, double_doubles: bool) -> int:
    """Return the bytes of a step's messages, without a few scalars."""
    sizes = reduced.sizes.astype(np.int64)
    if is_dense:
        values = (int(sizes.sum()) ** 2 + int((sizes**2).sum())) // 2
    else:
        columns = np.repeat(sizes, np.diff(reduced.column_begin))
        values = int((columns * sizes[reduced.rows]).sum())
    if double_doubles:
        return 8 * (2 * values + 9 * reduced.num_columns)
    return 8 * (values + 6 * reduced.num_columns)


def _method(inspection: Inspection) -> MethodInspection:
    """Return the fastest method that several processes can run."""
    able = [
        method for method in inspection.methods if method.backend == "FUSED" and method.is_taken
    ]
    if not able:
        raise InputError(
            "ranks: expected a problem for the fused backend, found a problem that only Ceres can "
            "solve"
        )
    return min(able, key=lambda method: method.time_per_step_in_seconds)


def _bytes_of(problem: Problem) -> int:
    arrays = (getattr(problem, name) for name in vars(problem))
    return sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))


PAYS = 0.5  # smallest efficiency at which more processes are useful

_WHY = {
    "first": "all wait while rank 0 solves the reduced system",
    "messages": "messages with S and vectors load the network",
    "imbalance": "the points cannot be divided more evenly",
}


@dataclass(frozen=True, kw_only=True)
class RankLimit:
    """Largest useful number of processes, and the reason."""

    num_processes: int  # largest requested number that pays
    next_num_processes: int  # smallest requested number that does not pay; 0 if all pay
    reason: str  # largest waste of time: "first", "messages" or "imbalance"; "" if all pay
    share: float  # share of the processes' time that this waste takes, 0 to 1
    message: str  # limit and reason in one sentence


def find_rank_limit(predictions: Sequence[RankPrediction]) -> RankLimit | None:
    """Return the scaling limit; None without predictions for more than one process."""
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
                f"All these numbers are efficient: {most} processes have {last.efficiency:.0%} "
                f"efficiency; a step takes {duration(last.time_per_step_in_seconds)}."
            ),
        )
    waste = _waste(beyond)
    reason = max(waste, key=lambda name: waste[name])
    share = waste[reason] / (beyond.num_processes * beyond.time_per_step_in_seconds)
    pay = f"{most} processes are efficient" if most > 1 else "One process is best"
    return RankLimit(
        num_processes=most,
        next_num_processes=beyond.num_processes,
        reason=reason,
        share=share,
        message=(
            f"{pay}; {beyond.num_processes} would have {beyond.efficiency:.0%} efficiency: "
            f"{_WHY[reason]}, {share:.0%} of their time."
        ),
    )


def _waste(row: RankPrediction) -> dict[str, float]:
    """Return the overhead in seconds, summed over all processes, relative to a single process."""
    count = row.num_processes
    alone = count * row.efficiency * row.time_per_step_in_seconds  # t(1)
    divided = alone - row.first_time_per_step_in_seconds
    return {
        "first": (count - 1) * row.first_time_per_step_in_seconds,
        "messages": count * row.network_time_per_step_in_seconds,
        "imbalance": count * row.points_time_per_step_in_seconds - divided,
    }
