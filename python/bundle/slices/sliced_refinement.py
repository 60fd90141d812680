"""A BAL file or a binary COLMAP model refined by processes of which each has a slice."""

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
from bundle.free_degrees import gauge_freedom
from bundle.io import atomic, bal, colmap_files, save_model
from bundle.options import SolveOptions
from bundle.problem import Problem
from bundle.process_record import ProcessRecord, Traffic
from bundle.ranks.divided_solve import Crew, Job, PartOfOutput, Ranks, heeding, work_on
from bundle.ranks.partition import ProblemPart
from bundle.result import Result
from bundle.slices.divided_errors import divided_statistics
from bundle.slices.skeleton import skeleton
from bundle.slices.slice_reading import Meeting, Slice, Survey, read_slice, survey
from bundle.worst_images import sums_of_images, worst_of_sums

__all__ = ["SliceCrew", "SliceJob", "SlicedRefinement"]


@dataclass
class SliceJob:
    """What the other processes do: read, solve, measure."""

    path: Path

    def work(self, meeting: Meeting) -> None:
        """Take part in all that ``SlicedRefinement`` does."""
        own = read_slice(meeting, self.path, None)
        options = meeting.broadcast()
        end, _ = _solve(meeting, own, options, None)
        meeting.gather((end.given, end.point_errors()))
        _measure(meeting, own, options, end)


class SliceCrew(Crew, Protocol):
    """The processes, as the first of them sees them."""

    def meeting(self) -> Meeting:
        """Return how all of them meet."""

    def send_to_all(self, job: SliceJob) -> None:
        """Send a job to the others, which hear nothing else until its end."""

    def release(self) -> None:
        """Take note that the others wait again."""


class SlicedRefinement:
    """The first process's side of it. Calls have to come in the order of the methods.

    Args:
        crew: the others, which wait for a job.
        path: of a BAL file, or the folder of a COLMAP model in binary.

    Raises:
        InputError: as ``bundle.load``; or there are no observations.
        OSError: a file cannot be read.
    """

    def __init__(self, crew: SliceCrew, path: Path) -> None:
        self._crew, self._meeting, self._path = crew, crew.meeting(), path.absolute()
        found = survey(path, crew.num_ranks)
        if found.num_observations == 0:
            raise InputError(f"{shown(path)}: expected observations to refine, found none")
        crew.send_to_all(SliceJob(self._path))
        self._slice = read_slice(self._meeting, path, found)
        self._survey = found
        self._points: NDArray[np.float64] = np.zeros((0, 3))
        self._point_errors: NDArray[np.float64] = np.zeros(0)

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
        unknown = self._survey.unknown(fixed)
        if unknown.size:
            raise InputError(f"fixed_point_ids: expected ids in the problem, found {unknown[0]}")
        self._meeting.broadcast(self._options)
        end, ranks = _solve(
            self._meeting, self._slice, self._options, heeding(self._crew, progress)
        )
        self._end = end
        self._points = np.empty((len(self._survey.owner), 3))
        self._point_errors = np.empty(len(self._points))
        parts = []
        for rank, (given, errors) in enumerate(
            self._meeting.gather((end.given, end.point_errors()))
        ):
            mine = self._survey.owner == rank
            self._points[mine], self._point_errors[mine] = given.points, errors
            parts.append(given.process)
        traffic = tuple(
            Traffic(what=what, num_messages=int(n), num_bytes=int(size), seconds=seconds)
            for what, (n, size, seconds) in ranks.traffic.items()
        )
        end.output["summary"] |= {
            "num_processes": self._meeting.num_ranks,
            "processes": ProcessRecord(parts=tuple(parts), traffic=traffic),
        }
        result = solver.result_of(cameras, settled, end.output | {"points": cameras.points})
        self._refined = result.problem
        return dataclasses.replace(
            result,
            problem=cast("Problem", _Whole(self._refined, self._survey)),
            initial_problem=self.cameras,
        )

    def save(self, path: Path) -> tuple[str, ...]:
        """Write the refined model; return what is lost by that, one sentence each.

        Raises:
            InputError: the input has changed.
            OSError: a file cannot be read or written.
        """
        found = self._survey
        ids = found.point_ids
        if ids is None:
            with atomic.replace_file(path) as temporary:
                bal.save_like(
                    self._path, found.num_observations, self._refined, self._points, temporary
                )
            return ()

        def write(folder: Path) -> tuple[str, ...]:
            colmap_files.rewrite_like(self._refined, ids, self._points, self._point_errors, folder)
            return ()

        return save_model(path, "colmap", write)

    def measure(self, result: Result) -> None:
        """Measure the errors before and after, and the worst images, into the result."""
        before, after, sums, bones = _measure(self._meeting, self._slice, self._options, self._end)
        values = vars(result)  # where cached_property keeps them; the dataclass itself is frozen
        values["reprojection_error_before"] = before
        values["reprojection_error_after"] = after
        count, total, largest = zip(*sums, strict=True)
        values["worst_images"] = worst_of_sums(
            self._refined, sum(count), sum(total), np.max(largest, axis=0)
        )
        if bones is not None:
            values["gauge_freedom"] = gauge_freedom(bones, result.options)
        self._crew.release()


