"""The diagnosis in sentences, problems first."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from bundle.diagnosis.diagnosis_result import Diagnosis, Finding
from bundle.diagnosis.id_lists import named, noun
from bundle.diagnosis.track_table import FEW_SHARED, TrackTable
from bundle.diagnosis.unknowns import Unknowns
from bundle.diagnosis.viewing import viewing
from bundle.problem import Problem
from bundle.words import plural

__all__ = ["findings"]

MOST_COMPONENTS = 5
"""Components that have a sentence of their own."""
SAID = ("points_seen_once",)
"""Warnings of a solve that the diagnosis has in words of its own."""
DRIFT = 3.0
"""A solve that scales the world by more has drifted."""


def findings(
    diagnosis: Diagnosis,
    problem: Problem,
    tracks: TrackTable,
    unknowns: Unknowns,
    found: dict[str, Any],
    scale_change: float | None,
) -> tuple[Finding, ...]:
    """Return what there is to say; `diagnosis` has everything else."""
    all_of_them = [
        *_components(diagnosis, problem, tracks),
        *_rotations(problem, tracks),
        *(_problem(mode.kind, mode.sentence) for mode in diagnosis.weak_modes),
        *_collapsed(diagnosis),
        *_points(diagnosis),
        *_images(diagnosis),
        *_joints(problem, tracks),
        *_factorisation(problem, unknowns, found),
        *_drift(scale_change),
        *_conditioning(diagnosis),
        *(_note(kind, words) for kind, words in found["warnings"] if kind not in SAID),
    ]
    return tuple(sorted(all_of_them, key=lambda finding: not finding.is_problem))


def _problem(kind: str, sentence: str) -> Finding:
    return Finding(kind=kind, is_problem=True, sentence=sentence)


def _note(kind: str, sentence: str) -> Finding:
    return Finding(kind=kind, is_problem=False, sentence=sentence)


def _components(diagnosis: Diagnosis, problem: Problem, tracks: TrackTable) -> Iterator[Finding]:
    main, *others = diagnosis.components or (None,)
    if main is None:
        yield _problem("no_observations", "There are no observations: nothing is determined.")
        return
    is_problem = diagnosis.nullity > diagnosis.expected_nullity
    for part in others[:MOST_COMPONENTS]:
        near = _nearest(problem, tracks, part.image_ids)
        yield Finding(
            kind="component",
            is_problem=is_problem,
            sentence=f"{named('Image', part.image_ids)} ({plural(part.num_points, 'point')}): "
            f"another component than the largest, of {plural(len(main.image_ids), 'image')}, with "
            "which no point is shared. Position, rotation and scale against it are arbitrary. "
            f"Common points of images {near[0]} and {near[1]}, the nearest to each other, would "
            f"join them ({plural(near[2], 'point')} of the former and {near[3]} of the latter are "
            "seen by two images or fewer).",
        )
    rest = others[MOST_COMPONENTS:]
    if rest:
        count = sum(len(part.image_ids) for part in rest)
        yield Finding(
            kind="component",
            is_problem=is_problem,
            sentence=f"{plural(len(rest), 'more component')} of {plural(count, 'image')} in all.",
        )


def _nearest(
    problem: Problem, tracks: TrackTable, part: tuple[int, ...]
) -> tuple[int, int, int, int]:
    """Return the ids of the images of the part and of the main piece that stand nearest.

    And how many points each of them sees that one other image at most sees.
    """
    own = np.flatnonzero(np.isin(problem.image_ids, part))[:200]
    main = np.flatnonzero(tracks.pieces == 0)
    centers = problem.projection_centers
    gaps = np.linalg.norm(centers[own][:, None] - centers[main][None], axis=2)
    first, second = np.unravel_index(int(gaps.argmin()), gaps.shape)
    a, b = int(own[first]), int(main[second])
    short = tracks.lengths[tracks.points] <= 2
    counts = [int((short & (tracks.images == image)).sum()) for image in (a, b)]
    return int(problem.image_ids[a]), int(problem.image_ids[b]), counts[0], counts[1]


def _rotations(problem: Problem, tracks: TrackTable) -> Iterator[Finding]:
    for piece in range(min(tracks.pieces.max(initial=-1) + 1, 100)):
        images = np.flatnonzero(tracks.pieces == piece)
        look = viewing(problem, images) if len(images) > 1 else None
        if look is not None and look.cause == "pure_rotation":
            yield _problem(
                "pure_rotation",
                f"Pure rotation: {named('image', problem.image_ids[images])} stand at one place "
                f"(within {look.baseline:.1g} of the distance of their points): no point has a "
                "depth and the scale is arbitrary. Add images from elsewhere, or hold the points.",
            )


def _collapsed(diagnosis: Diagnosis) -> Iterator[Finding]:
    clusters = diagnosis.collapsed
    if not clusters:
        return
    points = {point for cluster in clusters for point in cluster.point_ids}
    images = {image for cluster in clusters for image in cluster.image_ids}
    count = sum(cluster.num_observations for cluster in clusters)
    yield _problem(
        "collapsed_scale",
        f"Collapsed in scale: {plural(len(points), 'point')} sit on cameras "
        f"({plural(count, 'observation')} in {named('image', sorted(images))} with a depth below "
        "1e-4 of the median). Remove these points and images, or start them elsewhere.",
    )


def _points(diagnosis: Diagnosis) -> Iterator[Finding]:
    d = diagnosis
    checks = (
        (
            "points_without_parallax",
            d.points_without_parallax,
            True,
            "without parallax: on one line with all images that see them, so that no observation "
            "sees the depth",
        ),
        (
            "points_at_cameras",
            d.points_at_cameras,
            True,
            "at the centre of a camera that sees them",
        ),
        (
            "points_seen_once",
            d.points_seen_once,
            True,
            "seen by one image only: the depth is free",
        ),
        (
            "unobserved_points",
            d.unobserved_points,
            False,
            "without observations: not refined",
        ),
        (
            "points_seen_twice",
            d.points_seen_twice,
            False,
            "seen by two images only: errors along the epipolar line do not show",
        ),
        (
            "points_at_infinity",
            d.points_at_infinity,
            False,
            "at infinity, almost: they hold rotations only, which is no error",
        ),
    )
    for kind, ids, is_problem, words in checks:
        if len(ids):
            yield Finding(
                kind=kind,
                is_problem=is_problem,
                sentence=f"{plural(len(ids), 'point')} {words} ({named('point', ids.tolist())}).",
            )


def _images(diagnosis: Diagnosis) -> Iterator[Finding]:
    few = diagnosis.images_with_few_shared_points
    if len(few):
        yield _problem(
            "images_with_few_shared_points",
            f"{plural(len(few), 'image')} {noun(len(few), 'shares', 'share')} fewer than "
            f"{FEW_SHARED} points with the rest: the relative pose is not determined "
            f"({named('image', few.tolist())}).",
        )
    few = diagnosis.images_with_few_observations
    if len(few):
        yield _note(
            "images_with_few_observations",
            f"{plural(len(few), 'image')} {noun(len(few), 'has', 'have')} fewer than 10 "
            f"observations ({named('image', few.tolist())}).",
        )


def _joints(problem: Problem, tracks: TrackTable) -> Iterator[Finding]:
    """Yield parts that hang on others by few points, but hang."""
    firm = tracks.firm_pieces
    for piece in range(1, min(firm.max(initial=-1) + 1, 20)):
        images = np.flatnonzero(firm == piece)
        count = tracks.count_between(images)
        if count >= FEW_SHARED or count == 0 or len(images) < 2:
            continue
        yield _note(
            "weak_joint",
            f"{named('Image', problem.image_ids[images])} hang on the others by "
            f"{plural(count, 'common point')}.",
        )


def _factorisation(
    problem: Problem, unknowns: Unknowns, found: dict[str, Any]
) -> Iterator[Finding]:
    if found["failure"]:
        yield _problem("not_factorised", str(found["failure"]))
    row = int(found["failed_unknown"])
    if row < 0:
        return
    kind, index, coordinate = (
        int(a[row]) for a in (unknowns.kind, unknowns.index, unknowns.coordinate)
    )
    if kind == 3:
        from bundle.cameras import camera_models

        name = camera_models()[problem.camera_models[index]][coordinate]
        where = f"{name} of camera {problem.camera_ids[index]}"
    else:
        ids = (problem.image_ids, problem.frame_ids, problem.sensor_camera_ids)[kind]
        what = ("image", "frame", "the sensor of camera")[kind]
        part = "rotation" if coordinate < 3 else "translation"
        where = f"{part} {'xyz'[coordinate % 3]} of {what} {ids[index]}"
    yield _note(
        "failing_column",
        f"A Cholesky factorisation without damping stops at column {row + 1}: {where}.",
    )


def _drift(scale_change: float | None) -> Iterator[Finding]:
    if scale_change is not None and not 1 / DRIFT < scale_change < DRIFT:
        yield _note(
            "scale_drift",
            f"The solve scaled the world by {scale_change:.3g}: nothing but the gauge holds the "
            "scale of a world without rigs and positions.",
        )


def _conditioning(diagnosis: Diagnosis) -> Iterator[Finding]:
    condition = diagnosis.condition_number
    if not np.isfinite(condition):
        return
    before = diagnosis.condition_number_unscaled
    unscaled = f" ({before:.2g} before scaling)" if np.isfinite(before) else ""
    yield _note(
        "conditioning",
        f"The condition number of the reduced camera system is {condition:.2g}{unscaled}: a step "
        f"has {plural(diagnosis.digits_normal_equations, 'digit')} by the normal equations and "
        f"{diagnosis.digits_square_root} by a QR factorisation.",
    )
