"""Runs of a comparison: one worker process after the other, and their outcomes.

At a minimum, every method stops after a step, and times are meaningless. A seeded perturbation of
relative size s gives a start at which no method has converged. With n standard normal:

    centre of a pose    c + s D n,  D: median distance of its observed points
    rotation of a pose  Exp(s n) R, about its centre
    point               p + s d n,  d: distance of its nearest camera
    focal lengths       (1 + s n) f, at least f / 2; one n per camera

All sizes are relative to distances, so that the image moves by about s f pixels whatever the scale
of the scene. Constant parameters and poses of sensors on rigs are not perturbed.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.paths import is_path
from bundle.base.records import dataclass
from bundle.base.words import format_size, span
from bundle.errors import InputError, shown
from bundle.interface.options import AUTO_PRECONDITIONER, SolveOptions
from bundle.interface.planning_options import SECONDS_NOT_REPEATED
from bundle.interface.summary import Summary
from bundle.io.files import Source, as_problem
from bundle.model.cameras import camera_models
from bundle.model.problem import Problem
from bundle.model.rigid_motions import (
    quaternion_from_vector,
    quaternion_inverse,
    quaternion_multiply,
    quaternion_rotate,
)
from bundle.model.unobserved import require_observations, require_tracks
from bundle.planning.comparison import process
from bundle.planning.comparison.comparison_result import ComparedProblem
from bundle.planning.comparison.measured_run import Measurement, Method, Prediction, Run
from bundle.planning.comparison.process import WorkerEnd, run_worker
from bundle.planning.comparison.recommendation import find_minima
from bundle.planning.inspection.inspection_result import Inspection, MethodInspection
from bundle.planning.inspection.problem_inspection import inspect
from bundle.solving.solve import solve

TIGHT = {
    "max_num_iterations": 200,
    "function_tolerance": 1e-12,
    "gradient_tolerance": 1e-14,
    "parameter_tolerance": 1e-12,
}
"""Options of solves that distinguish other minima from solutions that have not converged."""


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Progress of a comparison."""

    stage: str  # description such as "3 of 18: fused SPARSE_SCHUR on 2 threads"
    # latest iteration, by the names of Ceres' IterationSummary; None before the first
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
        name = os.fspath(source) if is_path(source) else f"problem {index + 1}"
        if is_file:
            self.report(Progress(stage=f"reading {shown(name)}"))
        source = as_problem(source, name="problems")
        require_observations(source, shown(name))
        require_tracks(source, shown(name), self.options)
        if self.perturb:
            source = perturbed(source, self.options, self.perturb, self.seed)
        process.store(source, self.folder / str(index))
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
                self.report(Progress(stage=f"predicting {shown(problem.name)}"))
                self._predict(index)
            each = [one.time_per_step_in_seconds for p in self.predictions for one in p.values()]
            time = 10 * self.repeat * float(np.nansum(each))  # 0: no method has a prediction
            plan = f"{total} solves" + f", {span(time)} at 10 steps each" * (time > 0)
            hint = "; bundle evaluate compares two models" * (len(problems) == 2)
            self.report(Progress(stage=plan + hint))
            for index, problem in enumerate(problems):
                where = f", {shown(problem.name)}" if len(problems) > 1 else ""
                # interleaved, so that slow drift affects all methods equally
                for method in self.methods * self.repeat:
                    number += 1
                    if not self._is_settled(index, method):
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
        problem = process.restore(self.folder / str(index), mmap_mode="r")
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
        problem = process.restore(self.folder / str(index), mmap_mode="r")
        self.predictions.append(predict(problem, self.options, self.methods))
        self.foreseen.append(
            foresee(problem, self.options, self.methods, self.predictions[index], self.memory_cap)
        )

    def _is_settled(self, index: int, method: Method) -> bool:
        """Return True if a run is not repeated because it failed or took long."""
        return any(
            end.measurement is None
            or end.measurement["solve_time_in_seconds"] > SECONDS_NOT_REPEATED
            for end in self.ends.get((index, method), [])
        )

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
    first = iterations[0] if iterations else {}
    return {name: np.asarray([one[name] for one in iterations]) for name in first} or None


Array = NDArray[np.float64]

