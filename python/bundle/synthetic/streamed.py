"""Writing of a scene to BAL files block by block, so that it never needs memory for all of it.

Both files, start and ground truth, have the same observations, which are formatted once. In a BAL
file, points follow all observations. Until then, points are stored in unnamed files in the folders
of the output. Memory contains the images, the blocks in progress and their statistics.

Counts and errors of a scene are accumulated block by block.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import field
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.io import bal
from bundle.io.atomic import atomic_write as atomic
from bundle.model.problem import Problem
from bundle.model.reprojection import ReprojectionError, counted_errors, reprojection_errors
from bundle.synthetic.blocks import SceneInBlocks
from bundle.synthetic.scene import Start, median_distance

# Number of low bits of a nonnegative float32 that are dropped. The other bits preserve the order of
# numbers and resolve 2^-12 of their size.
_DROPPED_BITS = 11
_NUM_BINS = 1 << (31 - _DROPPED_BITS)


@dataclass
class ErrorTally:
    """Statistics of reprojection errors, without storing the errors.

    They equal the statistics of ``bundle.reprojection_error``. Only quantiles differ, by up to
    1/8000 of their size.
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
        """Return the statistics; at least one error must have been added."""
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
        num_observations: number of observations so far.
        num_outliers: number of outliers so far.
        observations_per_image: (num_images,) counts so far.
        errors: errors of "start" and "ground_truth", set when the scene is complete.
    """

    def __init__(self, num_images: int) -> None:
        self.num_observations = self.num_outliers = 0
        self.observations_per_image = np.zeros(num_images, np.int64)
        self.errors: dict[str, ReprojectionError] = {}
        self._lengths = np.zeros(0, np.int64)

    def add(
        self, image: NDArray[np.int32], point: NDArray[np.int32], is_outlier: NDArray[np.bool_]
    ) -> None:
        """Add all observations of some points: (M,) image, point (from 0) and outlier flag."""
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
        """Return "min", "mean", "median" and "max" of the observations per point."""
        return _distribution(self._lengths)

    def image_size(self) -> dict[str, float]:
        """Return "min", "mean", "median" and "max" of the observations per image."""
        return _distribution(np.bincount(self.observations_per_image))


def _distribution(histogram: NDArray[np.int64]) -> dict[str, float]:
    """Return statistics of whole numbers in which k occurs histogram[k] times."""
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


# Number of stored points to read at a time.
_POINTS_AT_A_TIME = 1 << 20


def write_bal_scene(
    scene: SceneInBlocks,
    path: Path,
    truth_path: Path,
    progress: Callable[[float], None] | None = None,
) -> SceneTally:
    """Write the start of a scene and its ground truth, as made by ``synthesize``.

    Args:
        progress: called after each block with the fraction of finished points.

    Returns:
        Counts of the written scene.
    """
    options, truth = scene.options, scene.images()
    bal.radial_params(truth)
    tally = SceneTally(truth.num_images)
    errors = {"start": ErrorTally(), "ground_truth": ErrorTally()}
    with ExitStack() as stack:
        # The file that is entered last is moved into place first.
        paths = [stack.enter_context(atomic.replace_file(name)) for name in (path, truth_path)]
        waiting = [stack.enter_context(tempfile.TemporaryFile(dir=name.parent)) for name in paths]
        stream = _core.BalStream(list(paths), truth.num_images, options.num_points)
        start: Start | None = None
        moved = truth
        for block in scene.blocks():
            part = scene.part(truth, block)
            if start is None:
                start = Start(
                    scene.start_seed, truth, scene.cameras, median_distance(part), options
                )
                state = {"cam_from_world": start.cam_from_world}
                moved = truth.replace(**state, camera_params=start.camera_params)
            started = start.points(block.points)
            started.tofile(waiting[0])
            block.points.tofile(waiting[1])
            stream.add_observations(bal.radial_params(truth), block.image, block.point, block.xy)
            tally.add(block.image, part.observation_point, block.is_outlier)
            errors["start"].add(scene.part(moved, block).replace(points=started))
            errors["ground_truth"].add(part)
            if progress is not None:
                progress((block.first_point + len(block.points)) / options.num_points)
        for file, (problem, points) in enumerate(zip((moved, truth), waiting, strict=True)):
            stream.add_cameras(file, problem.cam_from_world, bal.radial_params(problem))
            for some in _read_points(points):
                stream.add_points(file, some)
        stream.close()
    tally.errors = {name: found.statistics() for name, found in errors.items()}
    return tally


def _read_points(file: IO[bytes]) -> Iterator[NDArray[np.float64]]:
    """Yield all points (n, 3) of a file in chunks."""
    file.seek(0)
    while len(some := np.fromfile(file, np.float64, 3 * _POINTS_AT_A_TIME)):
        yield some.reshape(-1, 3)
