"""Star-shaped bodies: rough balls and boxes, stretched along the axes.

The surface is ``center + half_axes * d * radius(d)`` for unit directions ``d``, with

    radius(d) = norm(d)^-1 * (1 + sum_k amplitude_k * cos(frequency_k . d + phase_k)),

where the norm is the p-norm: a ball for p = 2, closer to a box for larger p. Before the stretch,
the surface is the zero set of ``F(y) = |y| - radius(y / |y|)``, whose gradient

    d - (I - d d^T) grad radius(d) / |y|

is the normal. Stretching divides the components of a normal by the half axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.model.rotations import dot

Array = NDArray[np.float64]
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