_FOCAL = ("f", "fx", "fy")


def perturbed(problem: Problem, options: SolveOptions, size: float, seed: int) -> Problem:
    """Return the problem with perturbed values of everything that a solve refines.

    ``size``: relative size s.
    """
    seeds = np.random.SeedSequence(seed).spawn(3)
    of_poses, of_points, of_cameras = map(np.random.default_rng, seeds)
    image, point = problem.observation_image, problem.observation_point
    distance = np.linalg.norm(problem.points[point] - problem.projection_centers[image], axis=1)
    changes: dict[str, Array] = {}
    if "poses" in options.refine:
        changes |= _poses(problem, options, size, of_poses, distance)
    if "points" in options.refine:
        fixed = np.isin(problem.point_ids, options.fixed_point_ids)
        nearest = _quantile_by(point, distance, problem.num_points, 0.0)
        moved = np.where(fixed | np.isnan(nearest), 0.0, nearest)
        step = size * moved[:, None] * of_points.standard_normal((len(moved), 3))
        changes["points"] = problem.points + step
    if "focal" in options.refine:
        changes["camera_params"] = _focal(problem, options, size, of_cameras)
    return problem.replace(**changes)


def _poses(
    problem: Problem,
    options: SolveOptions,
    size: float,
    rng: np.random.Generator,
    distance: Array,
) -> dict[str, Array]:
    """Return new poses of frames, and of images without a frame.

    Frames come first, then one unit per image; units of images with a frame are not used.
    """
    count = problem.num_frames
    own = np.full(problem.num_images, -1)
    if count:
        own = problem.image_frame
    unit = np.where(own >= 0, own, count + np.arange(problem.num_images))
    poses = np.concatenate([problem.rig_from_world, problem.cam_from_world])
    scale = _quantile_by(unit[problem.observation_image], distance, len(poses), 0.5)
    scale[unit[np.isin(problem.image_ids, options.fixed_image_ids)]] = np.nan
    moves = np.isfinite(scale)  # NaN: constant, or without observations
    noise = size * rng.standard_normal((2, len(poses), 3))
    rotation = poses[moves, :4] / np.linalg.norm(poses[moves, :4], axis=1, keepdims=True)
    centre = -quaternion_rotate(quaternion_inverse(rotation), poses[moves, 4:])
    centre = centre + scale[moves, None] * noise[0, moves]
    turned = quaternion_multiply(quaternion_from_vector(noise[1, moves]), rotation)
    poses[moves] = np.concatenate([turned, -quaternion_rotate(turned, centre)], axis=1)
    if not count:
        return {"cam_from_world": poses}
    frames, images = problem.replace(rig_from_world=poses[:count]), poses[count:]
    alone = (own < 0)[:, None]
    return {
        "rig_from_world": frames.rig_from_world,
        "cam_from_world": np.where(alone, images, frames.cam_from_world),
    }


def _focal(problem: Problem, options: SolveOptions, size: float, rng: np.random.Generator) -> Array:
    params = problem.camera_params.copy()
    factor = np.maximum(1.0 + size * rng.standard_normal(len(params)), 0.5)
    factor[np.isin(problem.camera_ids, options.fixed_camera_ids)] = 1.0
    names = camera_models()
    models = np.array(problem.camera_models)
    for model in dict.fromkeys(problem.camera_models):
        columns = [k for k, name in enumerate(names[model]) if name in _FOCAL]
        rows = np.flatnonzero(models == model)
        params[rows[:, None], columns] *= factor[rows, None]
    return params


def _quantile_by(group: NDArray[np.integer], values: Array, count: int, share: float) -> Array:
    """Return a quantile of the values of each group, (count,); NaN for empty groups."""
    order = np.lexsort((values, group))
    sizes = np.bincount(group, minlength=count)
    first = np.cumsum(sizes) - sizes
    found = np.full(count, np.nan)
    filled = sizes > 0
    at = first[filled] + (share * (sizes[filled] - 1)).astype(np.int64)
    found[filled] = values[order][at]
    return found


