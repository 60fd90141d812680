"""Synthesis of a scene from options: structure, observations, ground truth, start values."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Unpack

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import contents, plural
from bundle.georeference.attitude_priors import AttitudePrior, GravityPrior, OrientationPrior
from bundle.interface.option_class import takes_options
from bundle.interface.scene_options import SceneOptions
from bundle.model.problem import Problem
from bundle.model.rigid_motions import (
    quaternion_from_vector,
    quaternion_multiply,
    rotation_matrices,
)
from bundle.synthetic.blocks import SceneInBlocks
from bundle.synthetic.scene import Start, median_distance
from bundle.synthetic.video_scene import film

if TYPE_CHECKING:
    from bundle.interface.option_keywords import SceneKeywords


@dataclass(frozen=True, kw_only=True, repr=False)
class SyntheticScene(Displayed):
    """Problem with a known solution.

    Attributes:
        problem: start of a solve: measured observations, perturbed poses, points and cameras.
        ground_truth: the same observations with the true poses, points and cameras. Its residuals
            are the noise and the outliers.
        is_outlier: (num_observations,) True for observations replaced by random pixels.
        options: options of the scene.
    """

    problem: Problem
    ground_truth: Problem
    is_outlier: NDArray[np.bool_]
    options: SceneOptions

    @property
    def priors(self) -> tuple[AttitudePrior, ...]:
        """Measured gravity and orientations, as ``priors`` of :func:`bundle.solve`."""
        return measured_attitudes(self.ground_truth, self.options)

    def _display(self) -> Display:
        facts = (
            ("contents", contents(self.problem)),
            ("outliers", plural(int(self.is_outlier.sum()), "observation")),
        )
        return Display(title=f"SyntheticScene: {self.options.short()}", facts=facts)


@takes_options(SceneOptions)
def synthesize(
    options: SceneOptions | None = None, **changes: Unpack[SceneKeywords]
) -> SyntheticScene:
    """Make a seeded synthetic scene with ground truth.

    Every point is observed in at least two images. Every image observes at least 20 points if the
    scene permits. All images are connected by common points. Observations are sorted by point, then
    image. Ids start at 1. World frame and length unit depend on the kind of scene, see
    :mod:`.street` (metres), :mod:`.orbit` (radii of the object), :mod:`.photo_collection`
    (metres) and, with a rolling shutter, :mod:`.video.film_motions` (metres).

    Scenes of more than a million points are generated in blocks (:mod:`.blocks`). ``bundle synth``
    writes the same scene to a BAL file without storing all of it in memory.

    Args:
        options: options of the scene; default ``SceneOptions()``.
        **changes: fields of :class:`SceneOptions` that replace those in ``options``.

    Raises:
        InputError: an option is unknown or out of range, or the scene is impossible: too few points
            to connect its images, or tracks longer than the number of images that can observe a
            point.

    Example:
        >>> scene = bundle.synthesize(scene="orbit", num_images=12, num_points=500, seed=1)
        >>> scene.ground_truth.num_images
        12
    """
    chosen = SceneOptions.of(options, changes, "synthesize")
    return filmed(chosen) if chosen.is_filmed else assemble(SceneInBlocks(chosen))


def filmed(options: SceneOptions) -> SyntheticScene:
    """Generate a scene of a moving camera; see :mod:`.video.video_scene`."""
    scene = film(options)
    return SyntheticScene(
        problem=scene.problem,
        ground_truth=scene.ground_truth,
        is_outlier=scene.is_outlier,
        options=options,
    )


def assemble(scene: SceneInBlocks) -> SyntheticScene:
    """Generate all blocks of a scene and return the complete scene."""
    options, images = scene.options, scene.images()
    blocks = list(scene.blocks())
    image = np.concatenate([block.image for block in blocks])
    truth = images.replace(
        points=np.concatenate([block.points for block in blocks]),
        point_ids=np.arange(1, options.num_points + 1),
        observation_image=image,
        observation_point=np.concatenate([block.point for block in blocks]),
        observation_xy=np.concatenate([block.xy for block in blocks]),
        observation_keypoint=_keypoints(image, images.num_images),
    )
    is_outlier = np.concatenate([block.is_outlier for block in blocks])
    scale = median_distance(scene.part(images, blocks[0]))
    del blocks
    start = Start(scene.start_seed, truth, scene.cameras, scale, options)
    return SyntheticScene(
        problem=truth.replace(
            cam_from_world=start.cam_from_world,
            points=start.points(truth.points),
            camera_params=start.camera_params,
        ),
        ground_truth=truth,
        is_outlier=is_outlier,
        options=options,
    )


def _keypoints(observation_image: NDArray[np.int32], num_images: int) -> NDArray[np.int32]:
    """Return the index of each observation within its image, from 0, in order."""
    by_image = np.argsort(observation_image, kind="stable")
    counts = np.bincount(observation_image, minlength=num_images)
    keypoints = np.empty(len(observation_image), dtype=np.int32)
    first = np.repeat(np.cumsum(counts) - counts, counts)
    keypoints[by_image] = np.arange(len(observation_image)) - first
    return keypoints


# Measured attitudes of synthetic images: directions of gravity and orientations, with noise.
#
# The noise follows the models of the factors (``cpp/core/factors/attitude_factors.h``). A direction
# of gravity m = Exp(n) R (0, 0, -1) is turned by n ~ N(0, sigma^2 I) in the camera's frame, of
# which the two components perpendicular to m have an effect. An orientation Z = R Exp(-e) has e =
# Log(Z^T R) ~ N(0, sigma^2 I) along the axes of the world.

Array = NDArray[np.float64]

STREAM = 0x617474
"""Second word of the seed, which keeps these numbers apart from those of the scene."""


def measured_attitudes(truth: Problem, options: SceneOptions) -> tuple[AttitudePrior, ...]:
    """Return the priors of gravity, then of orientations, that the options request.

    ``truth``: images at their true poses, in a world with z up.
    """
    gravity, orientation = np.random.SeedSequence([options.seed, STREAM]).spawn(2)
    found: list[AttitudePrior] = []
    if options.gravity_sigma:
        noise = _noise(gravity, truth, options.gravity_sigma)
        down = rotation_matrices(truth.cam_from_world[:, :4])[:, :, 2]
        turned = -np.einsum("nij,nj->ni", rotation_matrices(noise), down)
        found += [
            GravityPrior(image, direction, options.gravity_sigma)
            for image, direction in zip(truth.image_ids.tolist(), turned, strict=True)
        ]
    if options.orientation_sigma:
        noise = _noise(orientation, truth, options.orientation_sigma)
        rotations = quaternion_multiply(truth.cam_from_world[:, :4], noise)
        found += [
            OrientationPrior(image, rotation, options.orientation_sigma)
            for image, rotation in zip(truth.image_ids.tolist(), rotations, strict=True)
        ]
    return tuple(found)


def _noise(seed: np.random.SeedSequence, truth: Problem, degrees: float) -> Array:
    vectors = np.random.default_rng(seed).normal(size=(truth.num_images, 3))
    return quaternion_from_vector(math.radians(degrees) * vectors)
