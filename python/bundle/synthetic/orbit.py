"""Rings of cameras around an object: a star-shaped body.

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
from bundle.model.rigid_motions import dot, look_along
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


# Star-shaped bodies: rough balls and boxes, stretched along the axes.
#
# The surface is ``center + half_axes * d * radius(d)`` for unit directions ``d``, with
#
#     radius(d) = norm(d)^-1 * (1 + sum_k amplitude_k * cos(frequency_k . d + phase_k)),
#
# where the norm is the p-norm: a ball for p = 2, closer to a box for larger p. Before the stretch,
# the surface is the zero set of ``F(y) = |y| - radius(y / |y|)``, whose gradient
#
#     d - (I - d d^T) grad radius(d) / |y|
#
# is the normal. Stretching divides the components of a normal by the half axes.

_NUM_WAVES = 12


class Body:
    """A body with center (3,), half axes (3,) in length units, and the exponent of its norm."""

    def __init__(
        self, rng: np.random.Generator, center: Array, half_axes: Array, exponent: int
    ) -> None:
        self.center = center
        self.half_axes = half_axes
        self._exponent = exponent
        size = rng.uniform(2.0, 9.0, _NUM_WAVES)
        self._frequencies = size[:, None] * random_directions(rng, _NUM_WAVES)
        self._amplitudes = 0.12 / size
        self._phases = rng.uniform(0.0, 2 * np.pi, _NUM_WAVES)

    @property
    def radius(self) -> float:
        """Mean half axis."""
        return float(self.half_axes.mean())

    def surface(self, directions: Array) -> tuple[Array, Array]:
        """Return surface positions (n, 3) and unit outward normals (n, 3) in directions (n, 3)."""
        d = directions / np.sqrt(dot(directions, directions))[:, None]
        relief = np.ones(len(d))
        slope = np.zeros_like(d)
        for frequency, amplitude, phase in zip(
            self._frequencies, self._amplitudes, self._phases, strict=True
        ):
            angle = dot(d, frequency) + phase
            relief += amplitude * np.cos(angle)
            slope -= (amplitude * np.sin(angle))[:, None] * frequency
        powers = np.abs(d) ** (self._exponent - 1)
        norm_power = dot(powers, np.abs(d))
        radius = relief * norm_power ** (-1.0 / self._exponent)
        gradient = radius[:, None] * (
            slope / relief[:, None] - np.sign(d) * powers / norm_power[:, None]
        )
        normals = d - (gradient - dot(gradient, d)[:, None] * d) / radius[:, None]
        normals /= self.half_axes
        normals /= np.sqrt(dot(normals, normals))[:, None]
        return self.center + self.half_axes * d * radius[:, None], normals

    def toward(self, positions: Array) -> Array:
        """Return directions (n, 3), not normalised, of the surface points below positions."""
        return (positions - self.center) / self.half_axes


def random_directions(rng: np.random.Generator, count: int) -> Array:
    """Return (count, 3) unit vectors, uniform on the sphere."""
    vectors = rng.standard_normal((count, 3))
    return vectors / np.sqrt(dot(vectors, vectors))[:, None]
