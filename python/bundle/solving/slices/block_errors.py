"""Statistics of reprojection errors on disk, with temporaries of one block.

The results are those of ``kept_errors.measure`` for a solve that keeps all observations. Errors are
compressed in place to those that count, block by block; order statistics partition them in place.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.model.reprojection import (
    ReprojectionError,
    counted_errors,
    quantiles,
    summarize_errors,
)
from bundle.solving.kept_errors import Inliers, KeptErrors, Measured, PixelErrors, inlier_sums
from bundle.solving.slices.slice_reading import blocks


def measure_on_disk(before: PixelErrors, after: PixelErrors, limit: float | None) -> Measured:
    """Return all statistics; the errors are overwritten.

    Args:
        before: errors of all observations at the input.
        after: errors of the same observations at the output.
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
    """Return the errors that count in both, of one of both; in place if they are one."""
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
    count = len(errors)
    if count == 0:
        nothing = summarize_errors(errors, np.zeros(0, np.bool_), "algebraic")
        median = p95 = rmse = mean = largest = nothing.rmse
    else:
        total = squares = largest = 0.0
        with np.errstate(over="ignore"):
            for block in blocks(count):
                total += float(errors[block].sum())
                squares += float((errors[block] ** 2).sum())
                largest = max(largest, float(errors[block].max()))
        rmse, mean = float(np.sqrt(squares / count)), total / count
        median, p95 = quantiles(errors, [0.5, 0.95])
    return ReprojectionError(
        rmse=rmse,
        mean=mean,
        median=median,
        p95=p95,
        max=largest,
        num_observations=count,
        num_behind_camera=num_behind,
    )
