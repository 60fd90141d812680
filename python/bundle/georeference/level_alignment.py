"""Similarity of a model whose vertical is known, from as few as two surveyed positions.

Positions on a line, such as those of a straight street, leave the turn of a model about the line
free. Measured gravity determines it. With z up in both frames, a similarity has the scale s, a turn
a about z and a translation. For centred points, p_i and q_i their horizontal parts as complex
numbers, u_i and v_i their heights, least squares give

    a = arg sum conj(p_i) q_i,    s = (|sum conj(p_i) q_i| + sum u_i v_i) / sum (|p_i|^2 + u_i^2).

Unknown heights do not count. Lever arms, which are short beside the line, are left to the solve.
"""

from __future__ import annotations

import cmath
import math

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError
from bundle.georeference.correspondences import Correspondences
from bundle.georeference.similarity import Similarity
from bundle.georeference.similarity_fit import WIDEST_ANGLE

Array = NDArray[np.float64]


def level_similarity(points: Correspondences, upright: Array) -> Similarity:
    """Return the similarity whose rotation is a turn about z after `upright`.

    Args:
        points: points of the model and their surveyed positions.
        upright: (3, 3) turn of the model to z up.

    Raises:
        InputError: no height is known, or the positions do not determine scale and heading.
    """
    known = ~np.isnan(points.target[:, 2])
    if not known.any():
        raise InputError("expected a position with a height, found 0")
    source = points.source @ upright.T
    middle, goal = source.mean(axis=0), points.target.mean(axis=0)
    middle[2], goal[2] = source[known, 2].mean(), points.target[known, 2].mean()
    p, q = ((v - m)[:, :2] @ [1, 1j] for v, m in ((source, middle), (points.target, goal)))
    u, v = source[known, 2] - middle[2], points.target[known, 2] - goal[2]
    variance = np.trace(points.target_covariance[:, :2, :2], axis1=1, axis2=2) / 2
    information = float((np.abs(q) ** 2 / variance).sum())
    both, heights = complex(np.vdot(p, q)), float(u @ v)
    scale = (abs(both) + heights) / max(float((np.abs(p) ** 2).sum() + u @ u), 1e-300)
    if not (information * WIDEST_ANGLE**2 > 1 and scale > 0 and abs(both) > 0):
        raise InputError(
            f"expected positions that determine scale and heading, found {len(points)} within "
            f"their sigmas at one place"
        )
    turn = cmath.phase(both)
    c, s = math.cos(turn), math.sin(turn)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ upright
    return Similarity(scale, rotation, goal - scale * rotation @ (upright.T @ middle))
