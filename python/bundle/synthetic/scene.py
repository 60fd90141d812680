"""Base of all kinds of scenes: images, points, their possible observations, true intrinsics.

Visibility is first tested approximately. Every point has a *key* and every image a *ball*. An image
can only observe points whose key is in its ball. A grid over the keys avoids testing every image
with every point. Keys are chosen so that the balls are small: positions in a street, surface
normals around an object. Then visibility is tested exactly, see :mod:`.visibility`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.interface.scene_options import SceneOptions
from bundle.model.cameras import camera_models
from bundle.model.problem import Problem
from bundle.model.rigid_motions import (
    dot,
    quaternion_from_vector,
    quaternion_inverse,
    quaternion_multiply,
    quaternion_rotate,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Images:
    """True images."""

    centers: Array  # (N, 3) projection centres in the world, length units
    rotations: Array  # (N, 3, 3) camera-from-world
    focal: Array  # (N,) focal length relative to the longer side of the image
    sizes: NDArray[np.int64]  # (N, 2) width and height in pixels
    richness: Array  # (N,) relative number of observations that an image tends to have
    ball_centers: Array  # (N, 3) centres of the balls in the space of the points' keys
    ball_radii: Array  # (N,) radii of the balls


@dataclass(frozen=True)
class Points:
    """Points on surfaces."""

    positions: Array  # (n, 3) world coordinates, length units
    normals: Array  # (n, 3) unit outward normals; zero for points visible from all sides
    reach: Array  # (n,) distance beyond which a point is not recognised, length units
    keys: Array  # (n, 3) keys for the approximate test of visibility

    def __len__(self) -> int:
        return len(self.positions)

    def take(self, index: NDArray[np.generic]) -> Points:
        """Return some of the points, by index or by mask."""
        return Points(
            self.positions[index], self.normals[index], self.reach[index], self.keys[index]
        )

    @staticmethod
    def concatenate(parts: list[Points]) -> Points:
        """Return all points of the parts, in order."""
        return Points(
            np.concatenate([part.positions for part in parts]),
            np.concatenate([part.normals for part in parts]),
            np.concatenate([part.reach for part in parts]),
            np.concatenate([part.keys for part in parts]),
        )


@dataclass(frozen=True)
class Pairs:
    """Point-image pairs, sorted by point, then image."""

    point: NDArray[np.int32]  # (M,) point indices
    image: NDArray[np.int32]  # (M,) image indices
    starts: NDArray[np.int64]  # (num_points + 1,) begin of the pairs of each point

    @staticmethod
    def from_sorted(point: NDArray[np.int32], image: NDArray[np.int32], num_points: int) -> Pairs:
        """Return pairs from arrays that are sorted by point, then image."""
        starts = np.zeros(num_points + 1, dtype=np.int64)
        np.cumsum(np.bincount(point, minlength=num_points), out=starts[1:])
        return Pairs(point, image, starts)

    @staticmethod
    def concatenate(parts: list[Pairs]) -> Pairs:
        """Return the pairs of all parts, with consecutive point numbers."""
        num_points = np.cumsum([0] + [len(part.counts) for part in parts])
        return Pairs.from_sorted(
            np.concatenate(
                [
                    part.point + np.int32(first)
                    for part, first in zip(parts, num_points, strict=False)
                ]
            ),
            np.concatenate([part.image for part in parts]),
            int(num_points[-1]),
        )

    def of_points(self, points: NDArray[np.int64]) -> Pairs:
        """Return the pairs of some points in ascending order, with new point numbers."""
        number = np.full(len(self.counts), -1, dtype=np.int32)
        number[points] = np.arange(len(points))
        kept = number[self.point] >= 0
        return Pairs.from_sorted(number[self.point[kept]], self.image[kept], len(points))

    def __len__(self) -> int:
        return len(self.point)

    @property
    def counts(self) -> NDArray[np.int64]:
        """Number of pairs of each point."""
        return np.diff(self.starts)

    @property
    def ranks(self) -> NDArray[np.int32]:
        """Position of each pair among the pairs of its point."""
        ranks = np.arange(len(self), dtype=np.int64) - np.repeat(self.starts[:-1], self.counts)
        return ranks.astype(np.int32)


class Scene(ABC):
    """Kind of scene, built for given options."""

    images: Images  # the true images
    min_cosine: float  # smallest cosine between a surface normal and the direction to the camera
    # occluding blocks of a town, as two numbers. Roads run along every multiple of the first number
    # in x and in y. The second number is the distance of the blocks from the middle of the roads.
    # 0: no blocks
    blocks: tuple[float, float] = (0.0, 0.0)

    @abstractmethod
    def draw_points(self, rng: np.random.Generator, count: int) -> Points:
        """Draw about ``count`` points in the view of images; some may be occluded."""

    @abstractmethod
    def draw_lengths(self, rng: np.random.Generator, count: int) -> Array:
        """Draw relative track lengths beyond 2 observations: (count,) with mean 1."""

    @abstractmethod
    def preference(self, rng: np.random.Generator, points: Points, pairs: Pairs) -> Array:
        """Return a value for each pair (M,); images with the smallest values observe a point."""


FOCAL_PARAMS = ("f", "fx", "fy")
RADIAL_PARAMS = ("k", "k1", "k2")
TANGENTIAL_PARAMS = ("p1", "p2")


@dataclass(frozen=True)
class Intrinsics:
    """Cameras of a scene, which all have the same model."""

    model: str  # COLMAP's name of the model
    names: tuple[str, ...]  # parameter names, in COLMAP's order
    params: NDArray[np.float64]  # (num_cameras, num_params) parameters
    sizes: NDArray[np.int64]  # (num_cameras, 2) width and height in pixels
    image_camera: NDArray[np.int32]  # (num_images,) camera index of each image

    def of_image(self, image: int) -> NDArray[np.float64]:
        """Return the parameters (num_params,) of the camera of an image."""
        row: NDArray[np.float64] = self.params[self.image_camera[image]]
        return row

    def problem_of(self, cam_from_world: NDArray[np.float64], names: tuple[str, ...]) -> Problem:
        """Return a problem of the images with these poses (n, 7) and names, without points."""
        num_cameras = len(self.params)
        return Problem(
            cam_from_world=cam_from_world,
            image_ids=np.arange(1, len(names) + 1),
            image_names=names,
            image_camera=self.image_camera,
            camera_ids=np.arange(1, num_cameras + 1),
            camera_models=(self.model,) * num_cameras,
            camera_params=self.params,
            camera_sizes=self.sizes,
            points=np.zeros((0, 3)),
            observation_image=np.zeros(0, np.int32),
            observation_point=np.zeros(0, np.int32),
            observation_xy=np.zeros((0, 2)),
        )

    def columns(self, names: tuple[str, ...]) -> list[int]:
        """Return the columns of ``params`` that contain any of the named parameters."""
        return [column for column, name in enumerate(self.names) if name in names]


def draw_intrinsics(
    rng: np.random.Generator, images: Images, model: str, *, shared: bool
) -> Intrinsics:
    """Draw one camera for all images (of equal size and focal length), or one for each image.

    The principal point is the centre of the image. Distortion is as in ordinary lenses: mild barrel
    distortion, smaller for longer focal lengths, and monotonic well beyond the corners of the
    image.
    """
    count = 1 if shared else len(images.focal)
    sizes, focal = images.sizes[:count], images.focal[:count]
    pixels = focal * sizes.max(axis=1)
    # A coefficient multiplies the squared field angle, so it is scaled by the corner's.
    corner = 0.25 * (sizes**2).sum(axis=1) / pixels**2
    k1 = rng.uniform(-0.05, -0.01, count) / np.maximum(corner, 0.3)
    k2 = rng.uniform(0.0, 0.01, count) / np.maximum(corner, 0.3) ** 2
    values = {
        "f": pixels,
        "fx": pixels,
        "fy": pixels * rng.uniform(0.995, 1.005, count),
        "cx": 0.5 * sizes[:, 0],
        "cy": 0.5 * sizes[:, 1],
        "k": k1,
        "k1": k1,
        "k2": k2,
        "p1": rng.uniform(-1e-3, 1e-3, count),
        "p2": rng.uniform(-1e-3, 1e-3, count),
    }
    names = camera_models()[model]
    image_camera = np.zeros(len(images.focal)) if shared else np.arange(count)
    return Intrinsics(
        model=model,
        names=names,
        params=np.stack([values[name] for name in names], axis=1),
        sizes=sizes,
        image_camera=image_camera.astype(np.int32),
    )


# Start values of a scene: the true problem with perturbed poses, points and cameras.
#
# All random numbers come from one stream: first for images, then for points, then for cameras. If
# points come in blocks, cameras are needed before the last point. Therefore two generators read the
# stream, and the generator for the cameras skips the numbers of the points.


# Number of random numbers to draw and discard at a time.
_SKIPPED = 1 << 20


class Start:
    """Perturbed images and cameras, and perturbation of points block by block.

    Rotation noise rotates about the projection centre, so that rotation and translation noise are
    independent.

    Args:
        seed: seed of the stream.
        truth: true images and cameras; its points are not used.
        cameras: true cameras.
        scale: scale of the scene, see ``median_distance``.
        options: amount of noise.

    Attributes:
        cam_from_world: (num_images, 7) perturbed poses.
        camera_params: (num_cameras, num_params) perturbed parameters.
    """

    def __init__(
        self,
        seed: np.random.SeedSequence,
        truth: Problem,
        cameras: Intrinsics,
        scale: float,
        options: SceneOptions,
    ) -> None:
        rng = np.random.default_rng(seed)
        rotations, translations = truth.cam_from_world[:, :4], truth.cam_from_world[:, 4:]
        centers = -quaternion_rotate(quaternion_inverse(rotations), translations)
        turn = np.radians(options.rotation_noise) * rng.standard_normal(centers.shape)
        turned = quaternion_multiply(quaternion_from_vector(turn), rotations)
        moved = centers + options.translation_noise * scale * rng.standard_normal(centers.shape)
        self.cam_from_world = np.concatenate([turned, -quaternion_rotate(turned, moved)], axis=1)
        self._point_sigma = options.point_noise * scale
        self._of_points = np.random.default_rng(seed)
        _skip(self._of_points, 2 * centers.size)
        _skip(rng, 3 * options.num_points)
        self.camera_params = _perturbed_params(rng, cameras, options)

    def points(self, true_points: Array) -> Array:
        """Return the start values of the scene's next points (n, 3); call it in order."""
        shift: Array = self._point_sigma * self._of_points.standard_normal(true_points.shape)
        return true_points + shift


