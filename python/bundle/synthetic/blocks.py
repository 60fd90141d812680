"""Generation of a scene in blocks: first images and cameras, then blocks of points.

Each block also has the observations of its points. A scene of at most a million points is one
block. A larger scene has blocks of about equal size, each with its own random numbers. All images
share points within each block. Blocks are generated in parallel, and only the blocks in progress
are in memory. The scene does not depend on the number of threads.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.interface.scene_options import SceneOptions
from bundle.model.problem import Problem
from bundle.model.rigid_motions import quaternion_from_matrix, rotate
from bundle.synthetic.observations import Visibility, measure, select_observations, wanted_lengths
from bundle.synthetic.orbit import Orbit
from bundle.synthetic.photo_collection import PhotoCollection
from bundle.synthetic.scene import Pairs, Points, Scene, draw_intrinsics
from bundle.synthetic.street import Street

Array = NDArray[np.float64]


LARGEST_SINGLE = 1 << 20
"""Points of the largest scene that is a single block."""
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
