"""Other interpretations of the numbers in a file: swapped columns, feet instead of metres.

Swapping x and y mirrors a place. A similarity cannot mirror; on flat ground it turns the model
upside down instead, and every residual stays small: the cameras are then below the ground that they
observe. Images determine the vertical. With the mean direction d from a camera to its points and
the upward axis a of its image (minus y),

    uprightness = median of a_up - median of d_up

is about 1 for nadir images (0 and -1) and for images of a facade (1 and 0), and larger for oblique
images. If the model is upside down, it has the opposite sign. Cameras that look straight up at a
ceiling also have -1 although they are correct. Coordinates are therefore refused in two cases only:
another interpretation is upright and does not fit worse, or another interpretation fits many times
better. The criterion of a fit is a robust residual, since some places may have gross errors and any
three places fit a similarity well: the h-th smallest of n residuals in sigmas, h = n / 2 + 2, after
the similarity that fits most places.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError
from bundle.georeference.control_point import GroundControlPoint
from bundle.georeference.prior_alignment import robust_similarity
from bundle.georeference.reference_system import ReferenceSystem
from bundle.georeference.similarity import Similarity
from bundle.georeference.similarity_fit import Correspondences
from bundle.model.problem import Problem
from bundle.model.rigid_motions import rotation_matrices

if TYPE_CHECKING:  # avoids a cycle: survey calls check_readings
    from bundle.georeference.survey import Readings, Survey

UPRIGHT = 0.5
"""Uprightness above which a model is upright; below its negative, the model is upside down."""
NO_WORSE = 1.2  # largest ratio of residuals for which another interpretation counts as not worse
BETTER = 3.0  # smallest ratio of residuals that proves another interpretation
TINY = 0.05  # residual in sigmas below which a better fit is not significant
SMALL = 0.5  # residual in sigmas below which all interpretations count as equally good
FEWEST = 7  # smallest number of places for which a better fit is not a coincidence
FOOT = 0.3048
MOST_OBSERVATIONS = 1_000_000  # largest number of observations in use to determine the vertical
EXCHANGED = "columns 1 and 2 fit when exchanged"
FEET = "heights fit as feet"

Array = NDArray[np.float64]


def check_readings(survey: Survey) -> tuple[str, ...]:
    """Return a sentence if the model is upside down; otherwise an empty tuple.

    Raises:
        InputError: another interpretation of the coordinates is more likely.
    """
    if survey.frame.origin is None:
        return ()
    given = survey.measured.rows(survey.decisive)
    num_points = len(given) - len(survey.cameras)
    rows = {"gcps": slice(num_points), "gps": slice(num_points, None), "gcps and gps": slice(None)}
    lengths, upright = _judged(survey.problem, given, survey.what)
    for whose, what, points, positions in _readings(survey):
        other = survey.decisive_places(points, positions)
        if other is None:
            continue
        its_lengths, its_upright = _judged(survey.problem, other, survey.what)
        residual, its_residual = _most(lengths[rows[whose]]), _most(its_lengths[rows[whose]])
        turned = upright < -UPRIGHT and its_upright > UPRIGHT and what == EXCHANGED
        better = residual > TINY and residual > BETTER * its_residual and len(given) >= FEWEST
        if better and what == FEET:
            # Scaling down heights always improves the fit if they are noise.
            level = survey.decisive_places(*_scaled((points, positions), 0.0))
            if level is not None:
                at_one_height = _judged(survey.problem, level, survey.what)[0]
                better = _most(at_one_height[rows[whose]]) > BETTER * its_residual
        if better or (turned and its_residual <= NO_WORSE * max(residual, SMALL)):
            found = f"off by {residual:.3g} sigmas as given and by {its_residual:.3g} otherwise"
            if turned:
                found = "upside down as given"
            raise InputError(f"{whose}: {what} ({survey.what}: the model is {found})")
    if upright < -UPRIGHT:
        return (
            "The cameras look up at their points, or their images are upside down: the model is "
            "probably upside down.",
        )
    return ()


def uprightness(problem: Problem, similarity: Similarity) -> float:
    """Return the uprightness of a problem's images after a similarity; nan without points.

    The uprightness is about 1 for an upright model, -1 for one that is upside down.
    """
    up = similarity.rotation[2]  # in the frame of the problem
    some = slice(None, None, max(1, problem.num_observations // MOST_OBSERVATIONS))
    image, point = problem.observation_image[some], problem.observation_point[some]
    seen = np.bincount(image, minlength=problem.num_images)
    if not seen.any():
        return float("nan")
    rays = problem.points[point] - problem.projection_centers[image]
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), np.finfo(float).tiny)
    along = np.bincount(image, rays @ up, problem.num_images)[seen > 0]
    images_up = -rotation_matrices(problem.cam_from_world[:, :4])[seen > 0, 1] @ up
    return float(np.median(images_up) - np.median(along / seen[seen > 0]))


def _most(lengths: Array) -> float:
    """Return the h-th smallest length; the top of this file defines h."""
    rank = min(len(lengths) // 2 + 2, len(lengths)) - 1
    return float(np.sort(lengths)[rank])


def _judged(problem: Problem, places: Correspondences, what: str) -> tuple[Array, float]:
    """Return the residuals in sigmas, and the uprightness; inf and nan without a fit."""
    try:
        similarity = robust_similarity(places, what)
    except InputError:
        return np.full(len(places), np.inf), float("nan")
    offset = places.offset @ similarity.rotation.T
    residual = np.nan_to_num(similarity.apply(places.source) + offset - places.target)
    turned = similarity.rotation @ places.source_covariance @ similarity.rotation.T
    variance = np.diagonal(
        places.target_covariance + similarity.scale**2 * turned, axis1=1, axis2=2
    )
    lengths = np.sqrt((residual**2 / variance).sum(axis=1))
    return lengths, uprightness(problem, similarity)


def _readings(survey: Survey) -> Iterator[tuple[str, str, *Readings]]:
    """Return other interpretations: the kind of data, a description, and the coordinates."""
    points, positions = survey.points, survey.positions
    by_hand = positions if positions is not None and not positions.is_exif else None
    for what in (EXCHANGED, FEET):
        if what == EXCHANGED:
            swapped = None if by_hand is None else by_hand.exchanged()
            others = _exchanged_points(points), swapped
        else:
            others = _scaled((points, by_hand), FOOT)
        other_points, other_positions = others
        if other_points:
            yield "gcps", what, other_points, positions
        if other_positions is not None:
            yield "gps", what, points, other_positions
        if other_points and other_positions is not None:
            yield "gcps and gps", what, other_points, other_positions


def _exchanged_points(points: tuple[GroundControlPoint, ...]) -> tuple[GroundControlPoint, ...]:
    """Return points with x and y swapped; an empty tuple if these are invalid in their system."""
    exchanged = []
    for point in points:
        x, y, z = point.position
        exchanged.append(replace(point, position=(y, x, z)))
    for name in {str(point.reference_system) for point in points}:
        places = np.array([p.position for p in exchanged if p.reference_system == name])
        if not ReferenceSystem(name).is_within(places):
            return ()
    return tuple(exchanged)


def _scaled(given: Readings, factor: float) -> Readings:
    points, positions = given
    of_points = (
        replace(point, position=(*point.position[:2], factor * point.position[2]))
        for point in points
    )
    if positions is not None:
        positions = replace(positions, geodetic=positions.geodetic * [1, 1, factor])
    return tuple(of_points), positions
