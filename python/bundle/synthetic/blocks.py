"""Generation and writing of a scene in blocks: images and cameras, then blocks of points.

Each block also has the observations of its points. A scene of at most a million points is one
block. A larger scene has blocks of about equal size, each with its own random numbers. All images
share points within each block. Blocks are generated in parallel, and only the blocks in progress
are in memory. The scene does not depend on the number of threads.
"""

from __future__ import annotations

import tempfile
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import field
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.interface.scene_options import SceneOptions
from bundle.io import bal
from bundle.io.atomic import atomic_write as atomic
from bundle.model.problem import Problem
from bundle.model.residuals import ReprojectionError, counted_errors, reprojection_errors
from bundle.model.rigid_motions import quaternion_from_matrix, rotate
from bundle.synthetic.observations import Visibility, measure, select_observations, wanted_lengths
from bundle.synthetic.orbit import Orbit
from bundle.synthetic.photo_collection import PhotoCollection
from bundle.synthetic.scene import Pairs, Points, Scene, Start, draw_intrinsics, median_distance
from bundle.synthetic.street import Street

Array = NDArray[np.float64]


LARGEST_SINGLE = 1 << 20  # points of the largest scene that is a single block
POINTS_PER_BLOCK = 1 << 18
"""Points per block of larger scenes; more if many images need their own points in each block."""
_POINTS_PER_IMAGE = 40
# Largest number of blocks in progress. Each takes some hundred megabytes.
_MOST_AT_A_TIME = 8
_MAX_ROUNDS = 12

_SCENES: dict[str, Callable[[np.random.Generator, SceneOptions], Scene]] = {
    "street": Street,
    "orbit": Orbit,
    "photo_collection": PhotoCollection,
}


@dataclass(frozen=True)
class Block:
    """Points and their observations."""

    first_point: int  # index of the first point in the scene
    points: Array  # (n, 3) true positions
    image: NDArray[np.int32]  # (M,) image index of each observation; sorted by point, then image
    point: NDArray[np.int32]  # (M,) index of each observation's point in the scene
    xy: Array  # (M, 2) measured positions in pixels
    is_outlier: NDArray[np.bool_]  # (M,) True for outliers


