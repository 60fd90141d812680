"""Rings of cameras around an object.

The object is a rough ball of about unit radius. A point is seen only by cameras near the direction
of its surface normal, which are an arc of each ring. With thousands of images, wanted tracks may be
much shorter than this arc. Points are then recognised only for smaller changes of the viewing
angle.

Length unit: the mean radius of the object; z is up.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.interface.scene_options import SceneOptions
from bundle.model.rotations import dot, look_along
from bundle.synthetic.body import Body, random_directions
from bundle.synthetic.scene import Images, Pairs, Points, Scene

Array = NDArray[np.float64]

DISTANCE = 3.6
FOCAL = 1.25
WIDEST_ANGLE = np.radians(65.0)  # between the normal and the direction to the camera
WIDEST_STEP = np.radians(45.0)  # between neighbours on a ring
LOWEST, HIGHEST = np.radians(8.0), np.radians(55.0)  # elevation of the rings


class Orbit(Scene):
    """Scene of this kind; see the module docstring."""

    min_cosine = float(np.cos(WIDEST_ANGLE))

    def __init__(self, rng: np.random.Generator, options: SceneOptions) -> None:
        count = options.num_images
        self.body = Body(rng, np.zeros(3), np.array([1.0, 0.9, 1.1]), 2)
        outward = _rings(rng, count, options.num_rings or int(np.clip(round(count / 40), 1, 6)))
        centers = DISTANCE * rng.uniform(0.92, 1.08, count)[:, None] * outward
        aims = rng.normal(0.0, 0.05, (count, 3))
        angle = _view_angle(rng, outward, 3.0 * options.wanted_track_length)
        self.images = Images(
            centers=centers,
            rotations=look_along(aims - centers, rng.normal(0.0, 0.03, count)),
            focal=np.full(count, FOCAL),
            sizes=np.tile(np.array(options.image_size, dtype=np.int64), (count, 1)),
            richness=np.ones(count),
            ball_centers=outward,
            ball_radii=np.full(count, 2.0 * np.sin(0.5 * angle)),
        )

    def draw_points(self, rng: np.random.Generator, count: int) -> Points:
        """Draw points on the whole surface of the object except its underside."""
        directions = random_directions(rng, 2 * count)
        directions = directions[directions[:, 2] > -0.55][:count]
        positions, normals = self.body.surface(directions)
        return Points(positions, normals, np.full(len(positions), np.inf), normals)

    def draw_lengths(self, rng: np.random.Generator, count: int) -> Array:
        """Draw fairly even track lengths: a gamma distribution of shape 2."""
        return rng.standard_gamma(2.0, count) / 2.0

    def preference(self, rng: np.random.Generator, points: Points, pairs: Pairs) -> Array:
        """Prefer images that view the surface perpendicularly."""
        cosine = dot(points.keys[pairs.point], self.images.ball_centers[pairs.image])
        return rng.uniform(0.0, 0.1, len(pairs)) - cosine


def _rings(rng: np.random.Generator, count: int, num_rings: int) -> Array:
    """Return unit directions (count, 3) on rings, in order around each ring, lowest ring first."""
    ring = np.arange(count) * num_rings // count
    first = np.searchsorted(ring, np.arange(num_rings + 1))
    # A ring with few cameras is only an arc, so that neighbours see the same side of the object.
    step: Array = np.minimum(2 * np.pi / np.diff(first), WIDEST_STEP)
    azimuth = (np.arange(count) - first[ring]) * step[ring]
    azimuth += rng.uniform(0.0, 2 * np.pi, num_rings)[ring]
    azimuth += rng.normal(0.0, 0.15, count) * step[ring]
    steps = max(num_rings - 1, 1)
    elevation = LOWEST + (HIGHEST - LOWEST) * ring / steps if num_rings > 1 else LOWEST + 0.2
    elevation = elevation + rng.normal(0.0, 0.02, count)
    return np.stack(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ],
        axis=1,
    )


def _view_angle(rng: np.random.Generator, outward: Array, views: float) -> float:
    """Return the angle within which a point has about ``views`` cameras, or the widest angle."""
    normals = outward[rng.integers(0, len(outward), 200)] + rng.normal(0.0, 0.3, (200, 3))
    normals /= np.sqrt(dot(normals, normals))[:, None]
    cosines = np.sort(dot(normals[:, None, :], outward[None, :, :]), axis=1)[:, ::-1]
    nth = min(int(views), cosines.shape[1]) - 1
    return float(np.arccos(np.clip(np.median(cosines[:, nth]), np.cos(WIDEST_ANGLE), 1.0)))
