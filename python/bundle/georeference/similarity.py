"""Similarities x -> s R x + t: closed form, robust start, and problems moved by them.

With the centred points a_i of a model, their targets b_i, and sum b a^T = U D V^T (Umeyama,
"Least-squares estimation of transformation parameters between two point patterns", PAMI 13(4),
1991),

    R = U diag(1, 1, d) V^T,  d = det(U) det(V),  s = (D_1 + D_2 + d D_3) / sum |a|^2.

Coplanar points give D_3 = 0, and R is still unique, because d is chosen so that R is a rotation.
Only D_2 = 0, collinear points, leaves an angle free.

Under x' = s R x + t the camera frames keep their axes and scale with the scene: a point at R_c x +
t_c in its camera moves to s (R_c x + t_c). So

    R_c' = R_c R^T,  t_c' = s t_c - R_c' t,

and no projection changes. Frames of rigs move as cameras do. What is in the frame of a camera or a
rig scales with the scene: t_s' = s t_s for a sensor_from_rig, and likewise the translation of a
rolling shutter's twist. ``bundle.model.estimates`` has the rule of each array.
"""

from __future__ import annotations

from itertools import combinations
from math import comb, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.georeference.local_frame import without_origin
from bundle.interface.georeference_options import ROBUST_SCALE
from bundle.model.estimates import VARIABLES, Variable, estimates, with_estimates
from bundle.model.problem import Problem
from bundle.model.rig_arrays import placed
from bundle.model.rigid_motions import (
    quaternion_from_matrix,
    quaternion_inverse,
    quaternion_multiply,
    rotation_matrices,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Similarity:
    """Map x -> scale * rotation @ x + translation.

    Attributes:
        scale: metres per length unit of the model.
        rotation: (3, 3).
        translation: (3,) metres.
    """

    scale: float
    rotation: Array
    translation: Array

    def apply(self, points: Array) -> Array:
        """Return (n, 3) mapped points."""
        mapped: Array = self.scale * points @ self.rotation.T + self.translation
        return mapped

    def after(self, first: Similarity) -> Similarity:
        """Return the composition: ``first``, then this similarity."""
        return Similarity(
            self.scale * first.scale,
            self.rotation @ first.rotation,
            self.apply(first.translation[None])[0],
        )

    def asdict(self) -> dict[str, Any]:
        """Return scale, rotation (three rows) and translation by name."""
        return {
            "scale": self.scale,
            "rotation": self.rotation.tolist(),
            "translation": self.translation.tolist(),
        }


def umeyama(source: Array, target: Array) -> Similarity:
    """Return the least-squares similarity, with the same weight for every point.

    ``source``: (n, 3) points of the model. ``target``: (n, 3) target positions of these points.
    """
    center, goal = source.mean(axis=0), target.mean(axis=0)
    scale, rotation = scale_and_rotation(source - center, target - goal)
    return Similarity(float(scale), rotation, goal - scale * rotation @ center)


def scale_and_rotation(a: Array, b: Array) -> tuple[Array, Array]:
    """Return scales (...) and rotations (..., 3, 3) of sets of centred points (..., n, 3)."""
    u, d, vt = np.linalg.svd(np.swapaxes(b, -1, -2) @ a)
    sign = np.ones_like(d)
    sign[..., 2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    rotation: Array = (u * sign[..., None, :]) @ vt
    scale: Array = (d * sign).sum(axis=-1) / (a**2).sum(axis=(-2, -1))
    return scale, rotation


def moved(problem: Problem, similarity: Similarity) -> Problem:
    """Return the problem moved by the similarity; observations and cameras do not change."""
    known = estimates(problem)
    values = {
        one.name: _moved(known[one.name], one, similarity)
        for one in VARIABLES
        if one.name in known and one.similarity != "none"
    }
    if problem.num_frames:
        rigs = {name: getattr(problem, name) for name in ("image_frame", "image_sensor")}
        values["cam_from_world"] = placed(rigs | values)
    return without_origin(with_estimates(problem, values, checked=True))


def _moved(values: Array, variable: Variable, similarity: Similarity) -> Array:
    """Return an array of a problem after a similarity of the world, as the table says."""
    if variable.similarity == "pose":
        return _moved_poses(values, similarity)
    if variable.similarity == "point":
        return similarity.apply(values)
    moved = values.copy()
    moved[:, variable.lengths] *= similarity.scale
    return moved


def _moved_poses(poses: NDArray[np.float64], similarity: Similarity) -> NDArray[np.float64]:
    back = quaternion_inverse(quaternion_from_matrix(similarity.rotation[None]))
    quaternions = quaternion_multiply(poses[:, :4], back)
    turned = rotation_matrices(quaternions)
    translations = similarity.scale * poses[:, 4:] - turned @ similarity.translation
    return np.hstack([quaternions, translations])


# Robust start of a fit: correspondences that agree on one similarity.
#
# Least median of squares (Rousseeuw 1984). Each of many triples of points gives a similarity. The
# winner has the smallest h-th smallest squared residual in sigmas, h = floor(n / 2) + 2. Up to (n -
# h) points may therefore be anywhere, even a continent away, without any influence. Reweighting
# that starts from all points does not achieve this, because a single gross error rotates the whole
# fit.
#
# The residuals of the winner give an estimate of the scale. It uses the median length 1.538 of
# three Gaussian coordinates and a correction for small n,
#
#     s = (1 + 5 / (n - 3)) sqrt(r2_(h)) / 1.538,
#
# but at least one sigma. Points with a residual below 2.795 s (95 % of good points) agree. Two
# rounds of fitting these points and selecting again remove the noise of the winning triple.


MOST_TRIPLES = 1000
"""Largest number of triples that are all tried; beyond it, this number of random triples is used.

If half of the points are wrong, all random triples contain a wrong point with probability
(7/8)^1000 = 1e-58.
"""
MOST_SCORED = 1000  # largest number of points whose residuals score a triple
MEDIAN_LENGTH = 1.538172  # median length of a vector of three standard Gaussian coordinates


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
