"""Refinement of a BAL file or a binary COLMAP model by processes that each have a slice."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError, shown
from bundle.interface.options import SolveOptions
from bundle.interface.round_options import CHECKPOINT_INTERVAL
from bundle.interface.solve_record import Progress
from bundle.io import bal, colmap
from bundle.io.atomic import atomic_write as atomic
from bundle.io.georeference_file import remove_georeference
from bundle.io.open import save_model
from bundle.model.problem import Problem
from bundle.model.worst_images import worst_of_sums
from bundle.solving.gauge_freedom import gauge_freedom
from bundle.solving.prepare import Prepared, prepare
from bundle.solving.ranks.crew import Crew
from bundle.solving.ranks.divided_solve import heeding, process_record
from bundle.solving.request import RunPlan, SolveRequest
from bundle.solving.result import Result
from bundle.solving.rounds.segments import solve_in_segments
from bundle.solving.slices.slice_process import Process
from bundle.solving.slices.slice_reading import Meeting, Survey, survey
from bundle.solving.slices.sliced_checkpoint import SlicedCheckpoint

__all__ = ["SliceCrew", "SliceJob", "SlicedRefinement"]


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
        """Mark the other ranks as waiting again."""


class SlicedRefinement:
    """Refinement as seen by rank 0; also an executor. Call the methods in the order of definition.

    Args:
        crew: the other ranks, which wait for a job.
        path: path of a BAL file, or of the folder of a binary COLMAP model.

    Raises:
        InputError: for the reasons of ``bundle.load``; or the model has no observations.
        OSError: a file cannot be read.
    """

    def __init__(self, crew: SliceCrew, path: Path) -> None:
        self._crew, self._num_ranks = crew, crew.num_ranks
        self._path = path.absolute()
        found = survey(path, crew.num_ranks)
        if found.num_observations == 0:
            raise InputError(f"{shown(path)}: expected observations to refine, found 0")
        crew.send_to_all(SliceJob(self._path))
        self._process = Process(crew.meeting(), path, found)
        self._slice = self._process.slice
        self._survey = found
        self._now = self._slice.cameras
        self._points: NDArray[np.float64] = np.zeros((0, 3))

    @property
    def cameras(self) -> Problem:
        """Images and cameras of the model as it was read; the points are in the slices."""
        return DividedModel.of(self._slice.cameras, self._survey, np.zeros((0, 3)))

    def solve(
        self,
        options: SolveOptions,
        progress: Progress | None,
        *,
        checkpoint: str | os.PathLike[str] | None = None,
        resume: str | os.PathLike[str] | None = None,
        checkpoint_interval: int = CHECKPOINT_INTERVAL,
    ) -> Result:
        """Refine the model. The problems of the result have cameras only.

        Args:
            options: options of the solve.
            progress: function called after each iteration.
            checkpoint: as in :func:`bundle.solve_rounds`; the file holds the entire model and can
                be resumed with any number of processes.
            resume: as in :func:`bundle.solve_rounds`.
            checkpoint_interval: as in :func:`bundle.solve_rounds`.

        Raises:
            InputError, OSError: for the reasons of :func:`bundle.solve_rounds`.
        """
        self._prepared = prepare(SolveRequest(problem=self._slice.cameras, options=options))
        settled = self._prepared.layout.options
        self._options = settled.asdict()
        unknown = self._survey.unknown(np.asarray(settled.fixed_point_ids, np.int64))
        if unknown.size:
            raise InputError(f"fixed_point_ids: expected ids in the problem, found {unknown[0]}")
        plan = RunPlan(
            checkpoint=checkpoint,  # type: ignore[arg-type]
            resume=resume,  # type: ignore[arg-type]
            checkpoint_interval=checkpoint_interval,
        )
        if plan.file is None:
            return self._finished(self._segment(settled, progress))
        resume, interval = plan.resume, plan.checkpoint_interval
        sums = self._process.run_on_all("digest")
        keeper = SlicedCheckpoint(
            plan.file, self._slice.cameras, sums, self._survey, options, interval
        )
        so_far, has_ended = None, False
        if resume is not None and resume.exists():
            kept = keeper.read(resume, settled)
            state = kept.state
            self._points = state.pop("points")
            self._now = self._now._moved(**state)
            self._process.run_on_all("restart", state, points=self._points)
            so_far, has_ended = kept.so_far, kept.has_ended
            if so_far is not None:
                so_far = dataclasses.replace(so_far, problem=self._model(self._now))
        if so_far is None or not has_ended:
            so_far = solve_in_segments(
                lambda _, used, told: self._segment(used, told),
                self._model(self._now),
                settled,
                interval,
                so_far=so_far,
                progress=progress,
                save=keeper.write,
            )
            if so_far.summary.is_solution_usable and not so_far.summary.interrupted:
                keeper.write(so_far, has_ended=True)
        return self._finished(so_far)

    def save(self, path: Path) -> tuple[str, ...]:
        """Write the refined model; return one sentence for each kind of data that is lost.

        Raises:
            InputError: the input has changed.
            OSError: a file cannot be read or written.
        """
        found = self._survey
        ids = found.point_ids
        if ids is None:
            with atomic.replace_file(path) as temporary:
                bal.save_like(
                    self._path, found.num_observations, self._now, self._points, temporary
                )
                remove_georeference(path, is_folder=False)
            return ()
        errors = np.empty(len(ids))
        for rank, given in enumerate(
            self._process.run_on_all("point_errors", self._options["num_threads"])
        ):
            errors[found.owner == rank] = given

        def write(folder: Path) -> tuple[str, ...]:
            colmap.rewrite_like(self._now, ids, self._points, errors, folder)
            return ()

        return save_model(path, "colmap", write)

    def measure(self, result: Result) -> None:
        """Compute the errors before and after and the worst images; store them in the result."""
        before, after, sums, gauge = self._process.run_on_all("measure", self._options)
        values = vars(result)  # storage of cached_property; the dataclass itself is frozen
        values["reprojection_error_before"] = before
        values["reprojection_error_after"] = after
        count, total, largest = zip(*sums, strict=True)
        values["worst_images"] = worst_of_sums(
            self._now, sum(count), sum(total), np.max(largest, axis=0)
        )
        if gauge is not None:
            values["gauge_freedom"] = gauge_freedom(gauge, result.options)
        self._crew.release()

    def run(self, prepared: Prepared, progress: Progress | None) -> dict[str, Any]:
        """Adjust from the present values; see :meth:`Executor.run`."""
        output, given, ranks = self._process.run_on_all(
            "solve", prepared.layout.options.asdict(), progress=heeding(self._crew, progress)
        )
        self._points = np.empty((len(self._survey.owner), 3))
        for rank, of_rank in enumerate(given):
            self._points[self._survey.owner == rank] = of_rank.points
        record = process_record([of_rank.process for of_rank in given], ranks)
        output["summary"] |= {"num_processes": self._num_ranks, "processes": record}
        return {**output, "points": prepared.before.points}

    def _segment(self, options: SolveOptions, progress: Progress | None) -> Result:
        """Adjust from the present values, and replace them by the result."""
        before = self._now
        prepared = self._prepared.laid_out_at(before, options)
        result = prepared.result(self.run(prepared, progress))
        self._now = result.problem
        return dataclasses.replace(
            result, problem=self._model(self._now), initial_problem=self._model(before)
        )

    def _finished(self, result: Result) -> Result:
        return dataclasses.replace(result, initial_problem=self.cameras)

    def _model(self, cameras: Problem) -> Problem:
        return DividedModel.of(cameras, self._survey, self._points)


class DividedModel(Problem):
    """Model whose points and observations are in slices: cameras, counts, and refined points."""

    _census: Survey

    @staticmethod
    def of(cameras: Problem, found: Survey, points: NDArray[np.float64]) -> DividedModel:
        """Return the model of these cameras, with the counts of a survey."""
        model = object.__new__(DividedModel)
        vars(model).update(vars(cameras), points=points, _census=found)
        return model

    @property
    def num_points(self) -> int:
        """Number of points in all slices."""
        return len(self._census.owner)

    @property
    def num_observations(self) -> int:
        """Number of observations in all slices."""
        return self._census.num_observations
