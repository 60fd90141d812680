"""Triangulation angles of points: the largest angle over all pairs of rays, against a limit.

The angle of two rays is the angle of the lines along them, min(a, 180 - a) degrees (COLMAP,
``CalculateTriangulationAngle``): rays from opposite sides determine a point as badly as parallel
rays. With unit rays u and v it is arcsin |u x v|, which is accurate also for tiny angles. It is the
metric of the projective plane, so the triangle inequality holds. The following steps decide nearly
every point with n rays in O(n). Each step handles the points that the previous steps left
undecided:

1. The angle of the first and the last ray reaches the limit: keep the point.
2. The angle of some ray and the first ray reaches the limit: keep.
3. All rays are closer than half the limit to the first ray: remove.
4. Let f be the ray farthest from the first. The angle of some ray and f reaches the limit: keep.
5. All rays are closer than half the limit to the line midway between f and the ray farthest from
   f: remove.
6. Test all pairs, a million at a time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.problem import Problem

PAIRS_AT_ONCE = 1_000_000

_Array = NDArray[np.float64]
_Indices = NDArray[np.int64]
_Mask = NDArray[np.bool_]
_Vectors = tuple[_Array, _Array, _Array]


def enclose_angle(problem: Problem, observations: _Indices, min_angle: float) -> _Mask:
    """Return a mask of the points with two rays at an angle of at least ``min_angle``.

    ``observations``: indices of the observations to use; a point with fewer than two fails.
    ``min_angle``: smallest accepted angle in degrees, above 0, at most 90.

    Returns:
        (num_points,)
    """
    result = np.zeros(problem.num_points, bool)
    if len(observations) == 0:
        return result
    point = problem.observation_point[observations]
    if (point[1:] < point[:-1]).any():
        order = np.argsort(point, kind="stable")
        point, observations = point[order], observations[order]
    begin = np.r_[0, np.flatnonzero(point[1:] != point[:-1]) + 1]
    lengths = np.diff(begin, append=len(point))
    limit = np.sin(np.deg2rad(min_angle)) ** 2
    first = _unit_rays(problem, observations[begin])
    last = _unit_rays(problem, observations[begin + lengths - 1])
    kept = _squared_sines(first, last) >= limit
    open_ = np.flatnonzero(~kept & (lengths > 2))
    if len(open_):
        places, begin_open = _runs(begin[open_], lengths[open_])
        xyz = _unit_rays(problem, observations[places])
        kept[open_] = _enclose(_Rays(xyz, begin_open, lengths[open_]), np.deg2rad(min_angle))
    result[point[begin[kept]]] = True
    return result


def _runs(begin: _Indices, lengths: _Indices) -> tuple[_Indices, _Indices]:
    """Return the concatenated positions of some runs, and where each run begins in the result."""
    begins = np.cumsum(lengths) - lengths
    return np.arange(lengths.sum()) + np.repeat(begin - begins, lengths), begins


@dataclass(frozen=True)
class _Rays:
    """Unit rays, grouped by point: point k has rays begin[k] to begin[k] + lengths[k] - 1."""

    xyz: _Vectors
    begin: _Indices
    lengths: _Indices

    def of(self, mask: _Mask) -> _Rays:
        """Return the rays of the points in a mask."""
        places, begin = _runs(self.begin[mask], self.lengths[mask])
        return _Rays(self.at(places), begin, self.lengths[mask])

    def at(self, places: _Indices) -> _Vectors:
        """Return the rays at some positions."""
        x, y, z = self.xyz
        return x[places], y[places], z[places]

    def squared_sines(self, lines: _Vectors) -> _Array:
        """Return sin^2 of the angle between each ray and its point's line in ``lines``."""
        x, y, z = (np.repeat(values, self.lengths) for values in lines)
        return _squared_sines(self.xyz, (x, y, z))

    def largest(self, values: _Array) -> _Array:
        """Return the largest value for each point, from one value per ray."""
        result: _Array = np.maximum.reduceat(values, self.begin)
        return result

    def farthest(self, values: _Array, largest: _Array) -> _Indices:
        """Return, for each point, the position of the first ray with the largest value."""
        hits = np.flatnonzero(values == np.repeat(largest, self.lengths))
        return hits[np.searchsorted(hits, self.begin)]


def _unit_rays(problem: Problem, observations: _Indices) -> _Vectors:
    """Return unit vectors from points to projection centres; zero where the two coincide."""
    image = problem.observation_image[observations].astype(np.intp)
    point = problem.observation_point[observations].astype(np.intp)
    centers = problem.projection_centers
    x, y, z = (centers[:, j].take(image) - problem.points[:, j].take(point) for j in range(3))
    with np.errstate(divide="ignore", over="ignore"):
        scale = 1 / np.sqrt(x * x + y * y + z * z)
    scale[~np.isfinite(scale)] = 0.0
    return x * scale, y * scale, z * scale


def _squared_sines(a: _Vectors, b: _Vectors) -> _Array:
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    squares: _Array = x * x + y * y + z * z
    return squares


def _enclose(rays: _Rays, angle: float) -> _Mask:
    """Return a mask of the points with two rays at an angle of at least the limit [rad]."""
    limit, half = np.sin(angle) ** 2, np.sin(angle / 2) ** 2
    # Steps 2 and 3: the first ray.
    sines = rays.squared_sines(rays.at(rays.begin))
    largest = rays.largest(sines)
    kept: _Mask = largest >= limit
    open_ = ~kept & (largest >= half)
    if not open_.any():
        return kept
    farthest = (rays.farthest(sines, largest) - rays.begin)[open_]
    rest = rays.of(open_)
    # Step 4: the ray farthest from the first.
    first = rest.at(rest.begin + farthest)
    sines = rest.squared_sines(first)
    largest = rest.largest(sines)
    decided = largest >= limit
    # Step 5: the line midway.
    second = rest.at(rest.farthest(sines, largest))
    sign = np.where(sum(a * b for a, b in zip(first, second, strict=True)) < 0, -1.0, 1.0)
    x, y, z = (a + sign * b for a, b in zip(first, second, strict=True))
    norm = np.sqrt(x * x + y * y + z * z)
    radius = rest.largest(rest.squared_sines((x / norm, y / norm, z / norm)))
    undecided = ~decided & (radius >= half)
    # Step 6: all pairs.
    decided[undecided] = _all_pairs(rest.of(undecided), limit)
    kept[open_] = decided
    return kept


def _all_pairs(rays: _Rays, limit: float) -> _Mask:
    """Return a mask of the points with a pair of rays whose sin^2 reaches the limit."""
    kept = np.zeros(len(rays.begin), bool)
    run = np.repeat(np.arange(len(rays.begin)), rays.lengths)
    place = np.arange(len(run))
    later = rays.begin[run] + rays.lengths[run] - 1 - place  # later rays of the same point
    ends = np.cumsum(later)
    low = 0
    while low < len(place):
        done = ends[low - 1] if low else 0
        high = max(low + 1, int(np.searchsorted(ends, done + PAIRS_AT_ONCE, side="right")))
        counts = later[low:high]
        one = np.repeat(place[low:high], counts)
        other = one + 1 + np.arange(len(one)) - np.repeat(np.cumsum(counts) - counts, counts)
        hits = _squared_sines(rays.at(one), rays.at(other)) >= limit
        kept[run[one[hits]]] = True
        low = high
    return kept
