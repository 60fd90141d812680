"""Checks of a covariance: factors, pairs of images, huge coordinates, rounding, distant points.

Distant points dominate the gauge under inner constraints. The constraints require N^T x = 0 over
all unknowns x, with N the changes by moving, rotating and scaling the world
(core/covariance/free_gauge.h). For a point at a distance d from the centre, the rows of N for
rotation and scale are about d, and their weight is d^2. A point a thousand scene sizes away has the
weight of a million points. If a few such points outweigh all others together, poses are as
uncertain as the direction of these points. This follows from the definition, but users rarely want
it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.words import plural
from bundle.errors import InputError, brief
from bundle.model.problem import Problem
from bundle.solving.result import Result

LARGEST = 1e50
"""Limit of coordinates; gauges need fourth powers, which would exceed the range of doubles."""

FAR = 100.0
"""Multiple of the median distance of points from the median of the cameras."""

MOST_NAMED = 5


def note_on_far_points(problem: Problem, null_points: NDArray[np.int32]) -> str:
    """Return a sentence if distant points dominate the inner constraints; else "".

    Args:
        problem: problem with free points.
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


def refuse_huge(problem: Problem) -> None:
    """Refuse coordinates whose powers exceed the range of doubles; the error names the first."""
    for kind, ids, coordinates in (
        ("point", problem.point_ids, problem.points),
        ("image", problem.image_ids, problem.cam_from_world[:, 4:]),
    ):
        sizes = np.abs(coordinates).max(axis=1, initial=0.0)
        for row in np.flatnonzero(sizes > LARGEST)[:1]:
            raise InputError(
                f"{kind} {ids[row]}: expected coordinates of at most {LARGEST:g}, found "
                f"{sizes[row]:g}; covariances need their fourth powers"
            )


def refuse_rounding(problem: Problem, out: dict[str, Any]) -> None:
    """Refuse negative and infinite variances, and NaN variances of images with observations."""
    seen = np.zeros(problem.num_images, bool)
    seen[problem.observation_image] = True
    for kind, ids, blocks, known in (
        ("image", problem.image_ids, out["poses"], seen),
        ("camera", problem.camera_ids, out["cameras"], False),
        ("point", problem.point_ids, out.get("points", np.zeros((0, 3, 3))), False),
    ):
        variances = np.diagonal(blocks, axis1=1, axis2=2)[: len(ids)]
        wrong = (variances < 0) | np.isinf(variances)
        no_number = np.isnan(variances).any(axis=1) & known
        for row in np.flatnonzero(wrong.any(axis=1) | no_number[: len(wrong)])[:1]:
            raise InputError(
                f"{kind} {ids[row]}: expected variances, found {variances[row].min():g}, which is "
                "only a rounding error: the problem is too ill-conditioned; bundle diagnose names "
                "the cause"
            )


def rows_of(problem: Problem, pairs: list[Any]) -> list[tuple[int, int]]:
    """Return pairs of image ids as pairs of positions in the problem's arrays."""
    place = {key: row for row, key in enumerate(problem.image_ids.tolist())}
    rows = []
    for number_of, pair in enumerate(pairs):
        try:
            a, b = pair
        except (TypeError, ValueError):
            a, b = None, None
        for one in (a, b):
            if not isinstance(one, int | np.integer) or int(one) not in place:
                raise InputError(
                    f"relative: expected pairs of image ids, found {brief(pair)} at [{number_of}]"
                )
        rows.append((place[int(a)], place[int(b)]))
    return rows


def check_same_factors(result: Result, *given: Iterable[Any]) -> None:
    """Refuse a result without the factors of its solve: it is a minimum with them only."""
    count = len(result.factor_costs_after)
    shutter = result.problem.rolling_shutter
    if result.options.twists == "tied" and shutter is not None:
        count -= int(shutter.tied(result.problem).sum())  # from the options
    if count and not any(_is_given(one) for one in given):
        raise InputError(
            "problem: expected the factors, priors or constraints of the solve "
            f"({count}) together with its result"
        )


def _is_given(values: Iterable[Any]) -> bool:
    return not (isinstance(values, tuple | list) and not values)