class _Whole:
    """Cameras of a file with its counts of points and observations, for reports."""

    def __init__(self, cameras: Problem, found: Survey) -> None:
        self._cameras = cameras
        vars(self)["source"] = vars(cameras)["source"]  # without pycolmap
        self.num_points = len(found.owner)
        self.num_observations = found.num_observations

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cameras, name)


@dataclass
class _End:
    """Where a solve has brought one process.

    Attributes:
        output: of the core, points of the part.
        given: what the first process gets of it.
        part: with the refined numbers.
        errors: (num_observations,) ||r|| after the solve, in pixels.
        behind: (num_observations,) whether a point is behind its camera.
    """

    output: dict[str, Any]
    given: PartOfOutput
    part: ProblemPart
    errors: NDArray[np.float64]
    behind: NDArray[np.bool_]

    def point_errors(self) -> NDArray[np.float64]:
        """Return the mean error of each point of the part, as COLMAP's files have it."""
        return colmap_files.point_errors(
            self.errors, self.behind, self.part.observation_point, len(self.part.points)
        )


def _solve(
    meeting: Meeting,
    own: Slice,
    options: dict[str, Any],
    progress: Callable[[dict[str, Any]], None] | None,
) -> tuple[_End, Ranks]:
    fixed = np.intersect1d(np.asarray(options["fixed_point_ids"], np.int64), own.part.point_ids)
    given_options = options | {"fixed_point_ids": fixed.tolist()}
    ranks = meeting.ranks()
    job = Job(own.part, given_options, None, None, own.image_is_observed)
    output, given = work_on(job, ranks, progress)
    state = {name: freeze(output[name]) for name in solver.STATE if name in output}
    points = state.pop("points")
    part = dataclasses.replace(own.part, points=points, shared=own.part.shared | state)
    return _End(output, given, part, *_errors(part, options)), ranks


def _errors(part: ProblemPart, options: dict[str, Any]) -> tuple[Any, Any]:
    return _core.reprojection_errors(part, options["num_threads"])  # type: ignore[arg-type]


def _measure(meeting: Meeting, own: Slice, options: dict[str, Any], end: _End) -> Any:
    """Return, to the first, the statistics before and after, the sums of images, the skeleton.

    There is no skeleton where nobody asks for the gauge.
    """
    cheirality = options["cheirality"]
    before = divided_statistics(meeting, *_errors(own.part, options), cheirality)
    sums = sums_of_images(
        own.part.observation_image, own.cameras.num_images, end.errors, end.behind, cheirality
    )
    after = divided_statistics(meeting, end.errors, end.behind, cheirality)
    asked = own.cameras.num_frames > 0 and options["gauge"] != "none"
    bones = skeleton(meeting, own, options["fixed_point_ids"]) if asked else None
    return before, after, meeting.gather(sums), bones
