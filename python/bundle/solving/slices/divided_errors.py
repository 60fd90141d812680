"""Statistics of reprojection errors whose observations are in several processes.

Sums and maxima are combined from those of the processes. An order statistic, such as the median, is
found by bisection. Non-negative doubles have the same order as the integers of their bits, so that
63 bisection steps find the k-th smallest error. In each step, every process counts its errors up to
the middle. The result is exact, and no process needs the errors of another one.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.model.reprojection import ReprojectionError, between, counted_errors, summarize_errors
from bundle.solving.kept_errors import PixelErrors, Totals
from bundle.solving.slices.slice_reading import Meeting


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
        meeting: communication of all processes.
        errors: errors ||r|| of this process in pixels; nan without a projection.
        behind: mask of this process's observations behind their camera.
        cheirality: resolved cheirality option for `behind`.
    """
    own = np.sort(errors[counted_errors(errors, behind, cheirality)])
    with np.errstate(over="ignore"):
        sums = (len(own), behind.sum(), own.sum(), (own**2).sum(), own.max(initial=0.0))
    given = meeting.gather(sums)
    totals = None
    if given is not None:
        count, num_behind, total, squares, _ = (sum(column) for column in zip(*given, strict=True))
        largest = max(row[-1] for row in given)
        totals = (int(count), int(num_behind), float(total), float(squares), float(largest))
    count, num_behind, total, squares, largest = meeting.broadcast(totals)
    if count == 0:
        none = summarize_errors(own, np.zeros(0, bool), cheirality)
        return dataclasses.replace(none, num_behind_camera=num_behind)
    positions = np.array([0.5, 0.95]) * (count - 1)
    below = positions.astype(np.int64)
    values = order_statistics(meeting, own, np.r_[below, np.minimum(below + 1, count - 1)])
    if meeting.rank > 0:
        return None
    median, p95 = (
        between(float(low), float(high), float(share))
        for low, high, share in zip(values[:2], values[2:], positions - below, strict=True)
    )
    return ReprojectionError(
        rmse=float(np.sqrt(squares / count)),
        mean=total / count,
        median=median,
        p95=p95,
        max=largest,
        num_observations=count,
        num_behind_camera=num_behind,
    )


def order_statistics(
    meeting: Meeting, own: NDArray[np.float64], positions: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return, on all ranks, the values at some positions of the sorted values of all processes.

    Args:
        meeting: communication of all processes.
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
