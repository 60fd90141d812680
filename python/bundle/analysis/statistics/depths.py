"""Depths of observed points in their cameras, and points collapsed onto a camera.

A depth is the third coordinate of R X + t, in the reconstruction's length unit. A solve can pull
points onto a projection centre, where any direction fits. Their depths are then many orders of
magnitude smaller than others, and their derivatives as many larger.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import median
from bundle.base.records import dataclass
from bundle.model.problem import Problem

COLLAPSED = 1e-4
"""Share of the median below which a depth is not determined by images."""


@dataclass(frozen=True, kw_only=True)
class Depths:
    """Depths over all observations; every number is NaN without observations.

    Attributes:
        min: smallest depth, negative for a point behind its camera.
        p5: 5th percentile.
        median: 50th percentile.
        p95: 95th percentile.
        max: largest depth.
        num_behind: observations with a depth of at most zero.
        num_collapsed: observations with an absolute depth below 1e-4 of the median.
    """

    min: float
    p5: float
    median: float
    p95: float
    max: float
    num_behind: int
    num_collapsed: int


def depths_of_observations(problem: Problem) -> NDArray[np.float64]:
    """Return the depth of each observation's point, (num_observations,)."""
    x, y, z, w = problem.cam_from_world[:, :4].T
    # Third row of the rotation for a quaternion of any norm.
    row = np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), w * w + z * z - x * x - y * y])
    row /= (problem.cam_from_world[:, :4] ** 2).sum(axis=1, keepdims=True)
    image = problem.observation_image
    across = np.einsum("ij,ij->i", row[image], problem.points[problem.observation_point])
    depths: NDArray[np.float64] = across + problem.cam_from_world[image, 6]
    return depths


def summarize(depths: NDArray[np.float64]) -> Depths:
    """Return the statistics of depths."""
    if not len(depths):
        nan = float("nan")
        return Depths(min=nan, p5=nan, median=nan, p95=nan, max=nan, num_behind=0, num_collapsed=0)
    low, p5, median, p95, high = np.quantile(depths, [0, 0.05, 0.5, 0.95, 1])
    return Depths(
        min=float(low),
        p5=float(p5),
        median=float(median),
        p95=float(p95),
        max=float(high),
        num_behind=int((depths <= 0).sum()),
        num_collapsed=int((np.abs(depths) < COLLAPSED * median).sum()),
    )


def collapsed_observations(problem: Problem, depths: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the mask (num_observations,) of observations of points collapsed onto their camera.

    A wide lens also observes distant points at a depth of zero, so the distance must be as small.
    """
    near: NDArray[np.bool_] = np.zeros(len(depths), bool)
    if not len(depths):
        return near
    chosen = np.flatnonzero(np.abs(depths) < COLLAPSED * median(depths))
    centers = problem.projection_centers[problem.observation_image]
    distance = np.linalg.norm(problem.points[problem.observation_point] - centers, axis=1)
    near[chosen] = distance[chosen] < COLLAPSED * median(distance)
    return near
