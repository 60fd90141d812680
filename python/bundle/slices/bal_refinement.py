"""A BAL file refined by processes of which each has a slice."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from bundle import _core, solver
from bundle.arrays import freeze
from bundle.errors import InputError, shown
from bundle.io import atomic, bal
from bundle.options import SolveOptions
from bundle.problem import Problem
from bundle.process_record import ProcessRecord, Traffic
from bundle.ranks.divided_solve import Crew, Job, PartOfOutput, Ranks, heeding, work_on
from bundle.result import Result
from bundle.slices.divided_errors import divided_statistics
from bundle.slices.slice_reading import Meeting, Slice, Survey, read_slice, survey
from bundle.solve_record import record_fields
from bundle.worst_images import sums_of_images, worst_of_sums

__all__ = ["BalRefinement", "SliceCrew", "SliceJob"]


@dataclass
class SliceJob:
    """What the other processes do: read, solve, measure."""

    path: Path

    def work(self, meeting: Meeting) -> None:
        """Take part in all that ``BalRefinement`` does."""
        own = read_slice(meeting, self.path, None)
        options = meeting.broadcast()
        output, given, _ = _solve(meeting, own, options, None)
        meeting.gather(given)
        _measure(meeting, own, options, output)


class SliceCrew(Crew, Protocol):
    """The processes, as the first of them sees them."""

    def meeting(self) -> Meeting:
        """Return how all of them meet."""

    def send_to_all(self, job: SliceJob) -> None:
        """Send a job to the others, which hear nothing else until its end."""

    def release(self) -> None:
        """Take note that the others wait again."""


class BalRefinement:
    """The first process's side of it. Calls have to come in the order of the methods.

    Args:
        crew: the others, which wait for a job.
        path: of the file.

    Raises:
        InputError: as ``bundle.load``; or there are no observations.
        OSError: the file cannot be read.
    """

    def __init__(self, crew: SliceCrew, path: Path) -> None:
        self._crew, self._meeting, self._path = crew, crew.meeting(), path.absolute()
        found = survey(path, crew.num_ranks)
        if found.num_observations == 0:
            raise InputError(f"{shown(path)}: expected observations to refine, found none")
        crew.send_to_all(SliceJob(self._path))
        self._slice = read_slice(self._meeting, path, found)
        self._survey = found
        self._output: dict[str, Any] = {}
        self._points: NDArray[np.float64] = np.zeros((0, 3))

    @property
    def cameras(self) -> Problem:
        """The cameras of the file as it is; counts of points and observations are the file's."""
        return cast("Problem", _Whole(self._slice.cameras, self._survey))

    def solve(
        self, options: SolveOptions, progress: Callable[[dict[str, Any]], None] | None
    ) -> Result:
        """Refine; the problems of the result have cameras only."""
        cameras = self._slice.cameras
        settled = solver.resolve_defaults(cameras, options)
        self._options = settled.asdict()
        fixed = np.asarray(settled.fixed_point_ids, np.int64)
        unknown = fixed[(fixed < 0) | (fixed >= len(self._survey.owner))]
        if unknown.size:
            raise InputError(f"fixed_point_ids: expected ids in the problem, found {unknown[0]}")
        self._meeting.broadcast(self._options)
        output, own, ranks = _solve(
            self._meeting, self._slice, self._options, heeding(self._crew, progress)
        )
        self._output = output
        self._points = np.empty((len(self._survey.owner), 3))
        parts = []
        for rank, given in enumerate(self._meeting.gather(own)):
            self._points[self._survey.owner == rank] = given.points
            parts.append(given.process)
        traffic = tuple(
            Traffic(what=what, num_messages=int(n), num_bytes=int(size), seconds=seconds)
            for what, (n, size, seconds) in ranks.traffic.items()
        )
        output["summary"] |= {
            "num_processes": self._meeting.num_ranks,
            "processes": ProcessRecord(parts=tuple(parts), traffic=traffic),
        }
        state = {name: freeze(output[name]) for name in ("cam_from_world", "camera_params")}
        self._refined = cameras._moved(**state)
        return Result(
            problem=cast("Problem", _Whole(self._refined, self._survey)),
            initial_problem=self.cameras,
            options=settled,
            **record_fields(output),
        )

    def save(self, path: Path) -> tuple[str, ...]:
        """Write the refined file; return what the format does not keep: nothing."""
        with atomic.replace_file(path) as temporary:
            number = self._survey.num_observations
            bal.save_like(self._path, number, self._refined, self._points, temporary)
        return ()

    def measure(self, result: Result) -> None:
        """Measure the errors before and after, and the worst images, into the result."""
        before, after, sums = _measure(self._meeting, self._slice, self._options, self._output)
        values = vars(result)  # where cached_property keeps them; the dataclass itself is frozen
        values["reprojection_error_before"] = before
        values["reprojection_error_after"] = after
        count, total, largest = zip(*sums, strict=True)
        values["worst_images"] = worst_of_sums(
            self._refined, sum(count), sum(total), np.max(largest, axis=0)
        )
        self._crew.release()


class _Whole:
    """Cameras of a file with its counts of points and observations, for reports."""

    def __init__(self, cameras: Problem, found: Survey) -> None:
        self._cameras = cameras
        self.num_points = len(found.owner)
        self.num_observations = found.num_observations

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cameras, name)


def _solve(
    meeting: Meeting,
    own: Slice,
    options: dict[str, Any],
    progress: Callable[[dict[str, Any]], None] | None,
) -> tuple[dict[str, Any], PartOfOutput, Ranks]:
    fixed = np.intersect1d(np.asarray(options["fixed_point_ids"], np.int64), own.points)
    options = options | {"fixed_point_ids": fixed.tolist()}
    ranks = meeting.ranks()
    job = Job(own.part, options, None, None, own.image_is_observed)
    return *work_on(job, ranks, progress), ranks


def _measure(
    meeting: Meeting, own: Slice, options: dict[str, Any], output: dict[str, Any]
) -> tuple[Any, Any, Any]:
    """Return, to the first, the statistics before and after and the sums of images after."""
    cheirality = options["cheirality"]
    errors, behind = _core.reprojection_errors(own.part, options["num_threads"])  # type: ignore[arg-type]
    before = divided_statistics(meeting, errors, behind, cheirality)
    names = ("cam_from_world", "camera_params")
    shared = own.part.shared | {name: freeze(output[name]) for name in names}
    moved = dataclasses.replace(own.part, points=freeze(output["points"]), shared=shared)
    errors, behind = _core.reprojection_errors(moved, options["num_threads"])  # type: ignore[arg-type]
    sums = sums_of_images(
        own.part.observation_image, own.cameras.num_images, errors, behind, cheirality
    )
    after = divided_statistics(meeting, errors, behind, cheirality)
    return before, after, meeting.gather(sums)
