"""A comparison under way: one worker after the other, and what became of them."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.memory_sizes import format_size
from bundle.base.paths import is_path
from bundle.errors import InputError, shown
from bundle.interface.compare_defaults import SECONDS_NOT_REPEATED
from bundle.interface.options import SolveOptions
from bundle.interface.summary import Summary
from bundle.io.source import Source, as_problem
from bundle.planning.comparison import hand_over
from bundle.planning.comparison.comparison_result import (
    ComparedProblem,
    Measurement,
    Prediction,
    Run,
)
from bundle.planning.comparison.method import Method
from bundle.planning.comparison.predictions import foresee, predict
from bundle.planning.comparison.process import WorkerEnd, run_worker

__all__ = ["Progress", "Work"]


@dataclass(frozen=True, kw_only=True)
class Progress:
    """What a comparison is at.

    Attributes:
        stage: in words, such as "3 of 18: fused SPARSE_SCHUR on 2 threads".
        iteration: the latest one, under the names of Ceres' IterationSummary; None before any.
    """

    stage: str
    iteration: dict[str, Any] | None = None


@dataclass(kw_only=True)
class Work:
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
        is_file = is_path(source)
        name = f"problem {index + 1}"
        if is_path(source):
            name = os.fspath(source)
            self.report(Progress(stage=f"reading {shown(name)}"))
        source = as_problem(source, name="problems")
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
                for _ in range(self.repeat):  # interleaved: slow drift affects all equally
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
        self.foreseen.append(
            foresee(problem, self.options, self.methods, self.predictions[index], self.memory_cap)
        )

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
        if outcome == "out_of_memory" and prediction is not None:
            message += f"; predicted: {format_size(prediction.memory_in_bytes)}"
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
