"""Photographs by tourists of landmarks around a square.

A few landmarks have most of the images. Each visitor takes a few images. They show a whole building
or a part of it, down to details through a telephoto lens. Some images show two neighbouring
landmarks from farther away, which connects the clusters. Track lengths are heavy-tailed: most
points are observed in few images, some points in a large part of their cluster's images.

Length unit: metre; z is up; the square is at z = 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.interface.scene_options import SceneOptions
from bundle.model.rigid_motions import dot, look_along
from bundle.synthetic.orbit import Body
from bundle.synthetic.scene import Images, Pairs, Points, Scene

Array = NDArray[np.float64]

MEDIAN_RADIUS = 12.0
EYE_HEIGHT = 1.7
PANORAMA_SHARE = 0.1
SHARED_FOCAL = 0.9
# Visitors see the side of a landmark that faces the square.
ANGLE_SPREAD = np.radians(35.0)
SHOTS_PER_VISITOR = 3
PARETO_SHAPE = 2.3
# Landmarks are boxes with rounded edges; the exponent of their norm.
_SQUARENESS = 6
# No image aims at a steeper surface (cosine between normal and line of sight).
_STEEPEST_AIM = 0.5


@dataclass(frozen=True)
class _Shots:
    """Positions and targets of images, and the radii around the targets that are visible."""

    centers: Array
    aims: Array
    footprints: Array


class PhotoCollection(Scene):
    """Scene of this kind; see the module docstring."""

    min_cosine = 0.25

    def __init__(self, rng: np.random.Generator, options: SceneOptions) -> None:
        count = options.num_images
        self.bodies = _landmarks(rng, max(1, round(np.sqrt(count) / 3)))
        shared = options.has_shared_camera
        self._landmark, self._is_panorama, time = _subjects(rng, count, len(self.bodies))
        self._visitor, self._is_first = time // SHOTS_PER_VISITOR, time % SHOTS_PER_VISITOR == 0
        focal = np.clip(np.exp(rng.normal(np.log(1.1), 0.55, count)), 0.6, 6.0)
        focal = np.where(self._is_panorama, rng.uniform(0.6, 0.9, count), focal)
        focal = np.full(count, SHARED_FOCAL) if shared else focal
        shots = self._take(rng, focal)
        sizes = np.tile(np.array(options.image_size, dtype=np.int64), (count, 1))
        self.images = Images(
            centers=shots.centers,
            rotations=look_along(shots.aims - shots.centers, rng.normal(0.0, 0.03, count)),
            focal=focal,
            sizes=sizes if shared else _vary(rng, sizes, self._is_panorama),
            richness=np.exp(rng.normal(0.0, 0.7, count)),
            ball_centers=shots.aims,
            ball_radii=shots.footprints,
        )

    def draw_points(self, rng: np.random.Generator, count: int) -> Points:
        """Draw points near the targets of images, so that popular places get many points."""
        close_ups = np.flatnonzero(~self._is_panorama)
        image = close_ups[rng.integers(0, len(close_ups), count)]
        spread = 0.5 * self.images.ball_radii[image, None]
        wanted = self.images.ball_centers[image] + spread * rng.standard_normal((count, 3))
        positions, normals = self._on_landmarks(self._landmark[image], wanted)
        above_ground = positions[:, 2] > 0.2
        points = Points(positions, normals, np.full(count, np.inf), positions)
        return points.take(above_ground)

    def draw_lengths(self, rng: np.random.Generator, count: int) -> Array:
        """Draw heavy-tailed track lengths: a Pareto (Lomax) distribution."""
        return rng.pareto(PARETO_SHAPE, count) * (PARETO_SHAPE - 1.0)

    def preference(self, rng: np.random.Generator, points: Points, pairs: Pairs) -> Array:
        """Prefer images with high ``richness``; the order is otherwise random."""
        del points
        return rng.standard_exponential(len(pairs)) / self.images.richness[pairs.image]

    def _take(self, rng: np.random.Generator, focal: Array) -> _Shots:
        close, wide = self._close_up(rng, focal), self._panorama(rng, focal)
        panorama = self._is_panorama
        return _Shots(
            centers=np.where(panorama[:, None], wide.centers, close.centers),
            aims=np.where(panorama[:, None], wide.aims, close.aims),
            footprints=np.where(panorama, wide.footprints, close.footprints),
        )

    def _close_up(self, rng: np.random.Generator, focal: Array) -> _Shots:
        """Aim at a landmark: first at the complete landmark, then at random details."""
        count = len(focal)
        centers = np.array([body.center for body in self.bodies])[self._landmark]
        radius = np.array([body.radius for body in self.bodies])[self._landmark]
        # The square is centred on the origin.
        front = np.arctan2(-centers[:, 1], -centers[:, 0])
        angle = np.clip(rng.normal(0.0, ANGLE_SPREAD, count), -1.0, 1.0)[self._visitor]
        azimuth = front + angle + rng.normal(0.0, 0.06, count)
        outward = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(count)], axis=1)
        typical = np.where(self._is_first, np.log(1.1), np.log(0.65))
        framed = radius * np.exp(rng.normal(typical, np.where(self._is_first, 0.15, 0.45)))
        distance = np.clip(2.0 * focal * framed, 0.7 * radius, 12.0 * radius)
        footprint = distance / (2.0 * focal)
        freedom = np.clip(1.0 - 0.6 * footprint / radius, 0.15, 1.0)[:, None]
        wander = rng.uniform([-0.6, -0.6, -0.25], [0.6, 0.6, 0.6], (count, 3))[self._visitor]
        wander = freedom * (wander + rng.normal(0.0, 0.05, (count, 3)))
        aims, normals = self._on_landmarks(
            self._landmark, centers + radius[:, None] * (outward + wander)
        )
        steep = dot(normals, outward) < _STEEPEST_AIM
        aims[steep] = self._on_landmarks(self._landmark, centers + radius[:, None] * outward)[0][
            steep
        ]
        positions = aims + outward * distance[:, None]
        positions[:, 2] = EYE_HEIGHT + rng.normal(0.0, 0.15, count) + rng.exponential(0.5, count)
        return _Shots(positions, aims, 1.25 * footprint)

    def _on_landmarks(self, landmark: NDArray[np.int64], wanted: Array) -> tuple[Array, Array]:
        """Move positions (n, 3) onto the surfaces of landmarks (n,); also return normals (n, 3)."""
        positions, normals = np.empty_like(wanted), np.empty_like(wanted)
        for index, body in enumerate(self.bodies):
            mine = landmark == index
            positions[mine], normals[mine] = body.surface(body.toward(wanted[mine]))
        return positions, normals

    def _panorama(self, rng: np.random.Generator, focal: Array) -> _Shots:
        """Aim between a landmark and the next one around the square."""
        count = len(focal)
        centers = np.array([body.center for body in self.bodies])
        here = centers[self._landmark]
        there = centers[(self._landmark + 1) % len(self.bodies)]
        middle = 0.5 * (here + there)
        across = np.sqrt(((here - there) ** 2).sum(axis=1)) + 2.5 * MEDIAN_RADIUS
        distance = across * focal * rng.uniform(1.0, 1.4, count)
        inward = -middle / np.sqrt((middle**2).sum(axis=1))[:, None]
        inward += rng.normal(0.0, 0.12, (count, 3))
        positions = middle + inward * distance[:, None]
        positions[:, 2] = EYE_HEIGHT + rng.exponential(2.0, count)
        return _Shots(positions, middle, 0.6 * across)


def _landmarks(rng: np.random.Generator, count: int) -> list[Body]:
    """Build landmarks on a circle about the origin; neighbours do not touch."""
    circle = max(60.0, 5.0 * MEDIAN_RADIUS * count / (2 * np.pi))
    bodies = []
    for index in range(count):
        radius = float(np.clip(MEDIAN_RADIUS * np.exp(rng.normal(0.0, 0.25)), 8.0, 18.0))
        half_axes = radius * np.array([1.0, 1.0, 1.0]) * rng.uniform(0.75, 1.25, 3)
        angle = (index + rng.uniform(-0.1, 0.1)) * 2 * np.pi / max(count, 3)
        center = np.array([circle * np.cos(angle), circle * np.sin(angle), 0.6 * half_axes[2]])
        bodies.append(Body(rng, center, half_axes, _SQUARENESS))
    return bodies


def _subjects(
    rng: np.random.Generator, count: int, num_landmarks: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.int64]]:
    """Return landmark (by Zipf's law), panorama flag, and time of each image (count,).

    Panoramas show each pair of neighbours in turn. Images are in random order.
    """
    num_panoramas = 0 if num_landmarks == 1 else max(
        2 * (num_landmarks - 1), round(PANORAMA_SHARE * count)
    )  # fmt: skip
    popularity = 1.0 / (np.arange(num_landmarks) + 1.0)
    cumulative = np.cumsum(popularity / popularity.sum())
    # Use evenly spaced quantiles instead of random draws, so that every landmark has images.
    quantiles = (np.arange(count - num_panoramas) + 0.5) / (count - num_panoramas)
    landmark = np.searchsorted(cumulative[:-1], quantiles)
    pairs = np.arange(num_panoramas) % max(num_landmarks - 1, 1)
    shuffle = rng.permutation(count)
    is_panorama = np.arange(count) >= count - num_panoramas
    return np.concatenate([landmark, pairs])[shuffle], is_panorama[shuffle], shuffle


def _vary(
    rng: np.random.Generator, sizes: NDArray[np.int64], is_panorama: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Return image sizes of various devices: some much larger, a quarter in portrait format.

    Panoramas are never in portrait format.
    """
    factor = np.clip(np.exp(rng.normal(0.0, 0.45, len(sizes))), 0.4, 4.0)
    varied = np.maximum(np.round(sizes * factor[:, None]), 64).astype(np.int64)
    upright = (rng.random(len(sizes)) < 0.25) & ~is_panorama
    oriented: NDArray[np.int64] = np.where(upright[:, None], varied[:, ::-1], varied)
    return oriented