def predict(
    problem: Problem, options: SolveOptions, methods: Iterable[Method]
) -> dict[Method, Prediction]:
    """Return the predictions by method.

    Methods without an inspection have no prediction. If the inspection refuses the options, all
    predictions are missing; the runs then report the reason.
    """
    methods = tuple(methods)
    found: dict[Method, Prediction] = {}
    for num_threads in {method.num_threads for method in methods}:
        try:
            inspection = inspect(problem, options, num_threads=num_threads)
        except (InputError, MemoryError):
            continue
        for method in methods:
            match = _match(method, inspection) if method.num_threads == num_threads else None
            if match is not None:
                found[method] = _prediction(match, inspection)
    return found


def _match(method: Method, inspection: Inspection) -> MethodInspection | None:
    """Return the inspection of a method; of several orders, the cheapest."""
    fitting = [one for one in inspection.methods if one.is_taken and _is_that(method, one)]
    return min(fitting, key=lambda one: one.flops, default=None)


def _is_that(method: Method, inspected: MethodInspection) -> bool:
    same = (method.linear_solver_type, method.backend) == (
        inspected.linear_solver_type.lower(),
        inspected.backend.lower(),
    )
    cameras_first = inspected.ordering == "cameras_first"
    if not same or method.linear_solver_ordering != (
        "cameras_first" if cameras_first else "points_first"
    ):
        return False
    if method.is_iterative:
        wanted = method.preconditioner_type
        if wanted == "auto":
            wanted = AUTO_PRECONDITIONER[method.backend, method.linear_solver_type]
        return inspected.preconditioner.lower() == wanted
    return True


def _prediction(inspected: MethodInspection, inspection: Inspection) -> Prediction:
    columns = inspection.num_camera_columns
    reduces = "SCHUR" in inspected.linear_solver_type and inspected.ordering != "cameras_first"
    return Prediction(
        ordering=inspected.ordering if inspected.linear_solver_type.startswith("SPARSE") else "",
        num_unknowns=columns if reduces else inspected.num_unknowns,
        nnz_reduced=round(inspection.reduced_density * columns**2) if reduces else 0,
        nnz_factor=inspected.nnz_factor,
        flops=inspected.flops,
        memory_in_bytes=inspected.memory_in_bytes,
        time_per_step_in_seconds=inspected.time_per_step_in_seconds,
        fits_in_memory=inspected.fits_in_memory,
        note=inspected.note,
    )


def foresee(
    problem: Problem,
    options: SolveOptions,
    methods: Sequence[Method],
    predictions: Mapping[Method, Prediction],
    memory_cap: int = 0,
) -> Method | None:
    """Return the method that is predicted to be the fastest, without solving.

    With predicted times, it is the fastest method that fits into memory and under the cap (bytes
    beyond the problem; 0: no cap). Otherwise it is the choice of ``auto`` with the most threads, or
    None if that choice is not among the methods.
    """
    times = {
        method: predictions[method].time_per_step_in_seconds
        for method in methods
        if method in predictions and _fits(predictions[method], memory_cap)
    }
    times = {method: time for method, time in times.items() if math.isfinite(time)}
    if times:
        return min(times, key=lambda method: times[method])
    most = max(method.num_threads for method in methods)
    taken = taken_by_auto(problem, options, most)
    return taken if taken in methods else None


def _fits(prediction: Prediction, memory_cap: int) -> bool:
    within = not memory_cap or prediction.memory_in_bytes <= memory_cap
    return prediction.fits_in_memory and within


def taken_by_auto(problem: Problem, options: SolveOptions, num_threads: int) -> Method | None:
    """Return the backend and linear solver that ``auto`` chooses; None if these options fail.

    The choice comes from a solve without steps, which also evaluates the start.
    """
    asked = options.replace(
        backend="auto",
        linear_solver_type="auto",
        preconditioner_type="auto",
        linear_solver_ordering="points_first",
        num_threads=num_threads,
        max_num_iterations=0,
    )
    try:
        summary = solve(problem, asked).summary
    except (InputError, MemoryError):
        return None
    if summary.interrupted:  # a solve handles Ctrl-C itself
        raise KeyboardInterrupt
    return Method(
        backend=summary.backend_used.lower(),
        linear_solver_type=summary.linear_solver_type_used.lower(),
        num_threads=num_threads,
    )
