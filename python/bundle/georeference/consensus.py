"""Robust start of a fit: correspondences that agree on one similarity.

Least median of squares (Rousseeuw 1984). Each of many triples of points gives a similarity. The
winner has the smallest h-th smallest squared residual in sigmas, h = floor(n / 2) + 2. Up to (n -
h) points may therefore be anywhere, even a continent away, without any influence. Reweighting that
starts from all points does not achieve this, because a single gross error rotates the whole fit.

The residuals of the winner give an estimate of the scale. It uses the median length 1.538 of three
Gaussian coordinates and a correction for small n,

    s = (1 + 5 / (n - 3)) sqrt(r2_(h)) / 1.538,

but at least one sigma. Points with a residual below 2.795 s (95 % of good points) agree. Two rounds
of fitting these points and selecting again remove the noise of the winning triple.
"""

from __future__ import annotations

from itertools import combinations
from math import comb, sqrt

import numpy as np
from numpy.typing import NDArray

from bundle.georeference.similarity import scale_and_rotation, umeyama
from bundle.interface.georeference_options import ROBUST_SCALE

Array = NDArray[np.float64]

MOST_TRIPLES = 1000
"""Largest number of triples that are all tried; beyond it, this number of random triples is used.

If half of the points are wrong, all random triples contain a wrong point with probability
(7/8)^1000 = 1e-58.
"""
MOST_SCORED = 1000
"""Largest number of points whose residuals score a triple."""
MEDIAN_LENGTH = 1.538172
"""Median length of a vector of three standard Gaussian coordinates."""


def agreeing(source: Array, target: Array, sigmas: Array) -> NDArray[np.bool_]:
    """Return the mask of the correspondences that agree with the similarity of the majority.

    The random generator is seeded: equal input gives equal output.

    Args:
        source: (n, 3) points of a model.
        target: (n, 3) their surveyed positions.
        sigmas: (n, 3) standard deviations of the targets; huge for coordinates without influence.
    """
    count = len(source)
    if count <= 3:
        return np.ones(count, dtype=bool)
    rng = np.random.default_rng(0)
    scored = np.arange(count) if count <= MOST_SCORED else rng.permutation(count)[:MOST_SCORED]
    rank = len(scored) // 2 + 2 - 1  # rank of the h-th smallest, from 0
    triples = _triples(count, rng)
    squared = _squared_lengths(source, target, sigmas, triples, scored)
    score = np.partition(squared, rank, axis=1)[:, rank]
    best = int(np.argmin(score))
    rows = triples[best]
    for _ in range(3):
        chosen = _within(_residual(source, target, sigmas, rows), count)
        if chosen.sum() < 3:  # coincident points: the fit will report the error
            return np.ones(count, dtype=bool)
        rows = np.flatnonzero(chosen)
    return chosen


def _triples(count: int, rng: np.random.Generator) -> NDArray[np.int64]:
    if comb(count, 3) <= MOST_TRIPLES:
        return np.array(list(combinations(range(count), 3)))
    # Draw three different indices per triple by their differences on a circle. This avoids a list
    # of all triples.
    first = rng.integers(count, size=MOST_TRIPLES)
    gaps = np.sort(rng.integers(count - 2, size=(MOST_TRIPLES, 2)), axis=1)
    second, third = gaps[:, 0] + 1, gaps[:, 1] + 2
    return np.column_stack([first, (first + second) % count, (first + third) % count])


def _squared_lengths(
    source: Array,
    target: Array,
    sigmas: Array,
    triples: NDArray[np.int64],
    scored: NDArray[np.int64],
) -> Array:
    """Return (triples, points) squared residuals in sigmas; inf for triples without a fit."""
    a, b = source[triples], target[triples]
    center, goal = a.mean(axis=1, keepdims=True), b.mean(axis=1, keepdims=True)
    a, b = a - center, b - goal
    with np.errstate(all="ignore"):
        scale, rotation = scale_and_rotation(a, b)
        turned = (source[scored] - center) @ np.swapaxes(rotation, 1, 2)
        residual = scale[:, None, None] * turned + goal - target[scored]
        squared: Array = ((residual / sigmas[scored]) ** 2).sum(axis=2)
    squared[~np.isfinite(squared)] = np.inf
    return squared


def _residual(source: Array, target: Array, sigmas: Array, rows: NDArray[np.int64]) -> Array:
    """Return (n,) squared residuals in sigmas about the fit to some rows."""
    with np.errstate(all="ignore"):  # rows may be coincident points
        similarity = umeyama(source[rows], target[rows])
        squared: Array = (((similarity.apply(source) - target) / sigmas) ** 2).sum(axis=1)
    return squared


def _within(squared: Array, count: int) -> NDArray[np.bool_]:
    rank = count // 2 + 2 - 1
    middle = float(np.partition(squared, rank)[rank])
    scale = max(1.0, (1 + 5 / (count - 3)) * sqrt(middle) / MEDIAN_LENGTH)
    within: NDArray[np.bool_] = squared <= (ROBUST_SCALE * scale) ** 2
    return within