class SceneInBlocks:
    """True images and cameras of a scene, and the generator of its blocks.

    Attributes:
        options: options of the scene.
        cameras: the true cameras.
        start_seed: seed of the perturbed start values.
        num_blocks: number of blocks.
    """

    def __init__(self, options: SceneOptions) -> None:
        # One independent random stream per purpose, so that noise does not change the structure.
        layout, structure, measurement, self.start_seed = np.random.SeedSequence(
            options.seed
        ).spawn(4)
        rng = np.random.default_rng(layout)
        self.options = options
        self._scene = _SCENES[options.scene](rng, options)
        self.cameras = draw_intrinsics(
            rng, self._scene.images, options.camera_model, shared=options.has_shared_camera
        )
        self._visibility = Visibility(self._scene, self.cameras)
        size = max(POINTS_PER_BLOCK, _POINTS_PER_IMAGE * options.num_images)
        is_single = options.num_points <= LARGEST_SINGLE
        self.num_blocks = 1 if is_single else -(-options.num_points // size)
        self._seeds = [(structure, measurement)]
        if self.num_blocks > 1:
            children = (seed.spawn(self.num_blocks) for seed in (structure, measurement))
            self._seeds = list(zip(*children, strict=True))

    def images(self) -> Problem:
        """Return the true images and cameras, without points."""
        images, cameras, kind = self._scene.images, self.cameras, self.options.scene
        translations = -rotate(images.rotations, images.centers)
        return cameras.problem_of(
            np.concatenate([quaternion_from_matrix(images.rotations), translations], axis=1),
            tuple(f"{kind}_{i:04d}.jpg" for i in range(1, len(images.centers) + 1)),
        )

    def blocks(self) -> Iterator[Block]:
        """Yield the blocks in order; other threads generate the next blocks in advance."""
        count = self.num_blocks
        if count == 1:
            yield self._make(0, self.options.num_points, *self._seeds[0], 0)
            return
        ends = [self.options.num_points * (k + 1) // count for k in range(count)]
        begins = [0, *ends[:-1]]
        tasks = zip(begins, ends, self._seeds, strict=True)
        at_a_time = min(_core.hardware_threads(), _MOST_AT_A_TIME)
        ahead: deque[Future[Block]] = deque()
        pool = ThreadPoolExecutor(at_a_time)
        try:
            for begin, end, (structure, measurement) in tasks:
                if len(ahead) == at_a_time:
                    yield ahead.popleft().result()
                ahead.append(pool.submit(self._make, begin, end - begin, structure, measurement, 1))
            while ahead:
                yield ahead.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)

    @staticmethod
    def part(images: Problem, block: Block) -> Problem:
        """Return a problem with all images, but only a block's points and observations."""
        return images.replace(
            points=block.points,
            point_ids=None,
            observation_image=block.image,
            observation_point=block.point - np.int32(block.first_point),
            observation_xy=block.xy,
            observation_keypoint=None,
        )

    def _make(
        self,
        first_point: int,
        num_points: int,
        structure: np.random.SeedSequence,
        measurement: np.random.SeedSequence,
        num_threads: int,
    ) -> Block:
        scene, options = self._scene, self.options
        points, pairs = _observe(
            np.random.default_rng(structure),
            scene,
            self._visibility,
            options,
            num_points,
            num_threads,
        )
        exact = self._visibility.pixels(points.positions, pairs.image, pairs.point, num_threads)
        sizes = scene.images.sizes[pairs.image]
        xy, is_outlier = measure(np.random.default_rng(measurement), exact, sizes, options)
        numbered = pairs.point + np.int32(first_point)
        return Block(first_point, points.positions, pairs.image, numbered, xy, is_outlier)


def _observe(
    rng: np.random.Generator,
    scene: Scene,
    visibility: Visibility,
    options: SceneOptions,
    num_points: int,
    num_threads: int,
) -> tuple[Points, Pairs]:
    """Draw points until enough of them are visible in two images, then choose observations."""
    parts: list[tuple[Points, Array, Pairs]] = []
    found, drawn = 0, 0
    while found < num_points:
        if len(parts) == _MAX_ROUNDS:
            raise InputError(
                f"num_points: expected at most {found}, the number that is visible in two "
                f"images, found {num_points}"
            )
        missing = num_points - found
        share = max(found / drawn, 0.02) if drawn else 1.0
        count = int(1.15 * missing / share) + 50
        part = _draw_visible(rng, scene, visibility, options, missing, count, num_threads)
        parts.append(part[:3])
        found += len(part[0])
        drawn += part[3]
    points = Points.concatenate([part[0] for part in parts])
    weights = np.concatenate([part[1] for part in parts])
    pairs = Pairs.concatenate([part[2] for part in parts])
    preference = scene.preference(rng, points, pairs)
    return points, select_observations(
        pairs,
        preference,
        weights,
        options.wanted_track_length,
        options.num_images,
        may_be_shorter=options.mean_track_length == 0,
    )


def _draw_visible(
    rng: np.random.Generator,
    scene: Scene,
    visibility: Visibility,
    options: SceneOptions,
    wanted: int,
    count: int,
    num_threads: int,
) -> tuple[Points, Array, Pairs, int]:
    """Draw ``count`` points; keep at most ``wanted`` points that two images observe.

    Returns:
        Kept points, their wanted track lengths, their possible observations, and the number of
        points drawn to get them.
    """
    points = scene.draw_points(rng, count)
    weights = scene.draw_lengths(rng, len(points))
    lengths = wanted_lengths(weights, options.wanted_track_length - 2.0).astype(np.float64)
    pairs = visibility.pairs(rng, points, lengths, num_threads)
    visible = np.flatnonzero(pairs.counts >= 2)
    kept = np.sort(rng.permutation(visible)[:wanted])
    drawn = round(count * len(kept) / len(visible)) if len(visible) else count
    return points.take(kept), weights[kept], pairs.of_points(kept), drawn


# Writing of a scene to BAL files block by block, so that it never needs memory for all of it.
#
# Both files, start and ground truth, have the same observations, which are formatted once. In a BAL
# file, points follow all observations. Until then, points are stored in unnamed files in the
# folders of the output. Memory contains the images, the blocks in progress and their statistics.
#
# Counts and errors of a scene are accumulated block by block.


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
    """Write the start of a scene and its ground truth, as of ``synthesize``; return their counts.

    ``progress``: called after each block with the fraction of finished points.
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
