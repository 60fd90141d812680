"""The comparison itself: every method on every problem, each run in a process of its own."""

from __future__ import annotations

import dataclasses
import os
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from bundle.comparison import memory
from bundle.comparison.methods import BACKENDS, SOLVERS, expand
from bundle.comparison.profiles import performance_profiles
from bundle.comparison.recommend import recommend
from bundle.comparison.result import GAPS, Comparison, PerformanceProfile
from bundle.comparison.work import Progress, Source, Work
from bundle.errors import InputError
from bundle.options import SolveOptions
from bundle.problem import Problem

__all__ = ["REPEAT", "TIMEOUT", "compare"]

TIMEOUT = 60.0
REPEAT = 3
SHARE_OF_FREE_MEMORY = 0.9


def compare(
    problems: Source | Sequence[Source],
    options: SolveOptions | None = None,
    *,
    solvers: Iterable[str] = SOLVERS,
    preconditioners: Iterable[str] = ("auto",),
    orderings: Iterable[str] = ("points_first",),
    backends: Iterable[str] = BACKENDS,
    threads: Iterable[int] = (0,),
    repeat: int = REPEAT,
    timeout: float = TIMEOUT,
    memory_cap: int = 0,
    progress: Callable[[Progress], None] | None = None,
    **changes: Any,
) -> Comparison:
    """Solve the same start by every combination of methods and recommend one.

    Each run is a process of its own, one after the other. One that fails, takes too long, needs too
    much memory or dies is a row that says so, never the end. Ctrl-C ends the comparison with what
    is there.

    Args:
        problems: one or several problems, or paths of what :func:`bundle.load` reads.
        options: of every solve, but for what the methods vary.
        solvers: values of ``linear_solver_type`` to compare.
        preconditioners: values of ``preconditioner_type``, for the solvers that iterate.
        orderings: values of ``linear_solver_ordering``.
        backends: values of ``backend``.
        threads: values of ``num_threads``; 0 for all cores.
        repeat: runs of each method, of which the median counts; one that took 10 s is not repeated.
        timeout: seconds after which a solve is stopped.
        memory_cap: bytes that a solve may take beyond the loaded problem; 0: nine tenths of what
            this machine has free when the comparison starts.
        progress: called when a run starts, and with its iterations now and then.
        **changes: options by name, in place of those in ``options``.

    Raises:
        InputError: a problem cannot be loaded or has no observations, an option is out of its
            range, or there is nothing to compare.

    Example:
        >>> comparison = bundle.compare("problem.txt", solvers=["dense_schur", "sparse_schur"])
        >>> print(comparison.recommendation.command)
    """
    started = time.perf_counter()
    options = (options or SolveOptions()).replace(**changes)
    methods = expand(
        solvers=solvers,
        preconditioners=preconditioners,
        orderings=orderings,
        backends=backends,
        threads=threads,
    )
    if repeat < 1 or not timeout > 0 or memory_cap < 0:
        raise InputError(
            "repeat, timeout, memory_cap: expected at least 1, more than 0 and at least 0, "
            f"found {repeat}, {timeout:g} and {memory_cap}"
        )
    sources: Sequence[Source] = (
        [problems] if isinstance(problems, Problem | str | os.PathLike) else list(problems)
    )
    if not sources:
        raise InputError("expected a problem to compare methods on, found none")
    cap = memory_cap or int(SHARE_OF_FREE_MEMORY * memory.available_memory())
    report = progress or (lambda _: None)
    with tempfile.TemporaryDirectory(prefix="bundle-compare-") as folder:
        work = Work(
            folder=Path(folder),
            options=options,
            methods=methods,
            repeat=repeat,
            timeout=timeout,
            memory_cap=cap,
            report=report,
        )
        compared = tuple(work.take_over(index, source) for index, source in enumerate(sources))
        interrupted = work.run_all(compared)
        comparison = Comparison(
            problems=compared,
            runs=tuple(work.runs(len(compared))),
            profiles=(),
            recommendation=None,
            options=options,
            repeat=repeat,
            timeout=timeout,
            memory_cap_in_bytes=cap,
            interrupted=interrupted,
            wall_time_in_seconds=time.perf_counter() - started,
        )
    return dataclasses.replace(
        comparison,
        profiles=_profiles(comparison),
        recommendation=recommend(comparison, work.foreseen),
    )


def _profiles(comparison: Comparison) -> tuple[PerformanceProfile, ...]:
    if len(comparison.problems) < 2:
        return ()
    profiles: list[PerformanceProfile] = []
    for gap in GAPS:
        times = [
            {run.method: comparison.time_to_gap(run, gap) for run in comparison.runs_of(index)}
            for index in range(len(comparison.problems))
        ]
        profiles += performance_profiles(times, comparison.methods, gap)
    return tuple(profiles)
