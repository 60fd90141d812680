"""Process of a refinement in slices, with statistics of its errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import freeze
from bundle.base.components import component_roots
from bundle.io import colmap
from bundle.model.estimates import with_estimates
from bundle.model.problem import Problem
from bundle.model.residuals import (
    ReprojectionError,
    between,
    counted_errors,
    quantiles,
    statistics_of,
    sums_of_images,
)
from bundle.solving import kept_errors
from bundle.solving.kept_errors import (
    Inliers,
    KeptErrors,
    Measured,
    PixelErrors,
    Totals,
    inlier_sums,
)
from bundle.solving.ranks.crew import Job, Meeting, PartOfOutput, Ranks
from bundle.solving.ranks.divided_solve import work_on
from bundle.solving.ranks.partition import ProblemPart
from bundle.solving.rounds.input_digest import sums_of_rows
from bundle.solving.slices.slice_reading import Slice, Survey, blocks, read_slice

# Statistics of reprojection errors on disk, with temporaries of one block.
#
# The results are those of ``kept_errors.measure`` for a solve that keeps all observations. Errors
# are compressed in place to those that count, block by block; order statistics partition them in
# place.


def measure_on_disk(before: PixelErrors, after: PixelErrors, limit: float | None) -> Measured:
    """Return all statistics; the errors are overwritten.

    ``limit``: error of an outlier in pixels; None: do not separate outliers.
    """
    num_observations = len(after.errors)
    behind = int(before.behind.sum()), int(after.behind.sum())
    differ, sums = False, np.zeros(6)
    for block in blocks(num_observations):
        start, end = _counted(before, block), _counted(after, block)
        differ = differ or bool((start != end).any())
        if limit is not None:
            both = start & end
            sums += inlier_sums(before.errors[block][both], after.errors[block][both], limit)
    joint = None
    if differ:
        joint = tuple(
            _summarize(_compressed(before, after, which, num_observations), behind[which])
            for which in (0, 1)
        )
    first, last = (
        _summarize(_compressed(found, found, None, num_observations), count)
        for found, count in zip((before, after), behind, strict=True)
    )
    compared = (first, last) if joint is None else joint
    inliers = None if limit is None else Inliers.of_sums(limit, sums)
    kept = KeptErrors(
        before=compared[0], after=compared[1], num_observations=num_observations, inliers=inliers
    )
    return Measured(first, last, kept)


def rmse_on_disk(found: PixelErrors) -> float:
    """Return the RMSE of the errors that count; they are overwritten."""
    size = len(found.errors)
    return _summarize(_compressed(found, found, None, size), 0).rmse


def point_errors_on_disk(
    errors: NDArray[np.float64],
    behind: NDArray[np.bool_],
    point: NDArray[np.int32],
    num_points: int,
    no_projection: float,
) -> NDArray[np.float64]:
    """Return the output of ``colmap.point_errors`` as an array on disk."""
    sums = _core.large_array(num_points, np.dtype(np.float64))
    counts = _core.large_array(num_points, np.dtype(np.int32))
    sums.fill(0.0)
    counts.fill(0)
    for block in blocks(len(errors)):
        at = point[block]
        lost = behind[block] | np.isnan(errors[block])
        np.add.at(sums, at, np.where(lost, no_projection, errors[block]))
        np.add.at(counts, at, 1)
    for block in blocks(num_points):
        seen = counts[block] > 0
        sums[block] = np.where(seen, sums[block] / np.maximum(counts[block], 1), -1.0)
    return sums


def _counted(found: PixelErrors, block: slice) -> NDArray[np.bool_]:
    return counted_errors(found.errors[block], found.behind[block], found.cheirality)


def _compressed(
    one: PixelErrors, other: PixelErrors, which: int | None, size: int
) -> NDArray[np.float64]:
    """Return errors that count in both, from ``one`` or ``other``; None: of ``one``, in place."""
    source = (one, other)[which or 0].errors
    target = source if which is None else _core.large_array(size, np.dtype(np.float64))
    count = 0
    for block in blocks(size):
        counts = _counted(one, block)
        if which is not None:
            counts &= _counted(other, block)
        kept = source[block][counts]
        target[count : count + len(kept)] = kept
        count += len(kept)
    return target[:count]


def _summarize(errors: NDArray[np.float64], num_behind: int) -> ReprojectionError:
    """Return the statistics of errors that count, which are reordered."""
    total = squares = largest = 0.0
    with np.errstate(over="ignore"):
        for block in blocks(len(errors)):
            total += float(errors[block].sum())
            squares += float((errors[block] ** 2).sum())
            largest = max(largest, float(errors[block].max()))
    sums = total, squares, largest
    return statistics_of(len(errors), sums, lambda: quantiles(errors, [0.5, 0.95]), num_behind)


# Statistics of reprojection errors whose observations are in several processes.
#
# Sums and maxima are combined from those of the processes. An order statistic, such as the median,
# is found by bisection. Non-negative doubles have the same order as the integers of their bits, so
# that 63 bisection steps find the k-th smallest error. In each step, every process counts its
# errors up to the middle. The result is exact, and no process needs the errors of another one.


class DividedErrors(Totals):
    """Errors of all processes of a meeting; rank 0 gets the statistics."""

    def __init__(self, meeting: Meeting) -> None:
        self._meeting = meeting

    def add_up(self, sums: NDArray[Any]) -> NDArray[Any] | None:
        """Return the sums over all ranks to rank 0."""
        given = self._meeting.gather(sums)
        total: NDArray[Any] | None = None if given is None else np.sum(given, axis=0)
        return total

    def tell(self, value: Any) -> Any:
        """Return the value of rank 0."""
        return self._meeting.broadcast(value)

    def summarize(self, found: PixelErrors) -> ReprojectionError | None:
        """Return statistics of the errors of all ranks to rank 0."""
        return divided_statistics(self._meeting, *found)


def divided_statistics(
    meeting: Meeting, errors: NDArray[np.float64], behind: NDArray[np.bool_], cheirality: str
) -> ReprojectionError | None:
    """Return the output of ``reprojection.summarize_errors`` to rank 0.

    Args:
        errors: errors ||r|| of this process in pixels; nan without a projection.
        behind: mask of this process's observations behind their camera.
        cheirality: resolved cheirality option for `behind`.
    """
    own = np.sort(errors[counted_errors(errors, behind, cheirality)])
    with np.errstate(over="ignore"):
        mine = (len(own), behind.sum(), own.sum(), (own**2).sum(), own.max(initial=0.0))
    given = meeting.gather(mine)
    totals = None
    if given is not None:
        count, num_behind, total, squares, _ = (sum(column) for column in zip(*given, strict=True))
        largest = max(row[-1] for row in given)
        totals = (int(count), int(num_behind), float(total), float(squares), float(largest))
    count, num_behind, *sums = meeting.broadcast(totals)
    values: list[float] = []
    if count:
        positions = np.array([0.5, 0.95]) * (count - 1)
        below = positions.astype(np.int64)
        found = order_statistics(meeting, own, np.r_[below, np.minimum(below + 1, count - 1)])
        pairs = zip(found[:2], found[2:], positions - below, strict=True)
        values = [between(float(low), float(high), float(share)) for low, high, share in pairs]
    if meeting.rank > 0:
        return None
    return statistics_of(count, sums, lambda: values, num_behind)


def order_statistics(
    meeting: Meeting, own: NDArray[np.float64], positions: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return, on all ranks, the values at some positions of the sorted values of all processes.

    ``own``: values of this process, at least 0 and ascending. ``positions``: positions from 0, the
    same in all processes.
    """
    bits = own.view(np.int64)
    low = np.zeros(len(positions), np.int64)
    high = np.full(len(positions), np.float64(np.inf).view(np.int64))
    while (low < high).any():
        middle = low + (high - low) // 2
        counts = meeting.gather(np.searchsorted(bits, middle, side="right"))
        reached = meeting.broadcast(None if counts is None else sum(counts) > positions)
        low, high = np.where(reached, low, middle + 1), np.where(reached, middle, high)
    return low.view(np.float64)


