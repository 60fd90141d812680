"""The comparison itself: every method on every problem, each run in a process of its own."""

from __future__ import annotations

import dataclasses
import json
import os
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.comparison import hand_over, memory
from bundle.comparison.foresee import foresee
from bundle.comparison.method import Method
from bundle.comparison.methods import BACKENDS, SOLVERS, expand
from bundle.comparison.predictions import predict
from bundle.comparison.process import WorkerEnd, run_worker
from bundle.comparison.profiles import performance_profiles
from bundle.comparison.recommend import recommend
from bundle.comparison.result import (
    GAPS,
    ComparedProblem,
    Comparison,
    Measurement,
    PerformanceProfile,
    Prediction,
    Run,
)
from bundle.errors import InputError, shown
from bundle.io import load
from bundle.options import SolveOptions
from bundle.problem import Problem
from bundle.summary import Summary

__all__ = ["REPEAT", "TIMEOUT", "Progress", "compare"]

TIMEOUT = 60.0
REPEAT = 3
SHARE_OF_FREE_MEMORY = 0.9
SECONDS_NOT_REPEATED = 10.0
"""A run that took this long is not repeated: its spread is small, and patience ends."""

Source = Problem | str | os.PathLike[str]


@dataclass(frozen=True, kw_only=True)
class Progress:
    """What a comparison is at.

    Attributes:
        stage: in words, such as "3 of 18: fused SPARSE_SCHUR on 2 threads".
        iteration: the latest one, under the names of Ceres' IterationSummary; None before any.
    """

    stage: str
    iteration: dict[str, Any] | None = None


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
        work = _Work(
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


@dataclass(kw_only=True)
class _Work:
    """A comparison that is under way: problems lie in `folder`, ends of workers in `ends`."""

    folder: Path
    options: SolveOptions
    methods: tuple[Method, ...]
    repeat: int
    timeout: float
    memory_cap: int
    report: Callable[[Progress], None]
    ends: dict[tuple[int, Method], list[WorkerEnd]] = field(default_factory=dict)
    predictions: list[dict[Method, Prediction]] = field(default_factory=list)
    foreseen: list[Method | None] = field(default_factory=list)

    def take_over(self, index: int, source: Source) -> ComparedProblem:
        """Load a problem if it is a path, and lay it out for the workers."""
        is_file = not isinstance(source, Problem)
        name = f"problem {index + 1}"
        if not isinstance(source, Problem):
            name = os.fspath(source)
            self.report(Progress(stage=f"reading {shown(name)}"))
            source = load(source)
        if source.num_observations == 0:
            raise InputError(f"{shown(name)}: expected observations to refine, found none")
        hand_over.store(source, self.folder / str(index))
        return ComparedProblem(
            name=name,
            is_file=is_file,
            format=source.format,
            num_cameras=source.num_cameras,
            num_images=source.num_images,
            num_points=source.num_points,
            num_observations=source.num_observations,
        )

    def run_all(self, problems: Sequence[ComparedProblem]) -> bool:
        """Run everything; return whether Ctrl-C ended it."""
        total = len(problems) * self.repeat * len(self.methods)
        number = 0
        try:
            for index, problem in enumerate(problems):
                where = f", {shown(problem.name)}" if len(problems) > 1 else ""
                self.report(Progress(stage=f"predicting{where}"))
                self._predict(index)
                for _ in range(self.repeat):  # interleaved: what drifts, drifts for all
                    for method in self.methods:
                        number += 1
                        if self._is_settled(index, method):
                            continue
                        stage = f"{number} of {total}: {method.name}, {method.threads}{where}"
                        self.report(Progress(stage=stage))
                        self._run(index, method, stage)
        except KeyboardInterrupt:
            return True
        return False

    def runs(self, num_problems: int) -> Iterable[Run]:
        """Yield what became of each problem and method."""
        for index in range(num_problems):
            predictions = self.predictions[index] if index < len(self.predictions) else {}
            for method in self.methods:
                ends = self.ends.get((index, method), [])
                yield _run(index, method, ends, predictions.get(method))

    def _predict(self, index: int) -> None:
        problem = hand_over.restore(self.folder / str(index), mmap_mode="r")
        self.predictions.append(predict(problem, self.options, self.methods))
        self.foreseen.append(foresee(problem, self.options, self.methods, self.predictions[index]))

    def _is_settled(self, index: int, method: Method) -> bool:
        """Whether a run would say nothing new: it failed, or it takes long."""
        for end in self.ends.get((index, method), []):
            if end.measurement is None:
                return True
            if end.measurement["solve_time_in_seconds"] > SECONDS_NOT_REPEATED:
                return True
        return False

    def _run(self, index: int, method: Method, stage: str) -> None:
        request = self.folder / "request.json"
        options = method.options(self.options).asdict()
        request.write_text(json.dumps({"options": options, "memory_cap": self.memory_cap}))
        end = run_worker(
            self.folder / str(index),
            request,
            timeout=self.timeout,
            memory_cap=self.memory_cap,
            on_iteration=lambda latest: self.report(Progress(stage=stage, iteration=latest)),
        )
        self.ends.setdefault((index, method), []).append(end)


def _run(
    index: int, method: Method, ends: Sequence[WorkerEnd], prediction: Prediction | None
) -> Run:
    """Return the run that its workers make up: the first end that is not well is the run's."""
    measurements = tuple(_measurement(end.measurement) for end in ends if end.measurement)
    bad = next((end for end in ends if end.outcome != "done"), None)
    outcome, message, unfinished = "done", "", None
    if not ends:
        outcome, message = "not_run", "the comparison was interrupted before"
    elif bad is not None:
        outcome, message, unfinished = bad.outcome, bad.message, _columns(bad.iterations)
    elif not all(one.summary.is_solution_usable for one in measurements):
        outcome, message = "failed", measurements[0].summary.message
    return Run(
        problem=index,
        method=method,
        outcome=outcome,
        message=" ".join(message.split()),
        measurements=measurements,
        unfinished=unfinished,
        prediction=prediction,
    )


def _measurement(sent: dict[str, Any]) -> Measurement:
    summary: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in sent["summary"].items()
    }
    iterations = {name: np.asarray(column) for name, column in sent["iterations"].items()}
    return Measurement(**{**sent, "summary": Summary(**summary), "iterations": iterations})


def _columns(iterations: Sequence[dict[str, Any]]) -> dict[str, NDArray[Any]] | None:
    if not iterations:
        return None
    return {name: np.asarray([one[name] for one in iterations]) for name in iterations[0]}


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
