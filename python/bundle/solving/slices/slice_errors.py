"""Statistics of reprojection errors of observations on disk or in several processes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.model.reprojection import (
    ReprojectionError,
    between,
    counted_errors,
    quantiles,
    statistics_of,
)
from bundle.solving.kept_errors import (
    Inliers,
    KeptErrors,
    Measured,
    PixelErrors,
    Totals,
    inlier_sums,
)
from bundle.solving.slices.slice_reading import Meeting, blocks

# Statistics of reprojection errors on disk, with temporaries of one block.
#
# The results are those of ``kept_errors.measure`` for a solve that keeps all observations. Errors
# are compressed in place to those that count, block by block; order statistics partition them in
# place.


def measure_on_disk(before: PixelErrors, after: PixelErrors, limit: float | None) -> Measured:
    """Return all statistics; the errors are overwritten.

    Args:
        limit: error of an outlier in pixels; None: do not separate outliers.
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
    """Return the errors that count in both, of ``which`` (0 or 1); None: of ``one``, in place."""
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

    Args:
        own: values of this process, at least 0 and ascending.
        positions: positions from 0, the same in all processes.
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