_Progress = Callable[[dict[str, Any]], None]
_LAST = "measure"


class Process:
    """Process with its slice. All ranks run each method; rank 0 gets the results.

    Args:
        meeting: communication of all processes.
        path: path of the model.
        found: survey of rank 0; None on the other ranks.
    """

    def __init__(self, meeting: Meeting, path: Path, found: Survey | None) -> None:
        self._meeting: Meeting = meeting
        self.slice = read_slice(meeting, path, found)
        self._part = self.slice.part
        self._errors: dict[str, tuple[Any, Any]] = {}  # key: cheirality

    def serve(self) -> None:
        """Run the methods that rank 0 broadcasts, until `measure`."""
        name = ""
        while name != _LAST:
            name, given = self._meeting.broadcast()
            getattr(self, name)(*given)

    def run_on_all(self, name: str, *given: Any, **own: Any) -> Any:
        """Run a method on all ranks and return rank 0's result.

        ``own``: arguments on rank 0 only.
        """
        self._meeting.broadcast((name, given))
        return getattr(self, name)(*given, **own)

    def digest(self) -> Any:
        """Return the sums of all rows of points and observations as they were read."""
        mine = np.flatnonzero(self.slice.survey.owner == self._meeting.rank)
        sums = self._meeting.gather(sums_of_rows(self.slice.part, mine))
        return None if sums is None else np.sum(sums, axis=0, dtype=np.uint64)

    def restart(self, state: dict[str, Any], points: NDArray[np.float64] | None = None) -> None:
        """Continue from other values.

        ``points``: (num_points, 3) points of the model, on rank 0 only.
        """
        survey, own = self.slice.survey, self._part.points
        for rank in range(self._meeting.num_ranks):  # one part at a time
            mine = None if points is None else points[survey.owner == rank]
            given = self._meeting.broadcast(mine)
            own = given if rank == self._meeting.rank else own
        self._move({**state, "points": freeze(np.array(own))})

    def solve(
        self, options: dict[str, Any], progress: _Progress | None = None
    ) -> tuple[dict[str, Any], list[PartOfOutput] | None, Ranks]:
        """Adjust. Return the output of the core, and to rank 0 also the points of all ranks."""
        part = self._part
        fixed = np.intersect1d(np.asarray(options["fixed_point_ids"], np.int64), part.point_ids)
        ranks = self._meeting.ranks()
        own_options = options | {"fixed_point_ids": fixed.tolist()}
        job = Job(part, own_options, None, None, self.slice.image_is_observed)
        output, given = work_on(job, ranks, progress)
        self._move(output)
        return output, self._meeting.gather(given), ranks

    def point_errors(self, num_threads: int) -> list[NDArray[np.float64]] | None:
        """Return the mean error of each point, as defined in COLMAP's files, by process."""
        errors, behind = self._errors_now(num_threads, "auto")
        part = self._part
        return self._meeting.gather(
            colmap.point_errors(errors, behind, part.observation_point, len(part.points))
        )

    def measure(self, options: dict[str, Any], limit: float | None) -> tuple[Any, Any, Any]:
        """Return the statistics before and after, the sums per image, and the gauge problem.

        The gauge problem is None without rigs, and with gauge "none".

        ``limit``: error of an outlier in pixels, or None.
        """
        own, meeting = self.slice, self._meeting
        threads, cheirality = options["num_threads"], options["cheirality"]
        before = PixelErrors(*_errors_of(own.part, threads, cheirality), cheirality)
        after = PixelErrors(*self._errors_now(threads, cheirality), cheirality)
        image = own.part.observation_image
        sums = meeting.gather(sums_of_images(image, own.cameras.num_images, *after))
        measured = self._measured(before, after, limit)
        asked = own.cameras.num_frames > 0 and options["gauge"] != "none"
        gauge = gauge_problem(meeting, own, options["fixed_point_ids"]) if asked else None
        return measured, sums, gauge

    def _measured(self, before: PixelErrors, after: PixelErrors, limit: float | None) -> Any:
        """Return the statistics of the errors of all processes, which are reordered."""
        return kept_errors.measure(before, after, None, limit, DividedErrors(self._meeting))

    def _move(self, values: Mapping[str, Any]) -> None:
        """Continue from other values, such as those in the output of the core."""
        self._part = with_estimates(self._part, values)
        self._errors = {}

    def _errors_now(self, num_threads: int, cheirality: str) -> tuple[Any, Any]:
        if cheirality not in self._errors:
            self._errors[cheirality] = _errors_of(self._part, num_threads, cheirality)
        return self._errors[cheirality]


