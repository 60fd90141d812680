"""The diagnosis in sentences, problems first.

Checks of the scale. Rigs whose sensors share one position do not determine the scale, like a
panorama head.

Images and points alone do not determine the scale. A solve without a fixed scale may shrink the
world a little at each step, geometrically. The cost does not change, but after many steps numbers
lose digits.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from bundle.analysis.diagnosis.diagnosis_result import Diagnosis, WeakMode
from bundle.analysis.diagnosis.track_table import FEW_SHARED, TrackTable, weak_joint
from bundle.analysis.diagnosis.unknowns import Unknowns
from bundle.base.records import dataclass
from bundle.base.words import named, noun, plural
from bundle.interface.finding import Finding
from bundle.model.problem import Problem
from bundle.model.rigid_motions import quaternion_inverse, quaternion_rotate
from bundle.solving.result import Result

MOST_COMPONENTS = 5
"""Number of components that get a sentence of their own."""
SAID = ("points_seen_once",)
"""Warnings of a solve that the diagnosis reports in its own words."""
SHARP = 1000.0
"""Gap of eigenvalues below which the number of null directions depends on the threshold."""
DRIFT = 3.0
"""Scale change of the world by a solve that counts as drift."""


def findings(
    diagnosis: Diagnosis,
    problem: Problem,
    tracks: TrackTable,
    unknowns: Unknowns,
    found: dict[str, Any],
    apart: list[WeakMode],
    drift: ScaleDrift | None,
) -> tuple[Finding, ...]:
    """Return the findings; `diagnosis` has all other fields.

    ``apart``: findings about components, loose or not.
    """
    all_of_them = [
        *_components(diagnosis, apart),
        *(
            _problem(mode.kind, mode.sentence)
            for mode in diagnosis.weak_modes
            if mode.kind != "component"
        ),
        *_collapsed(diagnosis),
        *_points(diagnosis),
        *_images(diagnosis),
        *([] if (joint := weak_joint(problem, tracks)) is None else [joint]),
        *rigs_without_baseline(problem),
        *_factorisation(problem, unknowns, found),
        *_rank(diagnosis),
        *_drift(drift),
        *_conditioning(diagnosis),
        *(_note(kind, words) for kind, words in found["warnings"] if kind not in SAID),
    ]
    return tuple(sorted(all_of_them, key=lambda finding: not finding.is_problem))


def _problem(kind: str, sentence: str) -> Finding:
    return Finding(kind=kind, is_problem=True, sentence=sentence)


def _note(kind: str, sentence: str) -> Finding:
    return Finding(kind=kind, is_problem=False, sentence=sentence)


def _components(diagnosis: Diagnosis, apart: list[WeakMode]) -> Iterator[Finding]:
    if not diagnosis.components:
        yield _problem("no_observations", "There are no observations: nothing is determined.")
    is_problem = diagnosis.nullity > diagnosis.expected_nullity
    sentences = [mode.sentence for mode in apart[:MOST_COMPONENTS]]
    rest = apart[MOST_COMPONENTS:]
    if rest:
        count = sum(len(mode.image_ids) for mode in rest)
        sentences.append(f"{plural(len(rest), 'more component')} of {plural(count, 'image')}.")
    for sentence in sentences:
        yield Finding(kind="component", is_problem=is_problem, sentence=sentence)


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
        from bundle.model.cameras import camera_models

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


def _rank(diagnosis: Diagnosis) -> Iterator[Finding]:
    gap = diagnosis.rank_gap
    if not gap < SHARP:
        return
    yield _note(
        "unclear_rank",
        f"The number of null directions is not sharp: the lowest eigenvalue that is not zero, "
        f"{diagnosis.eigenvalues[0]:.2g}, is only {gap:.3g} times the largest that counts as zero.",
    )


def _drift(drift: ScaleDrift | None) -> Iterator[Finding]:
    if drift is not None and not 1 / DRIFT < drift.factor < DRIFT:
        steps = plural(drift.num_steps, "step")
        each = f" ({drift.per_step:.3g} per step)" if drift.num_steps > 1 else ""
        yield _note(
            "scale_drift",
            f"The solve scaled the world by {drift.factor:.3g} in {steps}{each}: without "
            "rigs and positions, only the gauge holds the scale.",
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


NO_BASELINE = 1e-4
"""Share of the points' distance, below which sensors count as being at the same position."""


@dataclass(frozen=True)
class ScaleDrift:
    """Scale of a world after a solve.

    Attributes:
        factor: ratio of the spread of the camera centres after and before the solve.
        num_steps: accepted steps of the solve, at least 1.
    """

    factor: float
    num_steps: int

    @property
    def per_step(self) -> float:
        """Geometric mean of the factors of the steps."""
        return float(self.factor ** (1.0 / self.num_steps))


def scale_drift(result: Result) -> ScaleDrift | None:
    """Return the scale change by a solve.

    Return None if the result was aligned, or if all camera centres were the same at the start.
    """
    before, after = (
        float(np.linalg.norm(centers - centers.mean(axis=0)))
        for centers in (
            result.initial_problem.projection_centers,
            result.problem.projection_centers,
        )
    )
    if not before > 0 or result.similarity is not None:
        return None
    accepted = np.asarray(result.iterations["step_is_successful"], bool)
    return ScaleDrift(after / before, max(int(accepted[1:].sum()), 1))


def rigs_without_baseline(problem: Problem) -> Iterator[Finding]:
    """Yield a finding for each rig of several sensors at one position."""
    if not problem.num_sensors or not problem.num_observations:
        return
    poses = problem.sensor_from_rig
    back = quaternion_inverse(poses[:, :4] / np.linalg.norm(poses[:, :4], axis=1, keepdims=True))
    reach = np.linalg.norm(quaternion_rotate(back, poses[:, 4:]), axis=1)
    centers = problem.projection_centers[problem.observation_image]
    away = np.linalg.norm(problem.points[problem.observation_point] - centers, axis=1)
    distance = float(np.median(away))
    for rig in np.unique(problem.sensor_rig_ids).tolist():
        own = problem.sensor_rig_ids == rig
        if float(reach[own].max()) >= NO_BASELINE * distance:
            continue
        yield Finding(
            kind="rig_without_baseline",
            is_problem=True,
            sentence=f"Rig {rig}: its {int(own.sum()) + 1} sensors are at one place, so the scale "
            "of the world is arbitrary. Give the distances of the sensors (sensor_from_rig), "
            "positions or control points.",
        )
