"""Similarity from the frame of model B to that of model A, from shared images and points.

Two models without a common gauge have 7 gauge degrees of freedom each. The similarity between them
has 7 parameters, of which one shared image determines 6. With its poses R_a, C_a and R_b, C_b
(camera from world, and centre),

    R = R_a^T R_b,   t = C_a - s R C_b.

The scale s is the median of |X_a - C_a| / |X_b - C_b| over all other common places. These are
points that meet at a keypoint of a shared image, and centres of other shared images. Without such a
pair the scale is undetermined.

Every shared image gives such a candidate; of many images, a selection does. Another candidate is
the weighted fit to consistent points and centres (``georeference.similarity``,
``georeference.similarity_fit``), unless these lie on one line. The candidate with the smallest
median residual in sigmas wins. One sigma is the error of a point that appears as large as the width
of an image, so that distant points count less. This method needs no third image, unlike
``pycolmap.align_reconstructions_via_reprojections``. It needs no threshold in length units of the
model, unlike ``..._via_points``. Wrong tracks and misplaced images have no influence if they are at
most half of all.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.words import plural
from bundle.errors import InputError
from bundle.georeference.similarity import Similarity, agreeing
from bundle.georeference.similarity_fit import Correspondences, fit_similarity
from bundle.model.problem import Problem
from bundle.model.rigid_motions import rotation_matrices

DEGREES = 7
MOST_CANDIDATES = 50
SAME_PLACE = 1e-9
"""Distance of two places, relative to the largest distance, below which they count as equal."""

Array = NDArray[np.float64]


def find_similarity(
    a: Problem,
    b: Problem,
    images: NDArray[np.int64],
    meetings: NDArray[np.int64],
) -> Similarity:
    """Return the similarity from the frame of B to that of A.

    Args:
        b: the second model.
        images: (n, 2) indices in A and B of the shared images.
        meetings: (m, 3) row of ``images``, index of a point of A, index of a point of B.
    """
    centers_a, centers_b = a.projection_centers[images[:, 0]], b.projection_centers[images[:, 1]]
    _, first = np.unique(meetings[:, 1:], axis=0, return_index=True)
    view, point_a, point_b = meetings[np.sort(first)].T
    target = np.vstack([a.points[point_a], centers_a])
    source = np.vstack([b.points[point_b], centers_b])
    sigmas = _sigmas(a, images, target, view, centers_a)
    candidates = []
    poses_a = rotation_matrices(a.cam_from_world[images[:, 0], :4])
    poses_b = rotation_matrices(b.cam_from_world[images[:, 1], :4])
    steps = np.linspace(0, len(images) - 1, min(len(images), MOST_CANDIDATES))
    for row in np.unique(steps.astype(int)):
        scale = _scale(target - centers_a[row], source - centers_b[row])
        if scale is not None:
            rotation = poses_a[row].T @ poses_b[row]
            shift = centers_a[row] - scale * rotation @ centers_b[row]
            candidates.append(Similarity(scale, rotation, shift))
    if not candidates:
        raise InputError(
            f"b: expected shared images or points that determine {DEGREES} degrees of "
            f"freedom, found {plural(len(images), 'shared image')} in one place and "
            f"{plural(len(point_a), 'shared point')}, which determine {DEGREES - 1}: the "
            "scale is undetermined"
        )
    fitted = _fitted(source, target, sigmas)
    if fitted is not None:
        candidates.append(fitted)
    return min(candidates, key=lambda s: _misfit(s, source, target, sigmas))


def _sigmas(
    a: Problem, images: NDArray[np.int64], target: Array, view: NDArray[np.int64], centers: Array
) -> Array:
    """Return (m + n,) standard deviations of points, then of centres, in length units of A."""
    num_points = len(view)
    depth = np.linalg.norm(target[:num_points] - centers[view], axis=1)
    if num_points:
        usual = float(np.median(depth))
    else:
        usual = float(np.linalg.norm(centers - centers.mean(axis=0), axis=1).max())
    usual = usual or 1.0
    depth = np.maximum(depth, SAME_PLACE * usual)
    width = np.maximum(a.camera_sizes.max(axis=1)[a.image_camera[images[:, 0]]], 1)
    return np.concatenate([depth / width[view], usual / width])


def _scale(target: Array, source: Array) -> float | None:
    """Return the median ratio of lengths; None if all are zero in one of the models."""
    there, here = np.linalg.norm(target, axis=1), np.linalg.norm(source, axis=1)
    known = (there > SAME_PLACE * there.max()) & (here > SAME_PLACE * here.max())
    if not known.any():
        return None
    return float(np.median(there[known] / here[known]))


def _fitted(source: Array, target: Array, sigmas: Array) -> Similarity | None:
    """Return the weighted fit to consistent places; None if a degree of freedom is undetermined."""
    chosen = agreeing(source, target, np.tile(sigmas[:, None], 3))
    rows = Correspondences(
        source[chosen], target[chosen], sigmas[chosen, None, None] ** 2 * np.eye(3)
    )
    try:
        return fit_similarity(rows).similarity
    except InputError:
        return None


def _misfit(similarity: Similarity, source: Array, target: Array, sigmas: Array) -> float:
    residual = np.linalg.norm(similarity.apply(source) - target, axis=1)
    return float(np.median(residual / sigmas))