def median_distance(problem: Problem) -> float:
    """Return the scale of a scene: the median distance of points from their observing cameras."""
    rotations, translations = problem.cam_from_world[:, :4], problem.cam_from_world[:, 4:]
    centers = -quaternion_rotate(quaternion_inverse(rotations), translations)
    to_point = problem.points[problem.observation_point] - centers[problem.observation_image]
    return float(np.median(np.sqrt(dot(to_point, to_point))))


def _skip(rng: np.random.Generator, count: int) -> None:
    for first in range(0, count, _SKIPPED):
        rng.standard_normal(min(_SKIPPED, count - first))


def _perturbed_params(
    rng: np.random.Generator, cameras: Intrinsics, options: SceneOptions
) -> Array:
    """Return start values (num_cameras, num_params) of the camera parameters.

    All focal lengths of a camera are multiplied by the same factor, which is at least 0.5.
    """
    params = cameras.params.copy()
    count = len(params)
    factor = np.maximum(1.0 + options.focal_noise * rng.standard_normal((count, 1)), 0.5)
    params[:, cameras.columns(FOCAL_PARAMS)] *= factor
    for names, sigma in (
        (RADIAL_PARAMS, options.distortion_noise),
        (TANGENTIAL_PARAMS, 0.1 * options.distortion_noise),
    ):
        columns = cameras.columns(names)
        params[:, columns] += sigma * rng.standard_normal((count, len(columns)))
    return params
