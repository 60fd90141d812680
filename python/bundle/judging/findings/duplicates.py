"""Duplicate points: features that were detected twice and became two points each.

A detector that returns a feature once per orientation (SIFT) makes two keypoints at one pixel, and
matching makes two points of them. Each pair counts twice: standard deviations are too small, by a
factor of up to sqrt(2), and the duplicate predicts an observation that is held out.

Test. Two points are duplicates if two or more images see both at the same pixel, to a tenth. Chance
alone does this once in (area in tenths of pixels) / observations per image for one image, and never
for two.

The effect is small: on real models, sigmas are 1 to 7 % too small. So terminals show it with
--verbose only (``DETAILS``), and no command is advised.

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
    image = problem.observation_image[near].astype(np.int64)
    point = problem.observation_point[near].astype(np.int64)
    order = np.lexsort((point, y, x, image))
    image, x, y, point = image[order], x[order], y[order], point[order]
    codes, seen_by = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    size = max(problem.num_points, 1)
    for step in range(1, MOST_TWINS + 1):
        twins = np.flatnonzero(
            (image[step:] == image[:-step])
            & (x[step:] == x[:-step])
            & (y[step:] == y[:-step])
            & (point[step:] != point[:-step])
        )
        if not len(twins):
            break
        low = np.minimum(point[twins], point[twins + step])
        high = np.maximum(point[twins], point[twins + step])
        codes.append(low * size + high)
        seen_by.append(image[twins])
    code, image = np.concatenate(codes), np.concatenate(seen_by)
    order = np.lexsort((image, code))
    code, image = code[order], image[order]
    # Repeats in one image are one coincidence.
    is_new = np.ones(len(code), np.bool_)
    is_new[1:] = (code[1:] != code[:-1]) | (image[1:] != image[:-1])
    code, count = np.unique(code[is_new], return_counts=True)
    return np.stack(np.divmod(code[count >= 2], size), axis=1)
