"""From options to a scene: structure, observations, ground truth, start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.display import Display, Displayed
from bundle.errors import InputError
from bundle.problem import Problem
from bundle.rotations import quaternion_from_matrix, rotate
from bundle.synthetic.intrinsics import Intrinsics, draw_intrinsics
from bundle.synthetic.noise import measure, perturb
from bundle.synthetic.orbit import Orbit
from bundle.synthetic.photo_collection import PhotoCollection
from bundle.synthetic.scene import Pairs, Points, Scene
from bundle.synthetic.scene_options import SceneOptions
from bundle.synthetic.street import Street
from bundle.synthetic.tracks import select_observations, wanted_lengths
from bundle.synthetic.visibility import pixels, visible_pairs
from bundle.words import contents, plural

__all__ = ["SyntheticScene", "synthesize"]

Array = NDArray[np.float64]

_SCENES: dict[str, Callable[[np.random.Generator, SceneOptions], Scene]] = {
    "street": Street,
    "orbit": Orbit,
    "photo_collection": PhotoCollection,
}
_MAX_ROUNDS = 12


@dataclass(frozen=True, kw_only=True, repr=False)
class SyntheticScene(Displayed):
    """A problem of which the solution is known.

    Attributes:
        problem: the start: measured observations, perturbed poses, points and cameras.
        ground_truth: the same observations with the true poses, points and cameras. Its residuals
            are the noise, and the outliers.
        is_outlier: (num_observations,) which observations were replaced by random pixels.
        options: what was asked for.
    """

    problem: Problem
    ground_truth: Problem
    is_outlier: NDArray[np.bool_]
    options: SceneOptions

    def _display(self) -> Display:
        facts = (
            ("contents", contents(self.problem)),
            ("outliers", plural(int(self.is_outlier.sum()), "observation")),
        )
        return Display(title=f"SyntheticScene: {self.options!r}", facts=facts)


def synthesize(options: SceneOptions | None = None, **changes: Any) -> SyntheticScene:
    """Make a seeded synthetic scene with ground truth.

    Every point is seen by two images at least, every image sees at least 20 points where the scene
    allows, and all of it is connected. Observations are sorted by point, then image. Ids count from
    1. World frames and length units are those of the kinds of scenes, see :mod:`.street` (metres),
    :mod:`.orbit` (radii of the object) and :mod:`.photo_collection` (metres).

    Args:
        options: what to make; default ``SceneOptions()``.
        **changes: fields of :class:`SceneOptions` that differ from ``options``.

    Raises:
        InputError: an option is unknown or out of its range, or the scene cannot be made: too few
            points to connect its images, or tracks longer than images see a point.

    Example:
        >>> scene = bundle.synthesize(scene="orbit", num_images=12, num_points=500, seed=1)
        >>> scene.ground_truth.num_images
        12
    """
    options = SceneOptions.of(options, changes, "synthesize")
    # One independent stream a purpose: more noise leaves the structure as it is.
    layout, structure, measurement, start = (
        np.random.default_rng(seed) for seed in np.random.SeedSequence(options.seed).spawn(4)
    )
    scene = _SCENES[options.scene](layout, options)
    cameras = draw_intrinsics(
        layout, scene.images, options.camera_model, shared=options.has_shared_camera
    )
    points, observations = _observe(structure, scene, cameras, options)
    exact = pixels(scene, cameras, points.positions, observations.image, observations.point)
    sizes = scene.images.sizes[observations.image]
    xy, is_outlier = measure(measurement, exact, sizes, options)
    truth = _ground_truth(options, scene, cameras, points, observations, xy)
    return SyntheticScene(
        problem=perturb(start, truth, cameras, options),
        ground_truth=truth,
        is_outlier=is_outlier,
        options=options,
    )


def _observe(
    rng: np.random.Generator, scene: Scene, cameras: Intrinsics, options: SceneOptions
) -> tuple[Points, Pairs]:
    """Draw points until enough of them are visible from two images, then choose observations."""
    parts: list[tuple[Points, Array, Pairs]] = []
    found, drawn = 0, 0
    while found < options.num_points:
        if len(parts) == _MAX_ROUNDS:
            raise InputError(
                f"num_points: expected at most {found}, as many are visible from two images, "
                f"found {options.num_points}"
            )
        missing = options.num_points - found
        share = max(found / drawn, 0.02) if drawn else 1.0
        part = _draw_visible(
            rng, scene, cameras, options, missing, int(1.15 * missing / share) + 50
        )
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
    cameras: Intrinsics,
    options: SceneOptions,
    wanted: int,
    count: int,
) -> tuple[Points, Array, Pairs, int]:
    """Draw ``count`` points, of which at most ``wanted`` that two images see are kept.

    Returns:
        The points kept, how long their tracks want to be, who could observe them, and how many
        points had to be drawn for that.
    """
    points = scene.draw_points(rng, count)
    weights = scene.draw_lengths(rng, len(points))
    lengths = wanted_lengths(weights, options.wanted_track_length - 2.0).astype(np.float64)
    pairs = visible_pairs(rng, scene, cameras, points, lengths)
    visible = np.flatnonzero(pairs.counts >= 2)
    kept = np.sort(rng.permutation(visible)[:wanted])
    drawn = round(count * len(kept) / len(visible)) if len(visible) else count
    return points.take(kept), weights[kept], pairs.of_points(kept), drawn


def _ground_truth(
    options: SceneOptions,
    scene: Scene,
    cameras: Intrinsics,
    points: Points,
    observations: Pairs,
    xy: Array,
) -> Problem:
    images = scene.images
    translations = -rotate(images.rotations, images.centers)
    num_images, num_cameras = len(images.centers), len(cameras.params)
    return Problem(
        cam_from_world=np.concatenate(
            [quaternion_from_matrix(images.rotations), translations], axis=1
        ),
        image_ids=np.arange(1, num_images + 1),
        image_names=tuple(f"{options.scene}_{i:04d}.jpg" for i in range(1, num_images + 1)),
        image_camera=cameras.image_camera,
        camera_ids=np.arange(1, num_cameras + 1),
        camera_models=(cameras.model,) * num_cameras,
        camera_params=cameras.params,
        camera_sizes=cameras.sizes,
        points=points.positions,
        point_ids=np.arange(1, len(points) + 1),
        observation_image=observations.image,
        observation_point=observations.point,
        observation_xy=xy,
        observation_keypoint=_keypoints(observations.image, num_images),
    )


def _keypoints(observation_image: NDArray[np.int32], num_images: int) -> NDArray[np.int32]:
    """Return the number of each observation within its image, from 0, in order."""
    by_image = np.argsort(observation_image, kind="stable")
    counts = np.bincount(observation_image, minlength=num_images)
    keypoints = np.empty(len(observation_image), dtype=np.int32)
    first = np.repeat(np.cumsum(counts) - counts, counts)
    keypoints[by_image] = np.arange(len(observation_image)) - first
    return keypoints
