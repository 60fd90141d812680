"""What a scene has, counted block by block."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bundle.model.problem import Problem
from bundle.model.reprojection import ReprojectionError, counted_errors, reprojection_errors

__all__ = ["ErrorTally", "SceneTally"]

# Of a float32 that is not negative: bits 11 and up, which tell numbers apart by 2^-12 of their size
# and are in their order.
_DROPPED_BITS = 11
_NUM_BINS = 1 << (31 - _DROPPED_BITS)


@dataclass
class ErrorTally:
    """Statistics of reprojection errors, none of which is kept.

    They are those of ``bundle.reprojection_error``, but for the quantiles, which are within 1/8000
    of their size.
    """

    _count: int = 0
    _behind: int = 0
    _sum: float = 0.0
    _squares: float = 0.0
    _largest: float = 0.0
    _bins: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_NUM_BINS, np.int64))

    def add(self, part: Problem) -> None:
        """Add the errors of a part of a scene."""
        errors, behind = reprojection_errors(part, cheirality="zero")
        errors = errors[counted_errors(errors, behind, "zero")]
        self._count += len(errors)
        self._behind += int(behind.sum())
        self._sum += float(errors.sum())
        self._squares += float((errors**2).sum())
        self._largest = max(self._largest, float(errors.max(initial=0.0)))
        bits = errors.astype(np.float32).view(np.int32) >> _DROPPED_BITS
        self._bins += np.bincount(bits, minlength=_NUM_BINS)

    def statistics(self) -> ReprojectionError:
        """Return what was added; there has to be an error."""
        return ReprojectionError(
            rmse=float(np.sqrt(self._squares / self._count)),
            mean=self._sum / self._count,
            median=self._quantile(0.5),
            p95=self._quantile(0.95),
            max=self._largest,
            num_observations=self._count,
            num_behind_camera=self._behind,
        )

    def _quantile(self, share: float) -> float:
        at = np.searchsorted(np.cumsum(self._bins), share * (self._count - 1), side="right")
        middle = np.int32((int(at) << _DROPPED_BITS) + (1 << (_DROPPED_BITS - 1)))
        return float(middle.view(np.float32))


class SceneTally:
    """Counts of a scene.

    Attributes:
        num_observations: so far.
        num_outliers: so far.
        observations_per_image: (num_images,) so far.
        errors: of "start" and "ground_truth", once all is there.
    """

    def __init__(self, num_images: int) -> None:
        self.num_observations = self.num_outliers = 0
        self.observations_per_image = np.zeros(num_images, np.int64)
        self.errors: dict[str, ReprojectionError] = {}
        self._lengths = np.zeros(0, np.int64)

    def add(
        self, image: NDArray[np.int32], point: NDArray[np.int32], is_outlier: NDArray[np.bool_]
    ) -> None:
        """Add all observations of some points: (M,) image, point (from 0) and outlier or not."""
        self.num_observations += len(image)
        self.num_outliers += int(is_outlier.sum())
        num_images = len(self.observations_per_image)
        self.observations_per_image += np.bincount(image, minlength=num_images)
        lengths = np.bincount(np.bincount(point))
        size = max(len(lengths), len(self._lengths))
        self._lengths = np.pad(lengths, (0, size - len(lengths))) + np.pad(
            self._lengths, (0, size - len(self._lengths))
        )

    def track_length(self) -> dict[str, float]:
        """Return "min", "mean", "median" and "max" of the observations of a point."""
        return _distribution(self._lengths)

    def image_size(self) -> dict[str, float]:
        """Return the same of the observations of an image."""
        return _distribution(np.bincount(self.observations_per_image))


def _distribution(histogram: NDArray[np.int64]) -> dict[str, float]:
    """Return statistics of values of which number k occurs histogram[k] times."""
    values = np.flatnonzero(histogram)
    ends = np.cumsum(histogram)
    count = int(ends[-1])
    middle = np.searchsorted(ends, [(count - 1) // 2, count // 2], side="right")
    return {
        "min": int(values[0]),
        "mean": float(values @ histogram[values] / count),
        "median": float(middle.mean()),
        "max": int(values[-1]),
    }
