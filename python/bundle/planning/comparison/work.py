"""Runs of a comparison: one worker process after the other, and their outcomes."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.memory_sizes import format_size
from bundle.base.paths import is_path
from bundle.base.records import dataclass
from bundle.errors import shown
from bundle.interface.compare_options import SECONDS_NOT_REPEATED
from bundle.interface.options import SolveOptions
from bundle.interface.summary import Summary
from bundle.io.files import Source, as_problem
from bundle.model.unobserved import require_observations, require_tracks
from bundle.planning.comparison import hand_over
from bundle.planning.comparison.comparison_result import ComparedProblem
from bundle.planning.comparison.measured_run import Measurement, Prediction, Run
from bundle.planning.comparison.method import Method
from bundle.planning.comparison.minima import find_minima
from bundle.planning.comparison.perturbed_start import perturbed
from bundle.planning.comparison.predictions import foresee, predict
from bundle.planning.comparison.process import WorkerEnd, run_worker

TIGHT = {
    "max_num_iterations": 200,
    "function_tolerance": 1e-12,
    "gradient_tolerance": 1e-14,
    "parameter_tolerance": 1e-12,
}
"""Options of solves that tell other minima from solutions that are not converged."""


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Progress of a comparison.

    Attributes:
        stage: description such as "3 of 18: fused SPARSE_SCHUR on 2 threads".
        iteration: latest iteration, by the names of Ceres' IterationSummary; None before the first.
    """

    stage: str
    iteration: dict[str, Any] | None = None


@dataclass(kw_only=True)
class Work:
    """Running comparison; `folder` holds the problems, `ends` the ends of workers."""

    folder: Path
    options: SolveOptions
    methods: tuple[Method, ...]
    repeat: int
    timeout: float
    memory_cap: int
    report: Callable[[Progress], None]
    perturb: float = 0.0
    seed: int = 0
    ends: dict[tuple[int, Method], list[WorkerEnd]] = field(default_factory=dict)
    predictions: list[dict[Method, Prediction]] = field(default_factory=list)
    foreseen: list[Method | None] = field(default_factory=list)

    def take_over(self, index: int, source: Source) -> ComparedProblem:
        """Load a problem from a path, or use a given problem, and store it for the workers."""
        is_file = is_path(source)
        name = f"problem {index + 1}"
        if is_path(source):
            name = os.fspath(source)
            self.report(Progress(stage=f"reading {shown(name)}"))
        source = as_problem(source, name="problems")
        require_observations(source, shown(name))
        require_tracks(source, shown(name), self.options)
        if self.perturb:
            source = perturbed(source, self.options, self.perturb, self.seed)
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
        """Run all methods on all problems; return True if Ctrl-C ended the comparison."""
        total = len(problems) * self.repeat * len(self.methods)
        number = 0
        try:
            for index, problem in enumerate(problems):
                where = f", {shown(problem.name)}" if len(problems) > 1 else ""
                self.report(Progress(stage=f"predicting{where}"))
                self._predict(index)
                # interleaved, so that slow drift affects all methods equally
                for _ in range(self.repeat):
                    for method in self.methods:
                        number += 1
                        if self._is_settled(index, method):
                            continue
                        stage = f"{number} of {total}: {method.name}, {method.threads}{where}"
                        self._run(index, method, stage)
        except KeyboardInterrupt:
            return True
        return False

    def runs(self, num_problems: int, interrupted: bool) -> Iterable[Run]:
        """Yield the run of each problem and method, with the minimum at which it ended."""
        for index in range(num_problems):
            predictions = self.predictions[index] if index < len(self.predictions) else {}
            runs = [
                _run(index, method, self.ends.get((index, method), []), predictions.get(method))
                for method in self.methods
            ]
            yield from self._with_minima(index, runs, interrupted)

    def _with_minima(self, index: int, runs: Sequence[Run], interrupted: bool) -> Sequence[Run]:
        problem = hand_over.restore(self.folder / str(index), mmap_mode="r")
        paths = {run.method: self._solution(index, run.method) for run in runs}

        def refine(run: Run, target: Path) -> WorkerEnd:
            """Continue a solution with the default method at tight tolerances."""
            stage = f"refining the solution of {run.method.name} further"
            options = self.options.replace(**TIGHT)
            return self._worker(index, options, stage, paths[run.method], target)

        return find_minima(problem, self.options, runs, paths, None if interrupted else refine)

    def _solution(self, index: int, method: Method) -> Path:
        return self.folder / f"{index}-{self.methods.index(method)}.npz"

    def _predict(self, index: int) -> None:
        problem = hand_over.restore(self.folder / str(index), mmap_mode="r")
        self.predictions.append(predict(problem, self.options, self.methods))
        self.foreseen.append(
            foresee(problem, self.options, self.methods, self.predictions[index], self.memory_cap)
        )

    def _is_settled(self, index: int, method: Method) -> bool:
        """Return True if another run is not worthwhile: one failed or took long."""
        for end in self.ends.get((index, method), []):
            if end.measurement is None:
                return True
            if end.measurement["solve_time_in_seconds"] > SECONDS_NOT_REPEATED:
                return True
        return False

    def _run(self, index: int, method: Method, stage: str) -> None:
        ends = self.ends.setdefault((index, method), [])
        solution = None if ends else self._solution(index, method)
        ends.append(self._worker(index, method.options(self.options), stage, None, solution))

    def _worker(
        self,
        index: int,
        options: SolveOptions,
        stage: str,
        start: Path | None,
        solution: Path | None,
    ) -> WorkerEnd:
        request = {
            "options": options.asdict(),
            "memory_cap": self.memory_cap,
            "start": None if start is None else str(start),
            "solution": None if solution is None else str(solution),
        }
        path = self.folder / "request.json"
        path.write_text(json.dumps(request))
        self.report(Progress(stage=stage))
        return run_worker(
            self.folder / str(index),
            path,
            timeout=self.timeout,
            memory_cap=self.memory_cap,
            on_iteration=lambda latest: self.report(Progress(stage=stage, iteration=latest)),
        )


def _run(
    index: int, method: Method, ends: Sequence[WorkerEnd], prediction: Prediction | None
) -> Run:
    """Combine worker ends into a run; the first failed one determines the outcome."""
    measurements = tuple(_measurement(end.measurement) for end in ends if end.measurement)
    bad = next((end for end in ends if end.outcome != "done"), None)
    outcome, message, unfinished = "done", "", None
    if not ends:
        outcome, message = "not_run", "the comparison was interrupted before this run"
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
