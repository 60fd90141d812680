"""Refinement of a BAL file or a binary COLMAP model in slices: of processes, or on disk."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import freeze
from bundle.base.records import dataclass
from bundle.errors import InputError, shown
from bundle.interface.options import SolveOptions
from bundle.interface.solve_record import Progress
from bundle.io import bal, colmap
from bundle.io.atomic import atomic_write as atomic
from bundle.io.georeference_file import remove_georeference
from bundle.io.open import save_model
from bundle.model.estimates import estimates, with_estimates
from bundle.model.problem import Problem
from bundle.model.residuals import worst_of_sums
from bundle.solving.executors import solve_prepared
from bundle.solving.gauge_freedom import gauge_freedom
from bundle.solving.kept_errors import PixelErrors, outlier_limit
from bundle.solving.prepare import Executor, Prepared, prepare
from bundle.solving.ranks.crew import Crew, Meeting
from bundle.solving.ranks.divided_solve import heeding, process_record
from bundle.solving.request import SolveRequest
from bundle.solving.result import Result
from bundle.solving.rounds.checkpoint import Checkpoint, result_of_record, solve_in_segments
from bundle.solving.rounds.input_digest import digest_of_parts, plain_fingerprint
from bundle.solving.rounds.plan import RunPlan, State
from bundle.solving.slices.scratch_size import RESIDENT_BYTES, refuse_small_disk
from bundle.solving.slices.slice_process import (
    Process,
    measure_on_disk,
    point_errors_on_disk,
    rmse_on_disk,
)
from bundle.solving.slices.slice_reading import Survey, survey


@dataclass
class SliceJob:
    """The job of the other ranks: read a slice, then serve rank 0."""

    path: Path

    def work(self, meeting: Meeting) -> None:
        """Serve the calls of ``SlicedRefinement``."""
        Process(meeting, self.path, None).serve()


class SliceCrew(Crew, Protocol):
    """Interface of rank 0 to the other processes."""

    def meeting(self) -> Meeting:
        """Return the communication of all ranks."""

    def send_to_all(self, job: SliceJob) -> None:
        """Send a job to the other ranks, which accept no other job until it ends."""

    def release(self) -> None:
        """Record that the other ranks wait for a job again."""


@dataclass(frozen=True)
class AllSlices:
    """Executor on all processes, each with its slice; starts and results are divided models."""

    crew: SliceCrew  # the other ranks
    process: Process  # the process of rank 0
    owner: NDArray[np.uint16]  # (num_points,) rank of each point

    def run(self, prepared: Prepared, progress: Progress | None) -> dict[str, Any]:
        """Adjust from the values of all processes; see :meth:`Executor.run`."""
        output, given, ranks = self.process.run_on_all(
            "solve", prepared.layout.options.asdict(), progress=heeding(self.crew, progress)
        )
        points = np.empty((len(self.owner), 3))
        for rank, of_rank in enumerate(given):
            points[self.owner == rank] = of_rank.points
        output["summary"] |= {
            "num_processes": self.crew.num_ranks,
            "processes": process_record([of_rank.process for of_rank in given], ranks),
        }
        return {**output, "points": freeze(points)}


class SlicedRefinement:
    """Refinement as seen by rank 0. Call the methods in the order of definition.

    ``crew``: the other ranks, which wait for a job; None: this process has the only slice.
    ``path``: path of a BAL file, or of the folder of a binary COLMAP model.
    """

    def __init__(self, crew: SliceCrew | None, path: Path) -> None:
        self._crew = crew
        self._path = path.absolute()
        found = survey(path, 1 if crew is None else crew.num_ranks)
        if found.num_observations == 0:
            raise InputError(f"{shown(path)}: expected observations to refine, found 0")
        self._process, self._executor = self._started(found)
        self._slice = self._process.slice
        self._survey = found
        self._model = DividedModel.of(self._slice.cameras, found)

    def _started(self, found: Survey) -> tuple[Process, Executor]:
        """Read the slice of this process; return the process and the executor on all."""
        assert self._crew is not None  # else OutOfCoreRefinement
        self._crew.send_to_all(SliceJob(self._path))
        process = Process(self._crew.meeting(), self._path, found)
        return process, AllSlices(self._crew, process, found.owner)

    @property
    def cameras(self) -> Problem:
        """Images and cameras of the model as it was read; the points are in the slices."""
        return self._model

    def solve(
        self,
        options: SolveOptions,
        progress: Progress | None,
        plan: RunPlan | None = None,
    ) -> Result:
        """Refine the model. The initial problem of the result has cameras only.

        ``plan``: checkpoints, which hold the entire model and can be resumed with any number of
        processes; rounds and held-out observations are not served. None: no checkpoint.
        """
        prepared = prepare(SolveRequest(problem=self._model, options=options))
        settled = prepared.layout.options
        self._options = settled.asdict()
        unknown = self._survey.unknown(np.asarray(settled.fixed_point_ids, np.int64))
        if unknown.size:
            raise InputError(f"fixed_point_ids: expected ids in the problem, found {unknown[0]}")

        def solve(problem: Problem, used: SolveOptions, told: Progress | None) -> Result:
            return solve_prepared(prepared.laid_out_at(problem, used), told, self._executor)

        if plan is None or plan.file is None:
            return self._finished(solve(self._model, settled, progress))
        digest = digest_of_parts(self._slice.cameras, self._process.run_on_all("digest"))
        fingerprint = plain_fingerprint(digest, options, plan)
        checkpoint = Checkpoint(plan.file, fingerprint, plan.checkpoint_interval)
        start, so_far, has_ended = self._model, None, False
        if plan.resume is not None and plan.resume.exists():
            state, so_far, has_ended = checkpoint.read_by(partial(self._kept, settled), plan.resume)
            start = with_estimates(start, state)
            self._process.run_on_all("restart", state, points=state.pop("points"))
            if so_far is not None:
                so_far = dataclasses.replace(so_far, problem=start)
        if so_far is None or not has_ended:
            so_far = solve_in_segments(
                solve,
                start,
                settled,
                plan.checkpoint_interval,
                so_far=so_far,
                progress=progress,
                save=lambda result: checkpoint.write(self._state(result)),
            )
            if so_far.summary.is_solution_usable and not so_far.summary.interrupted:
                checkpoint.write(self._state(so_far, end=so_far))
        return self._finished(so_far)

    def _state(self, result: Result, end: Result | None = None) -> State:
        """Return the state after a result, from which the next solve starts."""
        return State(
            problem=result.problem,
            observation_mask=np.broadcast_to(True, self._survey.num_observations),
            point_mask=np.broadcast_to(True, len(self._survey.owner)),
            so_far=result,
            end=end,
        )

    def _kept(
        self, options: SolveOptions, meta: dict[str, Any], arrays: dict[str, NDArray[Any]]
    ) -> tuple[dict[str, Any], Result | None, bool]:
        """Return what a checkpoint holds: the estimates of the entire model, the result so far.

        The result's problem has no points. The flag is True if nothing is left to do.
        """
        cameras = self._slice.cameras
        expected = {name: of.shape for name, of in estimates(cameras).items()}
        expected["points"] = (len(self._survey.owner), 3)
        state = {name: freeze(np.array(arrays[name], np.float64)) for name in expected}
        for name, shape in expected.items():
            if state[name].shape != shape or not np.isfinite(state[name]).all():
                raise ValueError(f"{name}: expected shape {shape}, found {state[name].shape}")
        so_far = meta["so_far"]
        if so_far is not None:
            so_far = result_of_record(so_far, arrays, cameras, options)
        return state, so_far, bool(meta["has_ended"])

    def save(self, path: Path) -> tuple[str, ...]:
        """Write the refined model; return one sentence for each kind of data that is lost."""
        found, refined = self._survey, self._refined
        ids = found.point_ids
        if ids is None:
            with atomic.replace_file(path) as temporary:
                bal.save_like(
                    self._path, found.num_observations, refined, refined.points, temporary
                )
                remove_georeference(path, is_folder=False)
            return ()
        parts = self._process.run_on_all("point_errors", self._options["num_threads"])
        errors = parts[0]
        if len(parts) > 1:
            errors = np.empty(len(ids))
            for rank, given in enumerate(parts):
                errors[found.owner == rank] = given

        def write(folder: Path) -> tuple[str, ...]:
            colmap.rewrite_like(refined, ids, refined.points, errors, folder)
            return ()

        return save_model(path, "colmap", write)

    def measure(self, result: Result) -> None:
        """Compute the errors before and after and the worst images; store them in the result."""
        limit = outlier_limit(self._slice.cameras, result.options)
        measured, sums, gauge = self._process.run_on_all("measure", self._options, limit)
        result.measured(measured)
        values = vars(result)  # storage of cached_property; the dataclass itself is frozen
        count, total, largest = zip(*sums, strict=True)
        values["worst_images"] = worst_of_sums(
            self._refined, sum(count), sum(total), np.max(largest, axis=0)
        )
        if gauge is not None:
            values["gauge_freedom"] = gauge_freedom(gauge, result.options)
        if self._crew is not None:
            self._crew.release()

    def _finished(self, result: Result) -> Result:
        self._refined = result.problem
        return dataclasses.replace(result, initial_problem=self._model)


class DividedModel(Problem):
    """Model whose points and observations are in slices.

    It holds the cameras, the counts, and after a solve also the points.
    """

    _census: Survey

    @staticmethod
    def of(cameras: Problem, found: Survey) -> DividedModel:
        """Return the model of these cameras, with the counts of a survey and without points."""
        model = object.__new__(DividedModel)
        vars(model).update(vars(cameras), points=freeze(np.zeros((0, 3))), _census=found)
        return model

    @property
    def num_points(self) -> int:
        """Number of points in all slices."""
        return len(self._census.owner)

    @property
    def num_observations(self) -> int:
        """Number of observations in all slices."""
        return self._census.num_observations


# Refinement of a model whose observations and points are on disk.
#
# The core allocates their arrays in files of the scratch folder (``cpp/core/scratch``), and one
# process has the only slice. The result equals that of a model in memory, bit for bit.


@contextmanager
def scratch_folder(folder: str) -> Iterator[None]:
    """Allocate the large arrays of the core in files of a folder."""
    if not Path(folder).is_dir():
        raise InputError(f"--out-of-core: expected a folder, found {shown(folder)}")
    try:
        _core.open_scratch(os.fsencode(folder), RESIDENT_BYTES)
    except _core.InputError as error:
        raise InputError(f"--out-of-core: {error}") from None
    try:
        yield
    finally:
        _core.close_scratch()


class LoneProcess(Process):
    """Process with the complete model on disk, and the executor on it."""

    def run(self, prepared: Prepared, progress: Progress | None) -> dict[str, Any]:
        """Return the output of the core from the current values; see :meth:`Executor.run`.

        Ceres would keep the problem in memory, so the backend is fused.
        """
        options = prepared.layout.options.asdict() | {"backend": "fused"}
        output = _core.solve(self._part, options, progress, None, None)
        self._move(output)
        return output

    def point_errors(self, num_threads: int) -> list[NDArray[np.float64]]:
        """Return the mean error of each point, as defined in COLMAP's files."""
        found = self._errors_now(num_threads, "auto")
        part = self._part
        lost = colmap.NO_PROJECTION
        return [point_errors_on_disk(*found, part.observation_point, len(part.points), lost)]

    def rmse_global_shutters(self, options: dict[str, Any]) -> float:
        """Return the RMSE at the input if all shutters were global, in pixels."""
        part, cheirality = self.slice.part, options["cheirality"]
        part = part._moved(rolling_shutter=None)
        found = _core.reprojection_errors(part, options["num_threads"], cheirality)
        return rmse_on_disk(PixelErrors(*found, cheirality))

    def _measured(self, before: PixelErrors, after: PixelErrors, limit: float | None) -> Any:
        return measure_on_disk(before, after, limit)


class OutOfCoreRefinement(SlicedRefinement):
    """Refinement by one process within :func:`scratch_folder`; see ``SlicedRefinement``."""

    def __init__(self, path: Path, folder: str) -> None:
        self._folder = folder
        super().__init__(None, path)

    def _started(self, found: Survey) -> tuple[Process, Executor]:
        refuse_small_disk(self._folder, found.num_observations, len(found.owner))
        self._lone = LoneProcess(Meeting(), self._path, found)
        return self._lone, self._lone

    def measure(self, result: Result) -> None:
        """See :meth:`SlicedRefinement.measure`."""
        super().measure(result)
        if result.problem.rolling_shutter is not None:
            vars(result)["rmse_global_shutters"] = self._lone.rmse_global_shutters(self._options)
