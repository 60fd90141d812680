"""Points far away that hold the world under inner constraints.

These ask for N^T x = 0 over all unknowns x, N what turning, moving and scaling the world does
(core/covariance/free_gauge.h). Of a point at a distance d from the centre, the part of N that turns
and scales is about d, and counts by its square: a point a thousand scenes away has the weight of a
million. If a few such points have more of it than all others together, poses are as certain as the
direction in which those are, which is the definition, but hardly what is asked for.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.words import plural
from bundle.model.problem import Problem

__all__ = ["note_on_far_points"]

FAR = 100.0
"""Times the median distance of points from the median of the cameras."""

MOST_NAMED = 5


def note_on_far_points(problem: Problem, null_points: NDArray[np.int32]) -> str:
    """Return a sentence if points far away dominate the inner constraints; else "".

    Args:
        problem: whose points are free.
        null_points: rows of points without parallax, which take no part.
    """
    takes_part = np.bincount(problem.observation_point, minlength=problem.num_points) > 0
    takes_part[null_points] = False
    rows = np.flatnonzero(takes_part)
    if not len(rows):
        return ""
    center = np.median(problem.projection_centers, axis=0)
    distances = np.linalg.norm(problem.points[rows] - center, axis=1)
    weights = (distances / max(float(distances.max()), 1e-300)) ** 2
    is_far = distances > FAR * np.median(distances)
    if not weights[is_far].sum() > weights[~is_far].sum():
        return ""
    ids = problem.point_ids[rows[is_far]].tolist()
    named = ", ".join(map(str, ids[:MOST_NAMED])) + (", ..." if len(ids) > MOST_NAMED else "")
    return (
        f"{plural(len(ids), 'point')} more than {FAR:g} times as far away as most (ids {named}) "
        "dominate the inner constraints: sigmas are relative to these. Use two_cameras, or leave "
        "them out."
    )
