"""Duplicate points: features that were detected twice and became two points each.

A detector that returns a feature once per orientation (SIFT) makes two keypoints at one pixel, and
matching makes two points of them. Each pair counts twice: standard deviations are too small, by a
factor of up to sqrt(2), and the duplicate predicts an observation that is held out.

Test. Two points are duplicates if two or more images see both at the same pixel, to a tenth. By
chance, a point has such a partner in one image with a probability of observations per image / area
in tenths of pixels, and in two images practically never.

The effect is small: on real models, sigmas are 1 to 7 % too small. So terminals show it with
--verbose only (``DETAILS``), and no command is suggested.

Threshold. 10 % of the observed points are in such pairs: standard deviations are 5 % too small.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import distinct
from bundle.interface.finding import Finding
from bundle.judging.findings.measured import Measured
from bundle.model.problem import Problem

TENTHS = 10.0
SHARE = 0.1
FEWEST_PAIRS = 5
MOST_TWINS = 4
"""Number of following observations at a pixel that are compared with each observation."""


def duplicate_points(measured: Measured) -> Finding | None:
    """Return the finding about points that exist twice, or None."""
    problem = measured.problem
    pairs = _pairs(problem)
    points = distinct(pairs)
    seen = len(distinct(problem.observation_point))
    share = len(points) / max(seen, 1)
    if len(pairs) < FEWEST_PAIRS or share < SHARE:
        return None
    ids = problem.point_ids[pairs[:5]].tolist()
    return Finding(
        kind="duplicate_points",
        sentence=f"{100 * share:.0f} % of the points are duplicates: two points at the same pixels "
        f"of the same images (such as points {ids[0][0]} and {ids[0][1]}). Standard deviations are "
        "too small. Match with one orientation per feature, or keep one point of each pair.",
        evidence={"num_points": len(points), "num_pairs": len(pairs), "share": share, "pairs": ids},
    )


def _pairs(problem: Problem) -> NDArray[np.int64]:
    """Return (n, 2) pairs of points that share a pixel in two or more images."""
    xy = problem.observation_xy
    near = np.isfinite(xy).all(axis=1) & (np.abs(xy) < 1e8).all(axis=1)
    x, y = np.rint(xy[near] * TENTHS).astype(np.int64).T
    point = problem.observation_point[near].astype(np.int64)
    place = np.stack([problem.observation_image[near], x, y])
    order = np.lexsort((point, *place[::-1]))
    place, point = place[:, order], point[order]
    size = max(problem.num_points, 1)
    found = [np.zeros((2, 0), np.int64)]
    for step in range(1, MOST_TWINS + 1):
        same = (place[:, step:] == place[:, :-step]).all(axis=0) & (point[step:] != point[:-step])
        found.append(np.stack([point[:-step] * size + point[step:], place[0, step:]])[:, same])
    pair, image = np.concatenate(found, axis=1)
    order = np.lexsort((image, pair))
    pair, image = pair[order], image[order]
    again = (pair[1:] == pair[:-1]) & (image[1:] != image[:-1])
    return np.stack(np.divmod(distinct(pair[1:][again]), size), axis=1)
