"""Modes of disconnected components, and of components whose images share one position."""

from __future__ import annotations

import numpy as np

from bundle.analysis.diagnosis.diagnosis_result import Component, WeakMode
from bundle.analysis.diagnosis.equation_counts import EquationCounts
from bundle.analysis.diagnosis.track_table import TrackTable
from bundle.analysis.diagnosis.viewing import viewing
from bundle.base.words import named, plural
from bundle.model.problem import Problem

MOST_IMAGES = 200
"""Largest number of images of a component that the search for the nearest pair uses."""
MOST_PIECES = 100
SIMILARITY = 7


def component_modes(
    problem: Problem, tracks: TrackTable, components: tuple[Component, ...]
) -> list[WeakMode]:
    """Return a mode for each component but the largest, with advice on connecting it."""
    modes = []
    for part in components[1:]:
        near = _nearest(problem, tracks, part.image_ids)
        modes.append(
            WeakMode(
                kind="component",
                sentence=f"{named('Image', part.image_ids)} ({plural(part.num_points, 'point')}): "
                "another component than the largest, of "
                f"{plural(len(components[0].image_ids), 'image')}, with which no point is shared. "
                "Position, rotation and scale against it are arbitrary. Common points of images "
                f"{near[0]} and {near[1]}, the nearest to each other, would join them "
                f"({plural(near[2], 'point')} of the former and {near[3]} of the latter are seen "
                "by two images or fewer).",
                image_ids=part.image_ids,
                camera_ids=(),
                eigenvalue=0.0,
                dimension=SIMILARITY,
            )
        )
    return modes


def rotation_modes(problem: Problem, tracks: TrackTable, counts: EquationCounts) -> list[WeakMode]:
    """Return a mode for each component whose images all have the same position.

    If a component has too few equations to determine positions, its mode says so.
    """
    modes = []
    for piece in range(min(int(tracks.pieces.max(initial=-1)) + 1, MOST_PIECES)):
        images = np.flatnonzero(tracks.pieces == piece)
        look = viewing(problem, images) if len(images) > 1 else None
        if look is None or look.cause != "pure_rotation":
            continue
        short = counts.mode(images, 0)
        if short is not None:
            modes.append(short)
            continue
        ids = tuple(sorted(problem.image_ids[images].tolist()))
        modes.append(
            WeakMode(
                kind="pure_rotation",
                sentence=f"Pure rotation: {named('image', ids)} stand at one place (within "
                f"{look.baseline:.1g} of the distance of their points): no point has a depth and "
                "the scale is arbitrary. Add images from elsewhere, or hold the points.",
                image_ids=ids,
                camera_ids=(),
                eigenvalue=0.0,
                dimension=0,
            )
        )
    return modes


def _nearest(
    problem: Problem, tracks: TrackTable, part: tuple[int, ...]
) -> tuple[int, int, int, int]:
    """Return the ids of the nearest pair of images, one of the part and one of the main component.

    For each of them, also return the number of its points that at most one other image sees.
    """
    own = np.flatnonzero(np.isin(problem.image_ids, part))[:MOST_IMAGES]
    main = np.flatnonzero(tracks.pieces == 0)
    centers = problem.projection_centers
    gaps = np.linalg.norm(centers[own][:, None] - centers[main][None], axis=2)
    first, second = np.unravel_index(int(gaps.argmin()), gaps.shape)
    a, b = int(own[first]), int(main[second])
    short = tracks.lengths[tracks.points] <= 2
    counts = [int((short & (tracks.images == image)).sum()) for image in (a, b)]
    return int(problem.image_ids[a]), int(problem.image_ids[b]), counts[0], counts[1]