def _errors_of(part: ProblemPart, num_threads: int, cheirality: str) -> tuple[Any, Any]:
    return _core.reprojection_errors(part, num_threads, cheirality)


# Gauge problem of a model in slices: a small problem with the same gauge freedom.
#
# Gauge freedom (``bundle.solving.gauge_freedom``) depends on the images that free points connect,
# and on the positions of constant points. For free points, a slice therefore contributes one point
# per observed image, which connects the image with the first image of its component. For constant
# points it contributes all observations. The gauge problem therefore consists of at most one free
# point per image from each process, and of the constant points that the user named.


def gauge_problem(meeting: Meeting, own: Slice, fixed_point_ids: list[int]) -> Problem | None:
    """Return a problem with the same gauge freedom to rank 0, None to the other ranks."""
    given = meeting.gather(_of_slice(own, np.asarray(fixed_point_ids, np.int64)))
    if given is None:
        return None
    links, held_images, held_points, positions, ids = (
        np.concatenate(columns) for columns in zip(*given, strict=True)
    )
    first = np.cumsum([0, *(len(of[-1]) for of in given)])
    held_points = held_points + np.repeat(first[:-1], [len(of[1]) for of in given])
    free_ids = np.arange(len(links)) + 1 + max(fixed_point_ids, default=0)
    image = np.r_[held_images, links.ravel()].astype(np.int32)
    return own.cameras.replace(
        points=np.r_[positions, np.zeros((len(links), 3))],
        point_ids=np.r_[ids, free_ids],
        observation_image=image,
        observation_point=np.r_[held_points, len(ids) + np.repeat(np.arange(len(links)), 2)],
        observation_xy=np.zeros((len(image), 2)),
        observation_keypoint=np.full(len(image), -1, np.int32),
    )


def _of_slice(own: Slice, fixed: NDArray[np.int64]) -> tuple[NDArray[Any], ...]:
    """Return the connected images; and images, rows, positions and ids of the constant points."""
    part = own.part
    is_held = np.isin(part.point_ids, fixed)
    held = np.flatnonzero(is_held[part.observation_point])
    free = np.flatnonzero(~is_held[part.observation_point])
    free = free[np.argsort(part.observation_point[free], kind="stable")]
    images, points = part.observation_image[free], part.observation_point[free]
    starts = np.flatnonzero(np.diff(points, prepend=-1))
    roots = component_roots(images, starts, own.cameras.num_images)
    seen = np.unique(images)
    row = np.cumsum(is_held) - 1
    return (
        np.stack([seen, roots[seen]], axis=1),
        part.observation_image[held],
        row[part.observation_point[held]],
        part.points[is_held],
        part.point_ids[is_held],
    )
